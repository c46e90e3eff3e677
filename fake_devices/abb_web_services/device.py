"""The ABB robot of a cell: arm, controller and web server put together, and what can happen to them.

Imitates
    An ABB arm on an IRC5 with RobotWare 6, or, with ``generation = 2`` in its settings, on an OmniCore with
    RobotWare 7.
Source
    controller.py, server.py and omnicore_server.py.
Modelled
    The faults named below and ``fake_devices.abb_web_services.http_port.LINK_FAULTS``; a position stream with
    ``fake_devices.joint_stream.STREAM_FAULTS``.
Not modelled
    Encoders themselves: this link does not reach them.
"""

import asyncio
from collections.abc import Mapping
from typing import Any

from cellcal.fake_devices.abb_web_services.controller import AbbController
from cellcal.fake_devices.abb_web_services.http_port import LINK_FAULTS, HttpPort
from cellcal.fake_devices.abb_web_services.omnicore_resources import OmnicoreResources
from cellcal.fake_devices.abb_web_services.omnicore_server import OmnicorePort
from cellcal.fake_devices.abb_web_services.position_stream import encode_robot_message
from cellcal.fake_devices.abb_web_services.program import RapidPrograms
from cellcal.fake_devices.abb_web_services.resources import ResourceTable
from cellcal.fake_devices.abb_web_services.server import ServicePort
from cellcal.fake_devices.device import JsonObject
from cellcal.fake_devices.joint_stream import STREAM_FAULTS, JointSender
from cellcal.fake_devices.keep_running import keep_running
from cellcal.fake_devices.link_faults import LinkFaults
from cellcal.fake_devices.networked_robot import NetworkedRobot, parse_axes
from cellcal.fake_devices.shown_joints import ShownJoints, ratios_of
from cellcal.fake_devices.world import World

_CYCLE_REAL_S = 0.004
_AXES = tuple(str(axis) for axis in range(1, 7))


class FakeAbbRobot(NetworkedRobot):
    """One controller on one loopback address."""

    def __init__(self, world: World, table: Mapping[str, Any]) -> None:
        name = str(table["name"])
        arm = world.add_arm(name, str(table["model"]))
        counters = ShownJoints(arm, ratios_of(table, 6), world.make_rng(name, "counters"))
        serial = str(table.get("serial", "0"))
        self.controller = AbbController(
            arm, serial, world.clock.real_now_s, counters, RapidPrograms(with_stream="egm" in table)
        )
        self.controller.timer_factor = world.watchdog_factor
        faults = LinkFaults({kind: {} for kind in (*LINK_FAULTS, *STREAM_FAULTS)}, world.clock.real_now_s)
        self.server = self._make_server(table, faults)
        super().__init__(name, arm, self.server, faults)
        self._stream = JointSender.from_table(
            table, "egm", encode_robot_message, faults, world.clock.real_now_s
        )
        c = self.controller
        self._events |= {
            "stream_restart": lambda _: self._stream.restart(),
            "emergency_stop": lambda _: c.press_emergency_stop(),
            "manual_mode": lambda _: c.turn_mode_switch("MANR"),
            "program_stop": lambda _: c.server.task.stop_program(),
            "pointer_to_main": lambda _: c.server.restart(),
            "external_moved": self._move_external_axis,
            "override": lambda p: c.set_speed(int(p.pop("percent", 100))),
            "tool_switched": self._switch_tool,
            "counters_lost": lambda p: c.lose_counters(parse_axes(p.pop("axes", "all"), _AXES)),
            "calibration_lost": lambda p: c.lose_calibration(parse_axes(p.pop("axes", "all"), _AXES)),
            "update_counter": lambda p: c.update_counter(parse_axes(p.pop("axis", "1"), _AXES)[0]),
            "fine_calibrate": lambda p: c.fine_calibrate(parse_axes(p.pop("axis", "1"), _AXES)[0]),
            "auto_mode": lambda _: c.turn_to_auto(),
            "mend": lambda _: c.mend(),
            "program_start": lambda _: c.turn_to_auto(),
            "second_robot": lambda p: setattr(c, "has_second_robot", bool(p.pop("there", True))),
            "events_logged": lambda p: c.note_programs(int(p.pop("count", 1))),
            "log_cleared": lambda _: c.log.clear(),
            "sessions_expired": lambda _: self.server.sessions.end_all(),
            "files_deleted": lambda _: c.files.contents.clear(),
        }

    def _make_server(self, table: Mapping[str, Any], faults: LinkFaults) -> HttpPort:
        host = str(table.get("address", "127.0.0.1"))
        if int(table.get("settings", {}).get("generation", 1)) == 2:
            resources = OmnicoreResources(self.controller)
            return OmnicorePort(host, int(table.get("port", 443)), resources, faults)
        return ServicePort(host, int(table.get("port", 80)), ResourceTable(self.controller), faults)

    def _begin_tasks(self) -> list[asyncio.Task[None]]:
        return [keep_running(f"programs of {self.name}", self._follow_programs)]

    async def _follow_programs(self) -> None:
        try:
            while True:
                self.controller.run_program()
                if self.controller.program_runs and self.controller.server.task.streams:
                    self._stream.send_joints(self.controller.arm.controller_joints_rad.tolist())
                await asyncio.sleep(_CYCLE_REAL_S)
        finally:
            self._stream.close()

    def true_state(self) -> JsonObject:
        c = self.controller
        return {
            **self._true_arm(),
            "mode": c.mode,
            "motors": c.motors,
            "state": int(float(c.read_symbol("CellcalServer/nState") or 0)),
            "external": list(c.external),
            "axis_states": list(c.axis_states),
            "files": {name: content.hex() for name, content in c.files.contents.items()},
            "controller_joints_rad": c.arm.controller_joints_rad.tolist(),
            "stream_answers": self._stream.answer_count(),
            "error_rad": c.counters.error_rad.tolist(),
            "active": {
                "tool_number": None,
                "user_frame_number": 0,
                "flange_tool": c.tool_matrix().tolist(),
                "payload_kg": c.payload_kg(),
            },
        }

    def _move_external_axis(self, parameters: dict[str, Any]) -> None:
        """Drive a track or positioner, as another program or a person may; it is there from then on."""
        axis, value = str(parameters.pop("axis", "a")), float(parameters.pop("value"))
        self.controller.external["abcdef".index(axis)] = value

    def _switch_tool(self, parameters: dict[str, Any]) -> None:
        c = self.controller
        names = c.tool_names()
        place = (
            names.index(c.tool_name) if c.tool_name in names else 0
        )  # CellcalServer moves with a copy of it
        following = names[(place + 1) % len(names)]
        c.tool_name = str(parameters.pop("tool", following))


def create_device(world: World, table: Mapping[str, Any]) -> FakeAbbRobot:
    """Build the robot that a cell file names."""
    return FakeAbbRobot(world, table)
