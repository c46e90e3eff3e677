"""The Modbus robot of a cell: arm, coders, firmware and server put together, and what can happen to them.

Imitates
    A FANUC M-6iB class robot with the HMI device option.
Source
    deploy/controller_setup/fanuc_hmi.md.
Modelled
    The faults of ``WorldFaults`` and ``fake_devices.modbus_robot.server.KINDS``; register faults: ``frozen``,
    ``nan``, ``swapped_words``, ``stale_pose``, ``metres``, ``value_jump``.
Not modelled
    See the modules of this package.
"""

import asyncio
from collections.abc import Mapping
from contextlib import suppress
from typing import Any

import numpy as np

from cellcal.fake_devices.device import FaultRefusedError, JsonObject
from cellcal.fake_devices.encoders import PulseCoders
from cellcal.fake_devices.keep_running import keep_running
from cellcal.fake_devices.kinematics import matrix_from_xyzwpr
from cellcal.fake_devices.modbus_robot.controller import Controller
from cellcal.fake_devices.modbus_robot.registers import POSITION, Block, IllegalValueError, RegisterMap, Words
from cellcal.fake_devices.modbus_robot.server import ModbusError, ModbusServer, link_faults
from cellcal.fake_devices.modbus_robot.words import float_words, words_float
from cellcal.fake_devices.modbus_robot.world_faults import WorldFaults
from cellcal.fake_devices.world import World

_TICK_REAL_S = 0.05
_REGISTER_FAULTS: dict[str, dict[str, Any]] = {
    "frozen": {},
    "nan": {},
    "swapped_words": {},
    "stale_pose": {},
    "metres": {},
    "value_jump": {"axis": "J1", "rad": 0.01},
}
_TITLES = {"fanuc_m6ib": "M-6iB"}


class _Served:
    """The register map as the telegrams see it."""

    def __init__(self, registers: RegisterMap) -> None:
        self.map = registers

    def read(self, address: int, count: int) -> list[int]:
        return self.map.read(address, count)

    def write(self, address: int, values: list[int]) -> None:
        try:
            self.map.write(address, values)
        except IllegalValueError:
            raise ModbusError(3) from None


