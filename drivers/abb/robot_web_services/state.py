"""What an ABB controller says of itself, and what it means to a person."""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Any, TypeVar

from cellcal.calibration.documents.plain_numbers import parse_number
from cellcal.calibration.geometry import Pose
from cellcal.calibration.mastering.position_record import ShownValue
from cellcal.calibration.message import make_message
from cellcal.drivers.abb.robot_web_services.event_log import read_position_events
from cellcal.drivers.abb.robot_web_services.rapid_values import AXES, NO_AXIS, pose_of
from cellcal.drivers.abb.robot_web_services.web_link import WebLink
from cellcal.drivers.errors import RefusedError, WireProtocolError
from cellcal.drivers.interfaces import Alarm, AlarmKind, Condition, Readiness, ShownExternalAxis
from cellcal.drivers.wire.link_errors import unreadable_answer_error
from cellcal.drivers.wire.possible_values import check_joints, check_pose

T = TypeVar("T")
_UNIT = "/rw/motionsystem/mechunits/ROB_1"
_MOTOR_CALIBRATION, _OFFSET = "/rw/cfg/MOC/MOTOR_CALIB/instances", "cal_offset"
_SYNCHRONISED = "Synchronized"
_COUNTER_LOST = "20032"
_WITHOUT_ZERO = (
    "NotCommutated",
    "NotCalibrated",
)  # a revolution counter cannot be updated before a calibration
_LONGEST_WORD = 200
_EMERGENCY_STOPS = ("emergencystop", "emergencystopreset")


@dataclass(frozen=True, slots=True)
class ControllerState:
    """Mode, motors, and the axes that are not synchronised, with the controller's word for each."""

    mode: str  # AUTO, MANR, MANF
    motors: str  # motoron, motoroff, guardstop, emergencystop, ...
    lost_axes: Mapping[int, str]  # by 0-based axis
    unit_status: str = _SYNCHRONISED  # of the mechanical unit
    events: tuple[Alarm, ...] = ()  # of the log, where the position is lost

    @property
    def is_position_lost(self) -> bool:
        """Whether an axis, or the mechanical unit as a whole, is not synchronised."""
        return bool(self.lost_axes) or self.unit_status != _SYNCHRONISED


async def read_state(link: WebLink) -> ControllerState:
    """Read mode, motors and the state of each axis."""
    mode = text_of(link, await link.get_state("/rw/panel/opmode"), "opmode")
    motors = text_of(link, await link.get_state(link.dialect.motors_path), "ctrlstate")
    lost = {}
    for axis in range(AXES):
        status = text_of(link, await link.get_state(f"{_UNIT}/axes/{axis + 1}"), "axis-status")
        if status != _SYNCHRONISED:
            lost[axis] = status
    unit = await link.get_state(_UNIT)
    status = text_of(link, unit, "status") if unit.get("status") else _SYNCHRONISED  # it may be left out
    state = ControllerState(mode, motors, lost, status)
    return replace(state, events=await read_position_events(link)) if state.is_position_lost else state


async def read_joints(link: WebLink) -> tuple[tuple[float, ...], Mapping[str, Any]]:
    """Return the joint angles [rad] and the reply."""
    state = await link.get_state(f"{_UNIT}/jointtarget")
    angles = [number_of(link, state, f"rax_{axis}") for axis in range(1, AXES + 1)]
    if any(abs(angle) >= NO_AXIS * 0.9 for angle in angles):
        raise unreadable_error(link, "an axis is missing")
    return check_joints(link.device, tuple(map(math.radians, angles))), state


async def read_external_axes(link: WebLink) -> tuple[ShownExternalAxis, ...]:
    """Return where the external axes that are there stand."""
    _, reply = await read_joints(link)
    names = [name for name in (f"eax_{letter}" for letter in "abcdef") if name in reply]
    places = [ShownExternalAxis(name, number_of(link, reply, name)) for name in names]
    return tuple(place for place in places if abs(place.shown) < NO_AXIS * 0.9)


async def read_position_data(link: WebLink) -> tuple[ShownValue, ...]:
    """Return joints, states of the axes and, where the controller gives its configuration, calibration offsets."""
    _, reply = await read_joints(link)
    joints = [
        ShownValue(f"rax_{axis + 1}", str(reply[f"rax_{axis + 1}"]), axis, "deg") for axis in range(AXES)
    ]
    states = [
        ShownValue(
            "axis-status",
            text_of(link, await link.get_state(f"{_UNIT}/axes/{axis + 1}"), "axis-status"),
            axis,
        )
        for axis in range(AXES)
    ]
    return (*joints, *states, *await _read_calibration_offsets(link))


async def _read_calibration_offsets(link: WebLink) -> tuple[ShownValue, ...]:
    """Return the resolver's angle at the zero of each axis [rad]; none where the configuration is not given."""
    found = []
    for axis in range(AXES):
        try:
            state = await link.get_state(f"{_MOTOR_CALIBRATION}/rob1_{axis + 1}")
        except (RefusedError, WireProtocolError):
            return ()
        rows = state.get("attrib")
        listed = rows if isinstance(rows, list) else []
        values = {row.get("_title"): row.get("value") for row in listed if isinstance(row, dict)}
        if not isinstance(values.get(_OFFSET), str):
            return ()
        valid = "" if values.get(f"valid_{_OFFSET}") == "true" else " (not valid)"
        found.append(ShownValue(_OFFSET, f"{values[_OFFSET]}{valid}", axis, "rad", is_zero=True))
    return tuple(found)


