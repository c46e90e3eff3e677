"""What status and alarms mean for a technician."""

import re
from dataclasses import replace

from cellcal.calibration.message import make_message
from cellcal.drivers.interfaces import Alarm, AlarmKind, Condition, Readiness
from cellcal.drivers.yaskawa.state import AlarmEntry, ControllerStatus

# By their text: the numbers differ between controllers, and public lists of them contradict each other.
_POSITION_LOST = re.compile(r"ABSO|OUT OF RANGE|ENCODER BACKUP|HOME POSITION|POSITION CHECK", re.IGNORECASE)
_BATTERY = re.compile(r"BATTERY", re.IGNORECASE)
_ENCODER = re.compile(r"ENCODER", re.IGNORECASE)
_COLLISION = re.compile(r"COLLISION|SHOCK", re.IGNORECASE)
# Where the pendant's language is another, the text is not understood. This number is OUT OF RANGE (ABSO DATA) in
# every public list that was found.
_LOST_NUMBER = 4107
_DATA_ARE_AXES = 3  # the type "user axis" of the alarm's data, as YHSES and a protocol text list the types
_LOST_REMEDY = (
    "Do not move to taught points. Renew the battery if it is empty, reset the alarm, move to the second home "
    "position and confirm it at the pendant; then compare with a measurement."
)
_OTHER_REMEDY = "Read the alarm at the pendant, mend its cause and reset it."
_ON_HOLD = Condition(Readiness.STOPPED, "the robot is on hold.", "Release HOLD at the pendant or the panel.")
_AXES = 8
_UNREADABLE = "\N{REPLACEMENT CHARACTER}"


def describe_alarm(alarm: AlarmEntry) -> tuple[Alarm, ...]:
    """Return an alarm with what it says about the position; one of several axes once for each of them."""
    axes = _axes_of(alarm) or (None,)
    return tuple(Alarm(str(alarm.code), alarm.name, axis, _kind_of(alarm)) for axis in axes)


def condition_of(status: ControllerStatus, alarms: tuple[AlarmEntry, ...]) -> Condition:
    """Say whether the robot can be used, and who must act. A lost position comes before everything else."""
    described = tuple(each for alarm in alarms for each in describe_alarm(alarm))
    stopped = _stopping_alarm(described)
    for alarm in described:
        if alarm.kind is AlarmKind.TURNS:
            return Condition(
                Readiness.POSITION_LOST,
                make_message(
                    "alarm {stopping_code} {stopping_text}.",
                    stopping_code=alarm.code,
                    stopping_text=alarm.text,
                ),
                _LOST_REMEDY,
                described,
                stopped or (_ON_HOLD if status.is_on_hold else None),
            )
    if stopped is not None:
        return replace(stopped, alarms=described)
    return _condition_of_switches(status, described)


def _stopping_alarm(alarms: tuple[Alarm, ...]) -> Condition | None:
    """Return what stops the robot besides a lost position; that one takes the servo power itself."""
    stopping = [alarm for alarm in alarms if alarm.kind not in (AlarmKind.BATTERY_LOW, AlarmKind.TURNS)]
    if not stopping:
        return None
    text = make_message(
        "alarm {stopping_code} {stopping_text}.",
        stopping_code=stopping[0].code,
        stopping_text=stopping[0].text,
    )
    return Condition(Readiness.STOPPED, text, _OTHER_REMEDY)


def _condition_of_switches(status: ControllerStatus, alarms: tuple[Alarm, ...]) -> Condition:
    if not status.is_remote:
        return Condition(
            Readiness.NOT_READY,
            make_message(
                "the controller is in {mode_name}, not in command remote.", mode_name=status.mode_name
            ),
            "Turn the mode switch to REMOTE and enable command remote.",
            alarms,
        )
    if not status.has_servo_power:
        return Condition(
            Readiness.STOPPED,
            "the servo power is off: emergency stop, open door, or not switched on.",
            "Look at the cell, release the emergency stop, then switch the servo power on.",
            alarms,
        )
    if status.is_on_hold:
        return replace(_ON_HOLD, alarms=alarms)
    return Condition(Readiness.READY, alarms=alarms)


def concerns_position(alarm: Alarm) -> bool:
    """Return whether an alarm says something of the encoders or of the position."""
    return alarm.kind in (AlarmKind.TURNS, AlarmKind.ENCODER, AlarmKind.COLLISION, AlarmKind.BATTERY_LOW)


def _kind_of(alarm: AlarmEntry) -> AlarmKind:
    for pattern, kind in (
        (_BATTERY, AlarmKind.BATTERY_LOW),
        (_POSITION_LOST, AlarmKind.TURNS),
        (_ENCODER, AlarmKind.ENCODER),
        (_COLLISION, AlarmKind.COLLISION),
    ):
        if pattern.search(alarm.name):
            return kind
    return AlarmKind.TURNS if _is_lost_number(alarm) else AlarmKind.UNKNOWN


def _axes_of(alarm: AlarmEntry) -> tuple[int, ...]:
    """Return the axes whose bits the alarm's data have set, where it is an alarm of axes and its data are axes."""
    concerns_axes = _POSITION_LOST.search(alarm.name) or _ENCODER.search(alarm.name) or _is_lost_number(alarm)
    if not concerns_axes or alarm.data_type != _DATA_ARE_AXES:
        return ()
    return tuple(axis for axis in range(_AXES) if alarm.data >> axis & 1)


def _is_lost_number(alarm: AlarmEntry) -> bool:
    return alarm.code == _LOST_NUMBER and _UNREADABLE in alarm.name
