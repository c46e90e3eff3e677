"""What a controller's alarms say about a loss of mastering, and what is prepared for it.

Alarms only suggest a mode; the recovery's data decide it. Modes are those of the design: M0 the controller's memory
was lost, M1 turns, M2 a motor or encoder, M3 every reference, M4 the geometry, M5 the wrong robot or record.
"""

from dataclasses import dataclass, replace
from enum import StrEnum

from cellcal.calibration.message import join_messages, make_message
from cellcal.drivers.interfaces import Alarm, AlarmKind, Condition, Readiness, RobotCapabilities


class LossMode(StrEnum):
    """The quantity that is most likely unknown."""

    MEMORY = "M0"
    TURNS = "M1"
    MOTOR = "M2"
    REFERENCES = "M3"
    GEOMETRY = "M4"
    WRONG_ROBOT = "M5"
    UNKNOWN = "unknown"  # beside an alarm that is unknown here


class LossKind(StrEnum):
    """The kinds of loss of a robot's position."""

    LOST = "lost"
    HELD = "held"  # nothing says that it is lost; whether it is true has to be checked
    DIFFERS = "differs"  # the controller holds another mastering than the record
    UNCONFIRMED = "unconfirmed"  # it holds what a run wrote and never confirmed
    ANOTHER = "another"  # another robot answers: of the one of the cell file nothing is known


_MODES = {
    AlarmKind.TURNS: LossMode.TURNS,
    AlarmKind.ENCODER: LossMode.MOTOR,
    AlarmKind.COLLISION: LossMode.GEOMETRY,
}
_GRAVEST = (LossMode.GEOMETRY, LossMode.MOTOR, LossMode.TURNS)

_HEADLINES = {
    LossKind.LOST: "lost its position",
    LossKind.HELD: "may no longer stand where it thinks",
    LossKind.DIFFERS: "does not hold the mastering of its record",
    LossKind.UNCONFIRMED: "holds a mastering that was not confirmed",
    LossKind.ANOTHER: "is not what answers: another robot does",
}
_DESCRIPTIONS = {
    LossMode.MEMORY: "the controller forgot its mastering; no alarm says that the encoders lost anything",
    LossMode.TURNS: "turns of the motors are lost; the zero comes back exactly if nothing was exchanged",
    LossMode.MOTOR: "a pulse coder or its cable fails: what is exchanged gets a new zero, the rest returns exactly",
    LossMode.REFERENCES: "every reference is lost",
    LossMode.GEOMETRY: "the robot hit something: its geometry may have changed, and re-mastering would hide it",
    LossMode.WRONG_ROBOT: "another robot answers than the cell file names: its record must not be used",
    LossMode.UNKNOWN: "the position is lost, and why is unknown: read the alarm on the pendant before anything moves",
}
_NOT_LOST = (
    "a pulse coder or its cable fails: mend it, and it shows if the position is lost; then check the zero"
)
_OLD_BACKUP = (
    "an old backup was loaded; or the robot was mastered on purpose since: take a new mastering record then"
)
_NOT_CONFIRMED = (
    "the mastering in force was never confirmed: do not move the robot in AUTO; resume that run, or undo it"
)
_SET_ANEW = (
    "the mastering of axes is lost; it is done anew with the mastering gauge or the dial gauge, and a measurement "
    "has to prove it"
)
_BROUGHT_BACK = (
    "the position was brought back, and nothing proves that each motor stands in the right turn: measure it before "
    "the robot goes to taught points; a new record or a position_cure that passes answers this, and after a drift "
    "check, which may not see every axis, a person (`cellcal watch --once --accept`)"
)
_ALONE = frozenset({LossMode.MEMORY, LossMode.TURNS})  # what may be recovered without a person's judgement


@dataclass(frozen=True, slots=True)
class Suspicion:
    """The mode that the alarms suggest, on which axes (from 1), and in words for the technician."""

    mode: LossMode
    axes: tuple[int, ...]
    words: str
    position_lost: bool = True
    record_differs: bool = False  # from what the controller holds, and no alarm tells of it
    not_known: tuple[str, ...] = ()  # codes of alarms that are unknown here
    of_run: str = ""  # that wrote a mastering and never confirmed it

    @property
    def loss_kind(self) -> LossKind:
        """Return what happened to the robot's position."""
        if self.of_run:
            return LossKind.UNCONFIRMED
        if self.record_differs:
            return LossKind.DIFFERS
        if self.mode is LossMode.WRONG_ROBOT:
            return LossKind.ANOTHER
        return LossKind.LOST if self.position_lost else LossKind.HELD

    @property
    def headline_text(self) -> str:
        """Return it in a few words."""
        return _HEADLINES[self.loss_kind]

    @property
    def answering_procedure(self) -> str | None:
        """Which procedure answers it; None where a person must act first. A recovery refuses a bent arm itself."""
        if self.of_run:
            return "mastering_undo"
        if self.mode is LossMode.WRONG_ROBOT and not self.record_differs:
            return None
        return "mastering_recovery" if self.position_lost else "drift_check"

    @property
    def may_run_unattended(self) -> bool:
        """Whether a recovery may be started without a person's judgement of what happened."""
        return self.mode in _ALONE

    def procedure_settings(self) -> dict[str, tuple[int, ...] | str]:
        """Return what is known of the settings of the procedure."""
        if self.of_run:
            return {"of_run": self.of_run}
        if self.mode is LossMode.MOTOR and self.axes and self.position_lost:
            return {"exchanged_axes": self.axes}
        return {}


