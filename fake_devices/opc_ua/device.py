"""The robot with an OPC UA server of a cell: arm, controller and server put together, and what can happen to them.

Imitates
    Any maker's robot whose controller serves OPC UA for Robotics.
Source
    controller.py, robotics_space.py, server.py.
Modelled
    The faults named below and ``fake_devices.opc_ua.server.LINK_FAULTS``; values that are spoilt at a node whose path
    ends in ``node``.
Not modelled
    See the modules of this package.
"""

import math
import random
from collections.abc import Mapping
from dataclasses import replace
from typing import Any

from asyncua import ua

from cellcal.fake_devices.device import FaultRefusedError, JsonObject
from cellcal.fake_devices.link_faults import LinkFaults
from cellcal.fake_devices.networked_robot import NetworkedRobot, parse_axes
from cellcal.fake_devices.opc_ua.controller import (
    AUTOMATIC,
    EXTERNAL,
    MANUAL_HIGH,
    MANUAL_REDUCED,
    NamePlate,
    RobotController,
)
from cellcal.fake_devices.opc_ua.node_table import NodeTable
from cellcal.fake_devices.opc_ua.robotics_space import RobotLayout, SpaceBuilder
from cellcal.fake_devices.opc_ua.server import LINK_FAULTS, OpcUaPort
from cellcal.fake_devices.opc_ua.server_guard import ServerGuard
from cellcal.fake_devices.world import World

_MODES = {"manual": MANUAL_REDUCED, "manual_high": MANUAL_HIGH, "automatic": AUTOMATIC, "external": EXTERNAL}
_JOG_RAD_S2 = 2.0
_ACCESS_KEYS = ("certificate", "private_key", "users")
_VALUE_FAULTS: Mapping[str, Mapping[str, Any]] = {
    "bad_status": {"node": "", "code": "BadSensorFailure"},
    "not_a_number": {"node": "", "value": "nan"},
    "wrong_type": {"node": "", "text": "12.5"},
    "no_value": {"node": ""},
    "other_value": {"node": "", "value": 0},
    "frozen_value": {"node": ""},  # good status, and the time with which it was read first
}


