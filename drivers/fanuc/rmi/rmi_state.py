"""What the controller says over the Remote Motion Interface: status, joints, frames, alarms."""

import math
import re
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from cellcal.calibration.geometry import Pose, homogeneous_matrix
from cellcal.calibration.message import make_message
from cellcal.calibration.orientation import rotation_from, values_from
from cellcal.drivers.errors import WireProtocolError
from cellcal.drivers.fanuc.rmi.rmi_link import Packet, RmiLink
from cellcal.drivers.interfaces import Alarm, AlarmKind, Condition, Readiness, ShownExternalAxis
from cellcal.drivers.wire.link_errors import unreadable_answer_error
from cellcal.drivers.wire.possible_values import check_joints, check_pose
from cellcal.drivers.wire.tables import code_table

AXES = 6
_MOST_AXES, _SECOND_GROUP = 9, 2
_FRAME_KEYS = ("X", "Y", "Z", "W", "P", "R")
_ALARM_CODE = re.compile(r"\b(SRVO)-(\d{3})\b\s*(.*)", re.DOTALL)
_ALARM_AXIS = re.compile(r"A(?:xis)?\s*:\s*(\d+)", re.IGNORECASE)
_SERVO_FAMILY = 11_000
_KINDS = {
    "lost": AlarmKind.TURNS,
    "index": AlarmKind.TURNS,
    "encoder": AlarmKind.ENCODER,
    "collision": AlarmKind.COLLISION,
    "battery_low": AlarmKind.BATTERY_LOW,
    "stopped": AlarmKind.OTHER,
}
_MOST_ALARMS = 5
_DEADMAN = "SRVO-003"  # the enabling device is released: between two jogs by hand that is no stop


@dataclass(frozen=True, slots=True)
class RmiStatus:
    """The reply of FRC_GetStatus."""

    has_servo_power: bool
    pendant_enabled: bool
    motion_runs: bool
    single_step: bool
    next_sequence_id: int
    override: float  # 0 to 1


async def read_status(link: RmiLink) -> RmiStatus:
    """Read the status of controller and motion program."""
    reply = await link.send_command("FRC_GetStatus")
    return RmiStatus(
        _number_from(link, reply, "ServoReady") != 0,
        _number_from(link, reply, "TPMode") != 0,
        _number_from(link, reply, "RMIMotionStatus") != 0,
        _number_from(link, reply, "SingleStepMode", 0.0) != 0,
        _whole_number_from(link, reply, "NextSequenceID", 1.0),
        _number_from(link, reply, "Override", 100.0) / 100.0,
    )


async def read_joint_angles(link: RmiLink) -> tuple[tuple[float, ...], Packet]:
    """Return J1 to J6 [rad], as the pendant shows them, and the reply."""
    reply = await link.send_command("FRC_ReadJointAngles")
    angles = reply.get("JointAngle", reply.get("JointAngles"))
    if not isinstance(angles, Mapping):
        raise _unreadable_error(link, "there are no joint angles")
    joints = tuple(math.radians(_number_from(link, angles, f"J{axis}")) for axis in range(1, AXES + 1))
    return check_joints(link.device, joints), reply


@dataclass(frozen=True, slots=True)
class RmiPosition:
    """The reply of FRC_ReadCartesianPosition: where everything of group 1 stands, and in which frames it is told."""

    user_tip: Pose
    user_number: int
    tool_number: int
    external_axes: tuple[ShownExternalAxis, ...]  # of group 1; an arm of six axes tells three, as zero


async def read_position(link: RmiLink) -> RmiPosition:
    """Read the tip in the active user frame, the numbers of user frame and tool, and the axes beside the arm."""
    reply = await link.send_command("FRC_ReadCartesianPosition")
    position, configuration = reply.get("Position"), reply.get("Configuration")
    if not isinstance(position, Mapping) or not isinstance(configuration, Mapping):
        raise _unreadable_error(link, "there is no position")
    beside = [number for number in range(1, _MOST_AXES - AXES + 1) if f"Ext{number}" in position]
    return RmiPosition(
        _pose_from(link, position),
        _whole_number_from(link, configuration, "UFrameNumber"),
        _whole_number_from(link, configuration, "UToolNumber"),
        tuple(
            ShownExternalAxis(f"E{number}", _number_from(link, position, f"Ext{number}")) for number in beside
        ),
    )


async def read_second_group(link: RmiLink) -> tuple[ShownExternalAxis, ...]:
    """Return where the axes of motion group 2 stand."""
    reply = await link.send_command("FRC_ReadJointAngles", Group=_SECOND_GROUP)
    if reply.get("Group") != _SECOND_GROUP:
        raise _unreadable_error(link, "it is of another motion group")
    angles = reply.get("JointAngle", reply.get("JointAngles"))
    if not isinstance(angles, Mapping):
        raise _unreadable_error(link, "there are no joint angles")
    return tuple(
        ShownExternalAxis(f"group 2 J{axis}", _number_from(link, angles, f"J{axis}"))
        for axis in range(1, _MOST_AXES + 1)
        if f"J{axis}" in angles
    )