async def read_flange_pose(link: WebLink) -> Pose:
    """Return base_flange: the controller takes tool0 and the base itself."""
    state = await link.get_state(f"{_UNIT}/robtarget", tool="tool0", wobj="wobj0", coordinate="Base")
    position = [number_of(link, state, key) for key in "xyz"]
    quaternion = [number_of(link, state, f"q{k}") for k in range(1, 5)]
    return check_pose(link.device, converted(link, lambda: pose_of(position, quaternion)))


async def read_unit_names(link: WebLink) -> tuple[str, str]:
    """Return the names of the active tool and work object."""
    state = await link.get_state(_UNIT)
    return _name_of(link, state, "tool-name"), _name_of(link, state, "wobj-name")


def condition_of(state: ControllerState) -> Condition:
    """Say whether the robot can be used, and who must act. A lost position comes before everything else."""
    stop = _stop_of(state)
    if state.is_position_lost:
        return replace(_lost_condition(state), stop=stop)
    if stop is not None:
        return stop
    if state.mode != "AUTO":
        return Condition(
            Readiness.NOT_READY,
            make_message("the controller is in {mode}, not in AUTO.", mode=state.mode),
            "Turn the mode switch to AUTO and confirm at the pendant.",
        )
    return _motors_off(state) if state.motors != "motoron" else Condition(Readiness.READY)


def _stop_of(state: ControllerState) -> Condition | None:
    """Return the emergency or guard stop; in manual mode a guard stop is the enabling device when it is released."""
    guarded = state.mode == "AUTO" and state.motors == "guardstop"
    return _motors_off(state) if guarded or state.motors in _EMERGENCY_STOPS else None


def _motors_off(state: ControllerState) -> Condition:
    return Condition(
        Readiness.STOPPED,
        make_message("the motors are off ({motors}).", motors=state.motors),
        "Look at the cell, release the emergency stop, then press the motors-on button.",
    )


def _lost_condition(state: ControllerState) -> Condition:
    alarms = tuple(_alarm_of(axis, word) for axis, word in state.lost_axes.items())
    zeroless = [axis for axis, word in state.lost_axes.items() if word in _WITHOUT_ZERO]
    if zeroless:
        text = make_message(
            "axes {axes} are not calibrated.", axes=", ".join(str(axis + 1) for axis in zeroless)
        )
        remedy = (
            "In manual mode calibrate each of these axes anew, as the maker's manual says: fine calibration, or its "
            "offset from the label. Then update the revolution counters, and run a drift check."
        )
        return Condition(Readiness.POSITION_LOST, text, remedy, (*alarms, *state.events))
    if alarms:
        text = make_message(
            "axes {axes} are not synchronised.", axes=", ".join(str(axis + 1) for axis in state.lost_axes)
        )
    else:
        text = make_message("the mechanical unit is {word}.", word=state.unit_status)
        alarms = (Alarm(_COUNTER_LOST, text, None, AlarmKind.TURNS),)
    remedy = (
        "In manual mode jog each of these axes to its mark and update its revolution counter, then run a drift "
        "check."
    )
    return Condition(Readiness.POSITION_LOST, text, remedy, (*alarms, *state.events))


def _alarm_of(axis: int, word: str) -> Alarm:
    """Return the alarm of an axis that is not synchronised, with what is left of its position."""
    text = make_message("axis {axis}: {word}", axis=axis + 1, word=word)
    if word in _WITHOUT_ZERO:
        return Alarm(word, text, axis, AlarmKind.ENCODER)
    return Alarm(_COUNTER_LOST, text, axis, AlarmKind.TURNS)


def converted(link: WebLink, convert: Callable[[], T]) -> T:
    """Return what ``convert`` returns; its ValueError becomes an error of the device."""
    try:
        return convert()
    except ValueError as error:
        raise unreadable_error(link, str(error)) from error


def number_of(link: WebLink, state: Mapping[str, Any], key: str) -> float:
    """Return a number of a state, which the controller writes as text."""
    value = state.get(key)
    is_number = isinstance(value, str | int | float) and not isinstance(value, bool)
    try:
        return parse_number(str(value) if is_number else "")
    except ValueError as error:
        raise unreadable_error(link, make_message("{text} is no finite number", text=key)) from error


def unreadable_error(link: WebLink, what: str) -> WireProtocolError:
    """Return the error of an answer that is none."""
    return unreadable_answer_error(
        link.device, what, "Report this with the log of the wire.", link.trace.last_received()
    )


def text_of(link: WebLink, state: Mapping[str, Any], key: str) -> str:
    """Return a word of a state; raise WireProtocolError where it is missing, or no word."""
    value = state.get(key)
    if not isinstance(value, str) or not value:
        raise unreadable_error(link, make_message("{name} is missing", name=key))
    if len(value) > _LONGEST_WORD or not value.isprintable():
        raise unreadable_error(link, make_message("{text} is no word", text=key))
    return value


def _name_of(link: WebLink, state: Mapping[str, Any], key: str) -> str:
    """Return the name of RAPID data, which becomes part of a path."""
    name = text_of(link, state, key)
    if not name.isidentifier():
        raise unreadable_error(link, make_message("{text} is no name of RAPID data", text=key))
    return name