class FakeOpcUaRobot(NetworkedRobot):
    """One controller on one loopback address."""

    def __init__(self, world: World, table: Mapping[str, Any]) -> None:
        name = str(table["name"])
        arm = world.add_arm(name, str(table["model"]))
        self.controller = RobotController(arm, NamePlate(serial=str(table.get("serial", "0"))))
        settings = dict(table.get("settings", {}))
        access = {key: settings.pop(key) for key in _ACCESS_KEYS if key in settings}
        self._frozen: dict[str, ua.DataValue] = {}  # by the node's path
        self.layout = _layout_of(settings, len(arm.joints_rad))
        kinds = {**{kind: {} for kind in LINK_FAULTS}, **_VALUE_FAULTS}
        faults = LinkFaults(kinds, world.clock.real_now_s)
        self._rng = random.Random(world.seed)  # the order of namespaces only
        host, port = str(table.get("address", "127.0.0.1")), int(table.get("port", 4840))
        guard = ServerGuard.from_settings(access)
        self.server = OpcUaPort(host, port, self._build_table(faults), faults, guard)
        super().__init__(name, arm, self.server, faults)
        c = self.controller
        self._events |= {
            "emergency_stop": lambda _: c.press_emergency_stop(),
            "protective_stop": lambda _: c.enter_protective_stop(),
            "mend": lambda _: c.mend(),
            "mode": self._turn_mode_switch,
            "override": self._turn_override,
            "jog_by_hand": self._jog_by_hand,
            "restart": self._restart,
            "shuffle_namespaces": lambda _: self._shuffle_in_place(),
            "other_robot": self._exchange_robot,
        }

    def true_state(self) -> JsonObject:
        c = self.controller
        return {
            **self._true_arm(),
            "controller_joints_rad": c.arm.controller_joints_rad.tolist(),
            "mode": c.mode,
            "emergency_stop": c.emergency_stop,
            "protective_stop": c.protective_stop,
            "override_percent": c.override_percent,
            "namespaces": list(self.layout.namespaces),
        }

    def _build_table(self, faults: LinkFaults) -> NodeTable:
        def corrupt(path: str, value: ua.DataValue) -> ua.DataValue:
            for kind in _VALUE_FAULTS:
                found = faults.active_parameters(kind)
                if found is not None and found["node"] and path.endswith(str(found["node"])):
                    if kind == "frozen_value":
                        return self._frozen.setdefault(path, value)
                    return _corrupt_value(kind, found, value)
            return value

        return SpaceBuilder(self.controller, self.layout, corrupt).build()

    def _turn_mode_switch(self, parameters: dict[str, Any]) -> None:
        self.controller.mode = _MODES[str(parameters.pop("mode", "manual"))]

    def _turn_override(self, parameters: dict[str, Any]) -> None:
        self.controller.override_percent = float(parameters.pop("percent", 100))

    def _jog_by_hand(self, parameters: dict[str, Any]) -> None:
        arm = self.controller.arm
        names = tuple(f"J{number}" for number in range(1, len(arm.joints_rad) + 1))
        target = arm.joints_rad
        target[parse_axes(parameters.pop("axis", "J1"), names)[0]] += float(parameters.pop("rad", 0.1))
        speed = float(parameters.pop("speed_rad_s", 0.5))
        if not math.isfinite(speed) or speed <= 0:
            raise ValueError("speed_rad_s is a positive number")
        arm.start_move(target, speed, _JOG_RAD_S2)

    def _restart(self, parameters: dict[str, Any]) -> None:
        """Restart the server; keys of the layout may change with it."""
        if parameters.pop("shuffled", False):
            self._shuffle_namespaces()
        changes = {key: parameters.pop(key) for key in tuple(parameters) if key in _LAYOUT_KEYS}
        self.layout = _changed(self.layout, changes)
        self.server.restart(self._build_table(self._faults))

    def _shuffle_namespaces(self) -> None:
        base, *others = self.layout.namespaces
        before = list(others)
        while others == before:
            self._rng.shuffle(others)
        self.layout = replace(self.layout, namespaces=(base, *others))

    def _shuffle_in_place(self) -> None:
        """Reorder the namespaces while clients stay connected."""
        self._shuffle_namespaces()
        self.server.state.table = self._build_table(self._faults)

    def _exchange_robot(self, parameters: dict[str, Any]) -> None:
        self.controller.plate = replace(
            self.controller.plate, serial=str(parameters.pop("serial", "X-000000"))
        )
        self.server.restart(self._build_table(self._faults))


_LAYOUT_KEYS = frozenset(
    ("devices", "machines", "axis_names", "units", "absent", "has_vendor_types", "namespaces")
)


def _changed(layout: RobotLayout, changes: Mapping[str, Any]) -> RobotLayout:
    lists: dict[str, Any] = {
        key: tuple(value) if isinstance(value, list) else value for key, value in changes.items()
    }
    for key in ("absent", "machines"):
        if key in lists:
            lists[key] = frozenset(lists[key])
    return replace(layout, **lists)


def _layout_of(settings: Mapping[str, Any], axes: int) -> RobotLayout:
    """Return the layout that [fake.robots.NAME] describes."""
    if unknown := set(settings) - _LAYOUT_KEYS:
        raise ValueError(f"an OPC UA robot has no setting {', '.join(sorted(unknown))}")
    usual = RobotLayout(
        axis_names=tuple(f"Axis_{number}" for number in range(1, axes + 1)), units=("deg",) * axes
    )
    return _changed(usual, settings)


def _corrupt_value(kind: str, found: Mapping[str, Any], value: ua.DataValue) -> ua.DataValue:
    if kind == "bad_status":
        code = getattr(ua.StatusCodes, str(found["code"]), None)
        if code is None:
            raise FaultRefusedError(f"there is no status code {found['code']!r}")
        return replace(value, StatusCode=ua.StatusCode(ua.UInt32(code)))
    if kind == "not_a_number":
        return replace(value, Value=ua.Variant(float(found["value"]), ua.VariantType.Double))
    if kind == "wrong_type":
        return replace(value, Value=ua.Variant(str(found["text"]), ua.VariantType.String))
    if kind == "no_value":
        return replace(value, Value=ua.Variant())
    assert value.Value is not None
    return replace(value, Value=ua.Variant(found["value"], value.Value.VariantType))


def create_device(world: World, table: Mapping[str, Any]) -> FakeOpcUaRobot:
    """Build the robot that a cell file names."""
    return FakeOpcUaRobot(world, table)
