"""The KUKA robot of a cell: arm, controller and variable server put together, and what can happen to them.

Imitates
    A KUKA arm on a KR C4 with C3 Bridge or KUKAVARPROXY.
Source
    controller.py and server.py.
Modelled
    The faults named below and ``fake_devices.kuka_variables.server.LINK_FAULTS``; a sensor stream with
    ``fake_devices.joint_stream.STREAM_FAULTS``.
Not modelled
    Encoders themselves: this link does not reach them.
"""

import asyncio
import math
from collections.abc import Mapping
from typing import Any

from cellcal.fake_devices.device import JsonObject
from cellcal.fake_devices.joint_stream import STREAM_FAULTS, JointSender
from cellcal.fake_devices.keep_running import keep_running
from cellcal.fake_devices.krl_programs.tasks import ACTIVE
from cellcal.fake_devices.kuka_variables.controller import FRAMES, KukaController
from cellcal.fake_devices.kuka_variables.program import BOTH, CELLCAL, KrlPrograms
from cellcal.fake_devices.kuka_variables.sensor_stream import encode_robot_datagram
from cellcal.fake_devices.kuka_variables.server import LINK_FAULTS, ProxyPort
from cellcal.fake_devices.kuka_variables.variables import VariableTable
from cellcal.fake_devices.link_faults import LinkFaults
from cellcal.fake_devices.networked_robot import NetworkedRobot, parse_axes
from cellcal.fake_devices.shown_joints import ShownJoints, ratios_of
from cellcal.fake_devices.world import World

_CYCLE_REAL_S = 0.004
_AXES = tuple(f"A{axis}" for axis in range(1, 7))


class FakeKukaRobot(NetworkedRobot):
    """One controller on one loopback address."""

    def __init__(self, world: World, table: Mapping[str, Any]) -> None:
        name = str(table["name"])
        arm = world.add_arm(name, str(table["model"]))
        title = arm.model.name.removeprefix("kuka_").upper()
        zeros = ShownJoints(arm, ratios_of(table, 6), world.make_rng(name, "zeros"))
        names = (str(table.get("serial", "0")), title)
        sources = KrlPrograms(program=BOTH if "rsi" in table else CELLCAL)
        self.controller = KukaController(arm, names, world.clock.real_now_s, zeros, sources)
        self.controller.timer_factor = world.watchdog_factor
        faults = LinkFaults({kind: {} for kind in (*LINK_FAULTS, *STREAM_FAULTS)}, world.clock.real_now_s)
        host, port = str(table.get("address", "127.0.0.1")), int(table.get("port", 7000))
        self.server = ProxyPort(host, port, VariableTable(self.controller), faults)
        super().__init__(name, arm, self.server, faults)
        self._stream = JointSender.from_table(
            table, "rsi", encode_robot_datagram, faults, world.clock.real_now_s
        )
        c = self.controller
        self._events |= {
            "stream_restart": lambda _: self._stream.restart(),
            "open_gate": lambda _: c.open_gate(),
            "t1_mode": lambda _: self._turn_switch("T1"),
            "program_stop": lambda _: c.programs.robot.stop_program(),
            "program_start": lambda _: c.programs.robot.press_start(),
            "program_cancel": lambda _: c.programs.robot.cancel_program(),
            "acknowledge": lambda _: c.acknowledge(),
            "external_moved": self._move_external_axis,
            "override": lambda p: c.set_override(int(p.pop("percent", 100))),
            "tool_switched": self._switch_tool,
            "mastering_lost": lambda p: c.lose_mastering(parse_axes(p.pop("axes", "all"), _AXES)),
            "master_with_gauge": lambda p: c.master_with_gauge(self._parse_axis(p)),
            "master_with_dial": lambda p: c.master_with_dial(self._parse_axis(p)),
            "mastering_angle": self._change_mastering_angle,
            "auto_mode": lambda _: c.turn_to_automatic(),
            "mend": lambda _: c.mend(),
            "mounted": lambda p: c.mount([float(value) for value in p.pop("xyzabc")]),
            "external_tool": lambda _: c.use_external_tool(),
            "hang_up": lambda _: self.server.drop_connection(),
            "exchanged": self._exchange_arm,
            "old_server": lambda _: self._use_server(c3=False),
            "new_server": lambda _: self._use_server(c3=True),
        }

    def _begin_tasks(self) -> list[asyncio.Task[None]]:
        return [keep_running(f"programs of {self.name}", self._follow_programs)]

    async def _follow_programs(self) -> None:
        try:
            while True:
                self.controller.run_programs()
                programs = self.controller.programs
                if programs.sensor_runs and programs.robot.state == ACTIVE:
                    self._stream.send_joints(self.controller.arm.controller_joints_rad.tolist())
                await asyncio.sleep(_CYCLE_REAL_S)
        finally:
            self._stream.close()

    def true_state(self) -> JsonObject:
        c = self.controller
        return {
            **self._true_arm(),
            "mode": c.mode,
            "state": int(c.programs.show("CC_STATE") or 0),
            "stop_flag": c.programs.show("CC_STOP") == "TRUE",
            "external": list(c.external),
            "mastered": list(c.mastered),
            "controller_joints_rad": c.arm.controller_joints_rad.tolist(),
            "stream_answers": self._stream.answer_count(),
            "error_rad": c.zeros.error_rad.tolist(),
            "active": {
                "tool_number": c.tool_number,
                "user_frame_number": c.base_number,
                "flange_tool": c.tool_matrix().tolist(),
                "payload_kg": c.load_kg,
            },
        }

    def _parse_axis(self, parameters: dict[str, Any]) -> int:
        return parse_axes(parameters.pop("axis", "A1"), _AXES)[0]

    def _change_mastering_angle(self, parameters: dict[str, Any]) -> None:
        """Change the angle that is assigned at a notch, as an unlucky expert may."""
        axis, degrees = self._parse_axis(parameters), float(parameters.pop("deg", 1.0))
        self.controller.mastering_deg[axis] += degrees
        self.controller.zeros.error_rad[axis] += math.radians(degrees)

    def _exchange_arm(self, parameters: dict[str, Any]) -> None:
        """Let another controller answer at this address from the next connection on."""
        self.controller.serial = str(parameters.pop("serial"))
        self.server.drop_connection()

    def _turn_switch(self, mode: str) -> None:
        self.controller.mode = mode

    def _move_external_axis(self, parameters: dict[str, Any]) -> None:
        """Drive a rail or positioner, as another program or a person may."""
        axis, value = int(parameters.pop("axis", 1)), float(parameters.pop("value"))
        if not 1 <= axis <= len(self.controller.external):
            raise ValueError("the external axes are 1 to 6")
        self.controller.external[axis - 1] = value

    def _use_server(self, *, c3: bool) -> None:
        self.server.is_c3 = c3

    def _switch_tool(self, parameters: dict[str, Any]) -> None:
        c = self.controller
        c.select_tool(int(parameters.pop("number", c.tool_number % FRAMES + 1)))
        c.load_kg = c.loads_kg[c.tool_number - 1]


def create_device(world: World, table: Mapping[str, Any]) -> FakeKukaRobot:
    """Build the robot that a cell file names."""
    return FakeKukaRobot(world, table)