def suspect_loss(alarms: tuple[Alarm, ...], *, position_lost: bool = True) -> Suspicion:
    """Return the gravest mode that a robot's alarms suggest."""
    modes = {mode: [alarm for alarm in alarms if _MODES.get(alarm.kind) is mode] for mode in _GRAVEST}
    strange = _not_known(alarms)
    otherwise = LossMode.UNKNOWN if strange else LossMode.MEMORY
    mode = next((mode for mode in _GRAVEST if modes[mode]), otherwise)
    named = sorted({alarm.axis + 1 for alarm in modes.get(mode, []) if alarm.axis is not None})
    description = _NOT_LOST if mode is LossMode.MOTOR and not position_lost else _DESCRIPTIONS[mode]
    return Suspicion(mode, tuple(named), description, position_lost, not_known=strange)


def with_zero_set_anew(suspicion: Suspicion) -> Suspicion:
    """Return it for a controller that keeps no zero of an axis whose position is lost: nothing comes back exactly."""
    if suspicion.mode is not LossMode.TURNS or not suspicion.position_lost:
        return suspicion
    return replace(suspicion, words=_SET_ANEW)


def turns_lost(alarms: tuple[Alarm, ...]) -> Suspicion:
    """Return what is suspected where counts changed unobserved, and no alarm gives the reason."""
    return Suspicion(LossMode.TURNS, (), _DESCRIPTIONS[LossMode.TURNS], not_known=_not_known(alarms))


def _not_known(alarms: tuple[Alarm, ...]) -> tuple[str, ...]:
    return tuple(sorted({alarm.code for alarm in alarms if alarm.kind is AlarmKind.UNKNOWN}))


def wrong_robot() -> Suspicion:
    """Return what is suspected where a serial number is not the one of the cell file."""
    return Suspicion(LossMode.WRONG_ROBOT, (), _DESCRIPTIONS[LossMode.WRONG_ROBOT])


def old_backup() -> Suspicion:
    """Return what is suspected where a controller holds another mastering than the record, without any alarm.

    A recovery tells the two cases apart by measuring: it writes the record back, or refuses it as the older one.
    """
    return Suspicion(LossMode.WRONG_ROBOT, (), _OLD_BACKUP, record_differs=True)


def suspect_return(axes: tuple[int, ...]) -> Suspicion:
    """Return what is suspected where a log tells of a lost position that the controller believes it has again."""
    return Suspicion(LossMode.TURNS, axes, _BROUGHT_BACK, position_lost=False)


def suspect_unconfirmed(of_run: str) -> Suspicion:
    """Return what is suspected where a controller holds a mastering that a run wrote and never confirmed."""
    return Suspicion(LossMode.UNKNOWN, (), _NOT_CONFIRMED, of_run=of_run)


def is_position_doubtful(condition: Condition) -> bool:
    """Return whether a robot that is not lost reports a collision or a failing encoder."""
    return condition.readiness is not Readiness.POSITION_LOST and any(
        alarm.kind in (AlarmKind.COLLISION, AlarmKind.ENCODER) for alarm in condition.alarms
    )


def battery_warning(robot: RobotCapabilities, condition: Condition) -> str:
    """Return what to do about encoder batteries that still hold; empty where none is low."""
    low = [alarm for alarm in condition.alarms if alarm.kind is AlarmKind.BATTERY_LOW]
    if not low or condition.readiness is Readiness.POSITION_LOST:
        return ""
    axes = ", ".join(robot.axis_name(alarm.axis) for alarm in low if alarm.axis is not None)
    remedy = (
        "Exchange it with the controller switched ON, before it is lost; then take a new mastering record."
    )
    text = (
        make_message(
            "{code}: the encoder battery of {axes} is low, and the position is still there.",
            code=low[0].code,
            axes=axes,
        )
        if axes
        else make_message(
            "{code}: the encoder battery is low, and the position is still there.", code=low[0].code
        )
    )
    return join_messages(" ", (text, remedy))
