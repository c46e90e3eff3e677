"""The Yaskawa robot of a cell: arm, controller and ports put together, and what can happen to them.

Imitates
    A Motoman arm on a YRC1000 whose High Speed Ethernet Server is switched on.
Source
    drivers' README of the brand for the facts; packets.py for the wire.
Modelled
    The faults named in ``_EVENTS`` and ``fake_devices.yaskawa.server.LINK_FAULTS``.
Not modelled
    See the modules of this package.
"""

from collections.abc import Mapping
from typing import Any

from cellcal.fake_devices.device import JsonObject
from cellcal.fake_devices.kinematics import matrix_from_xyzwpr
from cellcal.fake_devices.link_faults import LinkFaults
from cellcal.fake_devices.networked_robot import NetworkedRobot, parse_axes
from cellcal.fake_devices.shown_joints import ShownJoints, ratios_of
from cellcal.fake_devices.world import World
from cellcal.fake_devices.yaskawa.commands import CommandTable
from cellcal.fake_devices.yaskawa.controller import AXES, PLAY, REMOTE, TEACH, YaskawaController
from cellcal.fake_devices.yaskawa.server import LINK_FAULTS, HsesServer


class FakeYaskawaRobot(NetworkedRobot):
    """One controller on one loopback address."""

    def __init__(self, world: World, table: Mapping[str, Any]) -> None:
        name = str(table["name"])
        arm = world.add_arm(name, str(table["model"]))
        title = str(table.get("controller_type", "unknown"))
        homes = ShownJoints(arm, ratios_of(table, len(AXES)), world.make_rng(name, "encoders"))
        self.controller = YaskawaController(arm, table["pulses_per_degree"], homes, title)
        faults = LinkFaults({kind: {} for kind in LINK_FAULTS}, world.clock.real_now_s)
        ports = (int(table.get("port", 10040)), int(table.get("file_port", 10041)))
        host = str(table.get("address", "127.0.0.1"))
        self.server = HsesServer(host, ports, CommandTable(self.controller), faults)
        super().__init__(name, arm, self.server, faults)
        c = self.controller
        self._events |= {
            "emergency_stop": lambda _: c.press_emergency_stop(),
            "release_emergency_stop": lambda _: c.release_emergency_stop(),
            "teach_mode": lambda _: c.turn_mode_switch(TEACH),
            "play_mode": lambda _: c.turn_mode_switch(PLAY),
            "remote_mode": lambda _: c.turn_mode_switch(REMOTE),
            "pendant_hold": lambda _: c.hold_by_hand("pendant", on=True),
            "release_hold": lambda _: c.hold_by_hand("pendant", on=False),
            "override": lambda p: c.set_override(int(p.pop("percent", 100))),
            "tool_switched": self._switch_tool,
            "alarm": lambda p: c.raise_alarm(
                int(p.pop("code", 4320)), str(p.pop("text", "OVERLOAD(CONTINUE)"))
            ),
            "reset_alarm": lambda _: self._reset_by_hand(),
            "battery_loss": lambda p: c.lose_positions(parse_axes(p.pop("axes", "all"), AXES)),
            "type_absolute_data": lambda p: c.type_absolute_data(parse_axes(p.pop("axis", "S"), AXES)[0]),
            "make_home": lambda p: c.make_home(parse_axes(p.pop("axis", "S"), AXES)[0]),
            "confirm_positions": lambda _: c.confirm_positions(),
            "second_robot": lambda p: setattr(c, "has_second_robot", bool(p.pop("there", True))),
            "external_moved": self._move_external_axis,
            "jog_by_hand": self._jog_by_hand,
        }

    def true_state(self) -> JsonObject:
        c, arm = self.controller, self.controller.arm
        return {
            **self._true_arm(),
            "controller_joints_rad": arm.controller_joints_rad.tolist(),
            "pulses": list(c.pulses()),
            "error_rad": c.homes.error_rad.tolist(),
            "mode": c.mode,
            "servo_power": c.has_servo_power,
            "holds": dict(c.holds),
            "alarms": [{"code": code, "text": text} for code, _, _, text in c.alarms],
            "active": {
                "tool_number": c.tool_number,
                "user_frame_number": c.user_frame,
                "flange_tool": matrix_from_xyzwpr(c.tools[c.tool_number]).tolist(),
                "payload_kg": c.masses_kg[c.tool_number],
            },
        }

    def _switch_tool(self, parameters: dict[str, Any]) -> None:
        c = self.controller
        c.tool_number = int(parameters.pop("number", (c.tool_number + 1) % len(c.tools)))

    def _move_external_axis(self, parameters: dict[str, Any]) -> None:
        """Drive an axis of B1 or S1 to pulses, as a person may; the group is there from then on."""
        group, axis = str(parameters.pop("group", "B1")), int(parameters.pop("axis", 1))
        instance = {"B": 10, "S": 20}[group[:1]] + int(group[1:])
        pulses = self.controller.stations.setdefault(instance, [0] * (3 if group[:1] == "B" else 6))
        pulses[axis - 1] = int(parameters.pop("pulses"))

    def _reset_by_hand(self) -> None:
        self.controller.reset_alarms()
        self.controller.has_servo_power = not (self.controller.alarms or self.controller.emergency_stop)

    def _jog_by_hand(self, parameters: dict[str, Any]) -> None:
        arm = self.controller.arm
        self.controller.is_jogged = True
        target = arm.joints_rad
        target[parse_axes(parameters.pop("axis", "S"), AXES)[0]] += float(parameters.pop("rad", 0.01))
        arm.start_move(target, float(parameters.pop("speed_rad_s", 0.5)), 2.0)


def create_device(world: World, table: Mapping[str, Any]) -> FakeYaskawaRobot:
    """Build the robot that a cell file names."""
    return FakeYaskawaRobot(world, table)