class ModbusRobot:
    """One robot behind Modbus TCP."""

    def __init__(self, world: World, table: Mapping[str, Any]) -> None:
        self._world = world
        self._name = str(table["name"])
        model = str(table.get("model", "fanuc_m6ib"))
        arm = world.add_arm(self._name, model)
        coders = PulseCoders(arm, world.dice(self._name, "coders"))
        self.controller = Controller(
            arm, coders, str(table.get("serial", "F-000000")), _TITLES.get(model, model)
        )
        self.controller.program.heartbeat_s *= world.watchdog_factor
        self.controller.on_power = self._power_changed
        self.world_faults = WorldFaults(world, self.controller)
        world.masterings[self._name] = self.controller
        self._faults = link_faults(world.clock.real, _REGISTER_FAULTS)
        self._map = RegisterMap(self.controller)
        self._map.spoil = self._spoil
        host, port = str(table.get("address", "127.0.0.1")), int(table.get("port", 502))
        self.server = ModbusServer(host, port, _Served(self._map), self._faults)
        self._tick: asyncio.Task[None] | None = None
        self._stale: Words = []

    @property
    def name(self) -> str:
        """Name in the cell file."""
        return self._name

    async def start(self) -> None:
        await self.server.open()
        self._tick = keep_running(f"time of {self.name}", self._follow)

    async def stop(self) -> None:
        if self._tick is not None:
            self._tick.cancel()
            with suppress(asyncio.CancelledError):
                await self._tick
        await self.server.wait_closed()

    async def _follow(self) -> None:
        """Keep watchdogs honest while nobody asks, and open the port again after a boot or a refusal."""
        while True:
            self.controller.update()
            self.world_faults.boot_when_due()
            self._map.freeze(self._faults.look("frozen") is not None)
            await self._listen_or_not()
            await asyncio.sleep(_TICK_REAL_S)

    async def _listen_or_not(self) -> None:
        flap = self._faults.look("flap")
        down = flap is not None and int(self._world.clock.real() / float(flap["period_s"])) % 2 == 1
        if not self.controller.powered or down or self._faults.look("refuse") is not None:
            self.server.close()
        else:
            with suppress(OSError):  # the address is not free yet; the next tick tries again
                await self.server.open()

    def _power_changed(self) -> None:
        if not self.controller.powered:
            self.server.close()

    # faults

    def fault_names(self) -> frozenset[str]:
        return self._faults.kinds | self.world_faults.names()

    async def fault(self, name: str, parameters: Mapping[str, Any]) -> JsonObject:
        if name in self.world_faults.names():
            answer = self.world_faults.happen(name, parameters)
        elif name in self._faults.kinds:
            if name == "stale_pose":
                self._stale = self._map.read(POSITION, 18)
            self._faults.set(name, parameters)
            answer = {}
        else:
            raise FaultRefusedError(f"{self._name} knows no fault {name!r}")
        self._map.freeze(self._faults.look("frozen") is not None)
        await self._listen_or_not()
        return answer

    def clear(self) -> None:
        self._faults.clear()
        self._map.freeze(False)
        self.world_faults.clear()

    def _spoil(self, block: Block, words: Words) -> Words:
        if self._faults.look("swapped_words") is not None and block.paired and block.address < 2000:
            return [words[k ^ 1] if k ^ 1 < len(words) else words[k] for k in range(len(words))]
        return self._spoil_position(words) if block.address == POSITION else words

    def _spoil_position(self, words: Words) -> Words:
        if self._faults.look("nan") is not None:
            nan = [0x0000, 0x7FC0] * 9
            return [*nan, *words[18:26], *nan, *words[44:]]
        if self._faults.look("stale_pose") is not None:
            return [*self._stale, *words[18:]]
        if self._faults.look("metres") is not None:
            return [*float_words(value * 1e-3 for value in words_float(words[:6])), *words[6:]]
        if (jump := self._faults.look("value_jump")) is not None:
            joints = words_float(words[26:44])
            joints[int(str(jump["axis"])[1:]) - 1] += float(np.degrees(float(jump["rad"])))
            return [*words[:26], *float_words(joints), *words[44:]]
        return words

    # truth

    def truth(self) -> JsonObject:
        controller, arm = self.controller, self.controller.arm
        controller.update()
        coders = controller.coders
        return {
            "joints_rad": arm.joints_rad.tolist(),
            "controller_joints_rad": controller.joints().tolist(),
            "counts_read": list(coders.read()),
            "true_counts": coders.true_counts().tolist(),
            "turns_lost": list(coders.turns_lost()),
            "true_counts_at_zero": list(coders.true_counts_at_zero()),
            "counts_at_zero": list(controller.counts_at_zero),
            "factory_counts_at_zero": coders.factory_counts_at_zero.tolist(),
            "radians_per_count": coders.radians_per_count.tolist(),
            "mastered": controller.mastered,
            "established": [bool(value) for value in coders.established],
            "epoch": controller.epoch,
            "powered": controller.powered,
            "active": {
                "tool_number": controller.tool_number,
                "user_frame_number": controller.frame_number,
                "flange_tool": matrix_from_xyzwpr(controller.tools[controller.tool_number - 1]).tolist(),
                "payload_kg": None,
            },
            "moving": arm.moving,
            "mode": controller.mode,
            "emergency_stop": controller.emergency_stop,
            "override_percent": controller.override_percent,
            "alarms": [{"code": a.code, "text": a.text, "axis": a.axis} for a in controller.active_alarms()],
            "dh": arm.dh.tolist(),
            "nominal_dh": arm.nominal_dh.tolist(),
            "base_flange": arm.base_flange().tolist(),
            "connections": self.server.connections,
            "port": self.server.port,
        }


def create(world: World, table: Mapping[str, Any]) -> ModbusRobot:
    """Build the robot that a cell file names."""
    return ModbusRobot(world, table)
