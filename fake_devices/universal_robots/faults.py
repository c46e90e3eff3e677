"""What can happen to a fake controller, by name, at run time.

Imitates
    Stops, operators, other clients, cables and programs that fail.
Source
    README of this package, faults; the fault table of the design.
Modelled
    The table ``FAULTS``; each entry names its parameters and their defaults.
Not modelled
    Faults of the arm itself: those are the world's.
"""

from collections.abc import Awaitable, Callable, Mapping
from typing import Any

from cellcal.fake_devices.device import FaultRefusedError, JsonObject
from cellcal.fake_devices.universal_robots.controller import UrController
from cellcal.fake_devices.universal_robots.frames import Vector
from cellcal.fake_devices.universal_robots.motion import JointMove
from cellcal.fake_devices.universal_robots.server import RTDE, UniversalRobotServer

FAULTS: dict[str, dict[str, Any]] = {
    "protective_stop": {"unlock_after_s": 0.0},
    "unlock_protective_stop": {},
    "emergency_stop": {},
    "release_emergency_stop": {"power": True},
    "program_stop": {},
    "program_pause": {},
    "link_loss_rtde": {},
    "link_loss_all": {},
    "link_stall": {},
    "link_restore": {},
    "in_use": {},
    "other_client_moves": {"joints": None, "axis": None, "rad": 0.1, "speed": 0.5},
    "hand_moves": {"joints": None, "axis": None, "rad": 0.1},
    "frozen": {},
    "silent_accept": {"port": RTDE},
    "not_found": {"variable": "actual_q"},
    "local_mode": {},
    "remote_mode": {},
    "manual_mode": {},
    "automatic_mode": {},
    "ik_failure": {},
    "late_script": {"delay_s": 2.0},
    "touch": {},
    "api_refuses": {},
    "api_moved": {},
    "api_nonsense": {"text": "not JSON"},
    "speed_slider": {"fraction": 1.0},
    "tool_switched": {"tcp": (0.0, 0.0, 0.1, 0.0, 0.0, 0.0), "payload_kg": None},
}


class _OtherProgram:
    """A program that another client has sent in place of ours: one joint move."""

    name = "other_client"

    def __init__(self, controller: UrController, move: JointMove) -> None:
        self._controller, self._move = controller, move

    def step(self, dt_s: float) -> bool:
        return not self._move.advance(self._controller.point, dt_s)


