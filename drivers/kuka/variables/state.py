"""What a KUKA controller says of itself through its variables, and what it means to a person."""

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import TypeVar

from cellcal.calibration.documents.plain_numbers import parse_number
from cellcal.calibration.geometry import Pose
from cellcal.calibration.mastering.position_record import ShownValue
from cellcal.calibration.message import make_message
from cellcal.drivers.errors import RefusedError, WireProtocolError
from cellcal.drivers.interfaces import Alarm, AlarmKind, Condition, Readiness
from cellcal.drivers.kuka.variables.values import AXES, read_axes, read_flag, read_name, read_pose
from cellcal.drivers.kuka.variables.variable_link import VariableLink
from cellcal.drivers.wire.possible_values import check_override

T = TypeVar("T")
_AUTOMATIC = ("#AUT", "#EX")
_LOST = "AXIS_CAL"


@dataclass(frozen=True, slots=True)
class ControllerState:
    """Switches and messages of the controller."""

    mode: str
    has_drives: bool
    has_safety: bool
    has_stop: bool
    lost_axes: tuple[int, ...]  # 0-based; empty also where the controller does not tell


async def read_value(link: VariableLink, variable: str, convert: Callable[[str], T]) -> T:
    """Return a variable's value.

    Raises
    ------
    WireProtocolError
        It cannot be read as what it should be.
    """
    text = await link.read_variable(variable)
    try:
        return convert(text)
    except ValueError as error:
        raise WireProtocolError(
            link.device,
            make_message("the value of {variable} cannot be read: {error}.", variable=variable, error=error),
            remedy="Report this with the log of the wire.",
            frame=text[:200],
        ) from error


async def read_state(link: VariableLink) -> ControllerState:
    """Read mode, drives, safety, stop messages and mastering."""
    return ControllerState(
        await read_mode(link),
        await read_value(link, "$PERI_RDY", read_flag),
        await read_value(link, "$USER_SAF", read_flag),
        await read_value(link, "$STOPMESS", read_flag),
        await _read_lost_axes(link),
    )


async def read_mode(link: VariableLink) -> str:
    """Read the mode as the controller names it, such as ``#T1``."""
    return await read_value(link, "$MODE_OP", read_name)


async def _read_lost_axes(link: VariableLink) -> tuple[int, ...]:
    """Return the axes that are not mastered; none where this software does not have the variable.

    Raises
    ------
    RefusedError
        A variable is not given that was given before, or of one axis and not of another: nothing is known then.
    """
    first = await _read_first_flag(link)
    if first is None:
        return ()
    flags = [first, *[await read_value(link, f"${_LOST}[{axis + 1}]", read_flag) for axis in range(1, AXES)]]
    return tuple(axis for axis, mastered in enumerate(flags) if not mastered)


async def tells_mastering(link: VariableLink) -> bool:
    """Return whether this software says of each axis if it is mastered; raise where it did, and does not now."""
    return await _read_first_flag(link) is not None


async def _read_first_flag(link: VariableLink) -> bool | None:
    first = f"${_LOST}[1]"
    try:
        return await read_value(link, first, read_flag)
    except RefusedError:
        if first in link.known_variables:
            raise
        return None


async def read_position_data(link: VariableLink) -> tuple[ShownValue, ...]:
    """Return joints, mastering angles and flags as texts; what this software does not have is left out."""
    joints_rad = await read_value(link, "$AXIS_ACT", read_axes)
    found = [
        ShownValue("$AXIS_ACT", f"{math.degrees(joint_rad):.9g}", axis, "deg")
        for axis, joint_rad in enumerate(joints_rad)
    ]
    checks: dict[str, Callable[[str], object]] = {"$MAMES": parse_number, f"${_LOST}": read_flag}
    for name, check in checks.items():
        try:
            texts = [await _read_checked_text(link, f"{name}[{axis + 1}]", check) for axis in range(AXES)]
        except RefusedError:
            continue
        constant = name == "$MAMES"  # the angle at the notch; changing it shifts the robot for good
        unit = "deg" if constant else ""
        found += [ShownValue(name, text, axis, unit, constant) for axis, text in enumerate(texts)]
    return tuple(found)


async def _read_checked_text(link: VariableLink, variable: str, check: Callable[[str], object]) -> str:
    """Return a value as it is written, once it can be read as what it should be; errors as for ``read_value``."""

    def convert(text: str) -> str:
        check(text)
        return text.strip()

    return await read_value(link, variable, convert)


async def read_robot_root(link: VariableLink) -> Pose:
    """Return the robot's base seen from WORLD, where the controller has its bases; WORLD where it does not tell.

    It is turned for an arm on a ceiling or a wall, and shifted for one on a pedestal.
    """
    try:
        return await read_value(link, "$ROBROOT", read_pose)
    except RefusedError:
        return Pose((0.0, 0.0, 0.0))


async def refuse_external_tool(link: VariableLink) -> None:
    """Refuse a tool that stands beside the robot: the position that is shown then is not that of the flange."""
    try:
        mode = await link.read_variable("$IPO_MODE")
    except RefusedError:
        return
    if mode.strip().upper() == "#TCP":
        raise RefusedError(
            link.device,
            "the active tool stands beside the robot ($IPO_MODE is #TCP).",
            remedy="Select the tool that the robot carries.",
        )


async def read_fraction(link: VariableLink, variable: str) -> float:
    """Return a percentage as a share from 0 to 1."""
    return check_override(link.device, await read_value(link, variable, parse_number) / 100.0)


def condition_of(state: ControllerState) -> Condition:
    """Say whether the robot can be used, and who must act. A lost position comes before everything else."""
    alarms = tuple(
        Alarm(_LOST, make_message("axis A{axis} is not mastered", axis=axis + 1), axis, AlarmKind.TURNS)
        for axis in state.lost_axes
    )
    if alarms:
        axes = ", ".join(f"A{axis + 1}" for axis in state.lost_axes)
        remedy = "Master it with the EMD at the pendant, with the tool's load offset, then run a drift check."
        text = make_message("not mastered: {axes}.", axes=axes)
        return Condition(Readiness.POSITION_LOST, text, remedy, alarms, _stop_of(state))
    if (stop := _stop_of(state)) is not None:
        return stop
    if state.mode not in _AUTOMATIC:
        return Condition(
            Readiness.NOT_READY,
            make_message("the controller is in {mode}, not in AUT or EXT.", mode=state.mode.lstrip("#")),
            "Turn the mode switch to AUT or EXT.",
        )
    if not state.has_drives:
        return Condition(Readiness.STOPPED, "the drives are off.", "Switch the drives on at the pendant.")
    return Condition(Readiness.READY)


def _stop_of(state: ControllerState) -> Condition | None:
    """Return what stops the robot whatever its position is; in T1 and T2 a person jogs with the gate open."""
    if not state.has_safety and state.mode in _AUTOMATIC:
        return Condition(
            Readiness.STOPPED,
            "the operator safety is open.",
            "Close the safety gate and acknowledge at the pendant.",
        )
    if state.has_stop:
        return Condition(
            Readiness.STOPPED,
            "a stop message is active.",
            "Read the message at the pendant and acknowledge it.",
        )
    return None
