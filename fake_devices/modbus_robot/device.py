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
from cellcal.fake_devices.modbus_robot.controller import ModbusRobotController
from cellcal.fake_devices.modbus_robot.registers import (
    POSITION,
    IllegalValueError,
    RegisterAssignment,
    RegisterMap,
    Words,
)
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
RUNS_LISTINGS = "fanuc_tp"  # the profile whose controller obeys the listings that ship
_TITLES = {"fanuc_m6ib": "M-6iB"}


class _ServedRegisters:
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


class FakeModbusRobot:
    """One robot behind Modbus TCP."""

    def __init__(self, world: World, table: Mapping[str, Any]) -> None:
        self._world = world
        self._name = str(table["name"])
        model = str(table.get("model", "fanuc_m6ib"))
        arm = world.add_arm(self._name, model)
        coders = PulseCoders(arm, world.make_rng(self._name, "coders"))
        self.controller = ModbusRobotController(
            arm,
            coders,
            str(table.get("serial", "F-000000")),
            _TITLES.get(model, arm.model.title or model),
            runs_listings=table.get("profile") == RUNS_LISTINGS,
        )
        self.controller.program.heartbeat_s *= world.watchdog_factor
        self.controller.on_power = self._power_changed
        self.world_faults = WorldFaults(world, self.controller)
        world.masterings[self._name] = self.controller
        self._faults = link_faults(world.clock.real_now_s, _REGISTER_FAULTS)
        self._map = RegisterMap(self.controller)
        self._map.corrupt = self._corrupt_block
        host, port = str(table.get("address", "127.0.0.1")), int(table.get("port", 502))
        self.server = ModbusServer(host, port, _ServedRegisters(self._map), self._faults)
        self._tick: asyncio.Task[None] | None = None
        self._stale: Words = []

    @property
    def name(self) -> str:
        """Name in the cell file."""
        return self._name

    async def start(self) -> None:
        await self.server.open()
        self._tick = keep_running(f"time of {self.name}", self._follow_time)

    async def stop(self) -> None:
        if self._tick is not None:
            self._tick.cancel()
            with suppress(asyncio.CancelledError):
                await self._tick
        await self.server.wait_closed()

    async def _follow_time(self) -> None:
        """Update watchdogs between requests, and open the port again after a boot or a refusal."""
        while True:
            self.controller.catch_up()
            self.world_faults.boot_when_due()
            self._map.freeze_picture(self._faults.active_parameters("frozen") is not None)
            await self._listen_or_not()
            await asyncio.sleep(_TICK_REAL_S)

    async def _listen_or_not(self) -> None:
        flap = self._faults.active_parameters("flap")
        down = flap is not None and int(self._world.clock.real_now_s() / float(flap["period_s"])) % 2 == 1
        if not self.controller.powered or down or self._faults.active_parameters("refuse") is not None:
            self.server.close()
        else:
            with suppress(OSError):  # the address is not free yet; the next tick tries again
                await self.server.open()

    def _power_changed(self) -> None:
        if not self.controller.powered:
            self.server.close()

    # faults

    def fault_names(self) -> frozenset[str]:
        return self._faults.fault_kinds | self.world_faults.fault_names()

    async def inject_fault(self, name: str, parameters: Mapping[str, Any]) -> JsonObject:
        if name in self.world_faults.fault_names():
            answer = self.world_faults.inject_fault(name, parameters)
        elif name in self._faults.fault_kinds:
            if name == "stale_pose":
                self._stale = self._map.read(POSITION, 18)
            self._faults.switch_on(name, parameters)
            answer = {}
        else:
            raise FaultRefusedError(f"{self._name} knows no fault {name!r}")
        self._map.freeze_picture(self._faults.active_parameters("frozen") is not None)
        await self._listen_or_not()
        return answer

    def clear_faults(self) -> None:
        self._faults.clear_all()
        self._map.freeze_picture(False)
        self.world_faults.clear_faults()

    def _corrupt_block(self, block: RegisterAssignment, words: Words) -> Words:
        if (
            self._faults.active_parameters("swapped_words") is not None
            and block.paired
            and block.address < 2000
        ):
            return [words[k ^ 1] if k ^ 1 < len(words) else words[k] for k in range(len(words))]
        return self._corrupt_position(words) if block.address == POSITION else words

    def _corrupt_position(self, words: Words) -> Words:
        if self._faults.active_parameters("nan") is not None:
            nan = [0x0000, 0x7FC0] * 9
            return [*nan, *words[18:26], *nan, *words[44:]]
        if self._faults.active_parameters("stale_pose") is not None:
            return [*self._stale, *words[18:]]
        if self._faults.active_parameters("metres") is not None:
            return [*float_words(value * 1e-3 for value in words_float(words[:6])), *words[6:]]
        if (jump := self._faults.active_parameters("value_jump")) is not None:
            joints = words_float(words[26:44])
            joints[int(str(jump["axis"])[1:]) - 1] += float(np.degrees(float(jump["rad"])))
            return [*words[:26], *float_words(joints), *words[44:]]
        return words

    # truth

    def true_state(self) -> JsonObject:
        controller, arm = self.controller, self.controller.arm
        controller.catch_up()
        coders = controller.coders
        return {
            "joints_rad": arm.joints_rad.tolist(),
            "controller_joints_rad": controller.shown_joints().tolist(),
            "counts_read": list(coders.read_counts()),
            "true_counts": coders.true_counts().tolist(),
            "turns_lost": list(coders.turns_lost()),
            "true_counts_at_zero": list(coders.true_counts_at_zero()),
            "counts_at_zero": list(controller.counts_at_zero),
            "factory_counts_at_zero": coders.factory_counts_at_zero.tolist(),
            "radians_per_count": coders.radians_per_count.tolist(),
            "mastered": controller.is_mastered,
            "established": [bool(value) for value in coders.established],
            "epoch": controller.epoch,
            "powered": controller.powered,
            "active": {
                "tool_number": controller.tool_number,
                "user_frame_number": controller.frame_number,
                "flange_tool": matrix_from_xyzwpr(controller.tools[controller.tool_number - 1]).tolist(),
                "payload_kg": None,
            },
            "moving": arm.is_moving,
            "mode": controller.mode,
            "emergency_stop": controller.emergency_stop,
            "override_percent": controller.override_percent,
            "alarms": [
                {"code": a.code, "text": a.pendant_text, "axis": a.axis} for a in controller.active_alarms()
            ],
            "dh": arm.true_dh.tolist(),
            "nominal_dh": arm.nominal_dh.tolist(),
            "base_flange": arm.base_flange().tolist(),
            "connections": self.server.client_count,
            "port": self.server.port,
        }


def create_device(world: World, table: Mapping[str, Any]) -> FakeModbusRobot:
    """Build the robot that a cell file names."""
    return FakeModbusRobot(world, table)