async def read_frame(link: RmiLink, kind: str, number: int) -> Pose:
    """Return tool frame (``UTool``, seen from the flange) or user frame (``UFrame``, seen from the base)."""
    key = _number_key(kind)
    reply = await link.send_command(f"FRC_Read{kind}Data", **{key: number})
    if any(reply.get(one, number) != number for one in (key, f"{kind}Number")):
        raise _unreadable_error(link, "it is of another frame")
    frame = reply.get("Frame")
    if not isinstance(frame, Mapping):
        raise _unreadable_error(link, "there is no frame")
    return _pose_from(link, frame)


async def write_frame(link: RmiLink, kind: str, number: int, pose: Pose) -> None:
    """Write a tool frame or user frame."""
    wpr = np.degrees(values_from("fanuc_wpr", pose.rotation_matrix()))
    values = [*(value * 1e3 for value in pose.position_m), *(float(angle) for angle in wpr)]
    frame = dict(zip(_FRAME_KEYS, values, strict=True))
    await link.send_command(f"FRC_Write{kind}Data", **{_number_key(kind): number}, Frame=frame)


async def read_alarm_texts(link: RmiLink) -> tuple[str, ...]:
    """Return the newest messages of the controller."""
    reply = await link.send_command("FRC_ReadError", Count=_MOST_ALARMS)
    keys = ("ErrorData", *(f"ErrorData{number}" for number in range(2, _MOST_ALARMS + 1)))
    texts = (reply.get(key) for key in keys)
    return tuple(text.strip() for text in texts if isinstance(text, str) and text.strip())


def condition_of(status: RmiStatus, texts: tuple[str, ...]) -> Condition:
    """Say whether the robot can be used, and who must act. A lost position comes before everything else."""
    alarms = tuple(_alarm_of(text) for text in texts)
    lost = next((alarm for alarm in alarms if alarm.kind is AlarmKind.TURNS), None)
    if lost is not None and not status.has_servo_power:
        remedy = "Follow the mastering recovery: only a person at the pendant can move this axis now."
        return Condition(
            Readiness.POSITION_LOST,
            make_message("{lost_code} {lost_text}.", lost_code=lost.code, lost_text=lost.text),
            remedy,
            alarms,
            _stop_since(lost, alarms),
        )
    is_let_go = status.pendant_enabled and (not alarms or alarms[0].code == _DEADMAN)
    if not status.has_servo_power and not is_let_go:
        return replace(_power_off(alarms[0] if alarms else None), alarms=alarms)
    if status.pendant_enabled:
        remedy = "Switch the teach pendant off and the mode switch to AUTO."
        return Condition(Readiness.NOT_READY, "the teach pendant is enabled.", remedy)
    if status.single_step:
        return Condition(
            Readiness.NOT_READY, "the single step mode is on.", "Switch single step off at the pendant."
        )
    return Condition(Readiness.READY)


def _stop_since(lost: Alarm, alarms: tuple[Alarm, ...]) -> Condition | None:
    """Return the stop that was told after the loss; an older message may be one that was released."""
    newer = alarms[: alarms.index(lost)]
    stop = next((alarm for alarm in newer if alarm.kind is AlarmKind.OTHER), None)
    return None if stop is None else _power_off(stop)


def _power_off(alarm: Alarm | None) -> Condition:
    text = "the servo power is off."
    if alarm is not None:
        text = make_message("{alarms_code} {alarms_text}.", alarms_code=alarm.code, alarms_text=alarm.text)
    remedy = "Look at the cell, release the emergency stop and reset on the pendant."
    return Condition(Readiness.STOPPED, text, remedy)


def _alarm_of(text: str) -> Alarm:
    found, axis = _ALARM_CODE.search(text), _ALARM_AXIS.search(text)
    if found is None:
        return Alarm("", text)
    entry = code_table("cellcal.drivers.modbus_robot", "alarms.tsv").get(_SERVO_FAMILY + int(found[2]))
    kind = AlarmKind.UNKNOWN if entry is None else _KINDS.get(entry.kind, AlarmKind.UNKNOWN)
    return Alarm(
        "-".join((found[1], found[2])),
        found[3].strip(),
        int(axis[1]) - 1 if axis else None,
        kind,
    )


def _number_key(kind: str) -> str:
    return "ToolNumber" if kind == "UTool" else "FrameNumber"


def _pose_from(link: RmiLink, values: Mapping[str, Any]) -> Pose:
    x, y, z, w, p, r = (_number_from(link, values, key) for key in _FRAME_KEYS)
    rotation = rotation_from("fanuc_wpr", np.radians([w, p, r]))
    return check_pose(link.device, Pose.from_matrix(homogeneous_matrix(rotation, np.array([x, y, z]) * 1e-3)))


def _number_from(link: RmiLink, values: Mapping[str, Any], key: str, otherwise: float | None = None) -> float:
    value = values.get(key, otherwise)
    if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
        raise _unreadable_error(link, make_message("{text} is no finite number", text=key))
    return float(value)


def _whole_number_from(
    link: RmiLink, values: Mapping[str, Any], key: str, otherwise: float | None = None
) -> int:
    number = _number_from(link, values, key, otherwise)
    if not number.is_integer():
        raise _unreadable_error(link, make_message("{text} is no whole number", text=key))
    return int(number)


def _unreadable_error(link: RmiLink, what: str) -> WireProtocolError:
    return unreadable_answer_error(
        link.device, what, "Report this with the log of the wire.", link.trace.last_received()
    )