class UrFaults:
    """The faults of one controller."""

    def __init__(self, server: UniversalRobotServer) -> None:
        self._server, self._c = server, server.controller
        self._acts: dict[str, Callable[[Mapping[str, Any]], Awaitable[None] | None]] = {
            "protective_stop": lambda p: self._c.protective_stop(float(p["unlock_after_s"])),
            "unlock_protective_stop": self._unlock_stop,
            "emergency_stop": lambda _: self._c.emergency_stop(),
            "release_emergency_stop": self._release_stop,
            "program_stop": lambda _: self._c.end_program(),
            "program_pause": self._pause_program,
            "link_loss_rtde": lambda _: server.ports[RTDE].drop_connections(),
            "link_loss_all": lambda _: server.close_ports(),
            "link_stall": lambda _: self._stall_ports(on=True),
            "link_restore": lambda _: self._restore_ports(),
            "in_use": self._in_use,
            "speed_slider": self._move_slider,
            "other_client_moves": self._other_client_moves,
            "hand_moves": self._hand_moves,
            "frozen": self._freeze_rtde,
            "silent_accept": self._silent_accept,
            "not_found": lambda p: server.rtde.hidden_names.add(str(p["variable"])),
            "local_mode": lambda _: self._set_remote(on=False),
            "remote_mode": lambda _: self._set_remote(on=True),
            "manual_mode": lambda _: self._set_automatic(on=False),
            "automatic_mode": lambda _: self._set_automatic(on=True),
            "ik_failure": self._ik_failure,
            "late_script": self._late_script,
            "touch": self._touch_once,
            "api_refuses": self._refuse_api_orders,
            "api_moved": self._move_api,
            "api_nonsense": self._break_api_answers,
            "tool_switched": self._tool_switched,
        }

    async def inject_fault(self, name: str, parameters: Mapping[str, Any]) -> JsonObject:
        """Let one fault happen; refuse unknown names and parameters."""
        if name not in FAULTS:
            raise FaultRefusedError(f"no fault is called {name!r}; there are {', '.join(sorted(FAULTS))}")
        if unknown := set(parameters) - set(FAULTS[name]):
            raise FaultRefusedError(f"{name} does not know {', '.join(sorted(unknown))}")
        pending = self._acts[name]({**FAULTS[name], **parameters})
        if pending is not None:
            await pending
        return {}

    def clear_faults(self) -> None:
        """Take back everything that is not a state of the robot."""
        self._server.cable_in = True  # closed ports open with the next step
        self._stall_ports(on=False)
        for port in self._server.ports.values():
            port.silent = False
        self._server.rtde.hidden_names.clear()
        self._server.rtde.frozen = False
        api = self._server.robot_api
        api.refuses_orders, api.moved, api.broken_answer = False, False, None
        self._c.registers.foreign_owner = False
        self._c.no_inverse_kinematics = False
        self._c.contact_steps = 0
        self._server.loader.start_delay_s = 0.0
        self._c.remote = self._c.automatic = True

    def _unlock_stop(self, _: Mapping[str, Any]) -> None:
        self._c.unlock_protective_stop()

    def _release_stop(self, parameters: Mapping[str, Any]) -> None:
        self._c.release_emergency_stop()
        if parameters["power"]:
            self._c.release_brakes()

    def _pause_program(self, _: Mapping[str, Any]) -> None:
        self._c.pause_program()

    def _stall_ports(self, *, on: bool) -> None:
        for port in self._server.ports.values():
            port.stall_connections(on=on)

    async def _restore_ports(self) -> None:
        self._stall_ports(on=False)
        for port in self._server.ports.values():
            port.silent = False
        await self._server.open_ports()

    def _move_slider(self, parameters: Mapping[str, Any]) -> None:
        self._c.speed_fraction = min(1.0, max(0.0, float(parameters["fraction"])))

    def _in_use(self, _: Mapping[str, Any]) -> None:
        self._c.registers.foreign_owner = True

    def _freeze_rtde(self, _: Mapping[str, Any]) -> None:
        self._server.rtde.frozen = True

    def _hand_moves(self, parameters: Mapping[str, Any]) -> None:
        self._c.end_program()
        self._c.arm.put_joints(_target_joints(self._c.joints_rad, parameters))

    def _silent_accept(self, parameters: Mapping[str, Any]) -> None:
        port = self._server.ports.get(int(parameters["port"]))
        if port is None:
            raise FaultRefusedError(f"there is no port {parameters['port']}")
        port.silent = True

    def _set_remote(self, *, on: bool) -> None:
        self._c.remote = on

    def _set_automatic(self, *, on: bool) -> None:
        self._c.automatic = on

    def _ik_failure(self, _: Mapping[str, Any]) -> None:
        self._c.no_inverse_kinematics = True

    def _late_script(self, parameters: Mapping[str, Any]) -> None:
        self._server.loader.start_delay_s = float(parameters["delay_s"])

    def _touch_once(self, _: Mapping[str, Any]) -> None:
        self._c.contact_steps = 1

    def _refuse_api_orders(self, _: Mapping[str, Any]) -> None:
        self._server.robot_api.refuses_orders = True

    def _move_api(self, _: Mapping[str, Any]) -> None:
        self._server.robot_api.moved = True

    def _break_api_answers(self, parameters: Mapping[str, Any]) -> None:
        self._server.robot_api.broken_answer = str(parameters["text"])

    def _tool_switched(self, parameters: Mapping[str, Any]) -> None:
        """Select another TCP of the installation at the pendant, and optionally another payload."""
        tcp = tuple(float(value) for value in parameters["tcp"])
        if len(tcp) != 6:
            raise FaultRefusedError("tcp is x, y, z [m] and a rotation vector [rad]")
        self._c.set_tcp(tcp)
        if parameters["payload_kg"] is not None:
            self._c.payload_kg = float(parameters["payload_kg"])

    def _other_client_moves(self, parameters: Mapping[str, Any]) -> None:
        c = self._c
        target = _target_joints(c.joints_rad, parameters)
        move = JointMove(c.joints_rad, target, float(parameters["speed"]), 1.0, c.limits_rad_s)
        c.start_program(_OtherProgram(c, move))


def _target_joints(joints_rad: Vector, parameters: Mapping[str, Any]) -> Vector:
    if parameters["joints"] is not None:
        target = tuple(float(value) for value in parameters["joints"])
        if len(target) != 6:
            raise FaultRefusedError("joints must be six angles in rad")
        return target
    axis = parameters["axis"]
    if axis is None:
        raise FaultRefusedError("say joints, or axis and rad")
    index = int(str(axis).upper().removeprefix("J")) - 1
    if not 0 <= index < 6:
        raise FaultRefusedError("axis is J1 to J6")
    return tuple(q + (float(parameters["rad"]) if i == index else 0.0) for i, q in enumerate(joints_rad))
