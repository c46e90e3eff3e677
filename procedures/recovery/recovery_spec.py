"""What a mastering recovery is told beforehand."""

from dataclasses import dataclass, field, replace
from typing import Annotated, Literal

from pydantic import Field

from cellcal.calibration.mastering.counts import DriveTrain, MasteringRecord
from cellcal.drivers.interfaces import Counts
from cellcal.procedures.accuracy_limits import AccuracyClass, MasteringLimits
from cellcal.procedures.motion.plans import MotionBounds
from cellcal.procedures.recovery.position_alarms import AlarmCodes
from cellcal.procedures.run import RefusalError

HAND_CHECKS, HAND_FINALS = 2, 1  # captures, where a person jogs


@dataclass(frozen=True, slots=True)
class MasteringRecoverySpec:
    """What is known of the time before the loss, and how much may be measured."""

    evidence: Literal["wire", "places"] = (
        "wire"  # places: the touched points, seat or targets of the record's kit
    )
    last_counts: Counts | None = None  # the last healthy counts, from the watch
    exchanged_axes: tuple[
        Annotated[int, Field(ge=1)], ...
    ] = ()  # from 1: motor, encoder, belt or gear exchanged, as far as known
    first_captures: Annotated[int, Field(ge=6, le=200)] = 12
    max_captures: Annotated[int, Field(ge=6, le=200)] = 30
    wanted_u_rad: Annotated[float, Field(gt=0)] = (
        8.7e-4  # 0.05 deg, k = 2, of offsets that are no whole turns
    )
    check_captures: Annotated[int, Field(ge=1, le=50)] = 4
    max_check_captures: Annotated[int, Field(ge=1, le=100)] = 8
    final_captures: Annotated[int, Field(ge=1, le=50)] = 3  # all but the first from the other side
    visits_again: Annotated[int, Field(ge=0, le=20)] = 3  # of places that the others contradict
    samples: Annotated[int, Field(ge=1, le=1000)] = 5
    tolerance_counts: Annotated[int, Field(ge=0)] = 50
    index_speed_rad_s: Annotated[float, Field(gt=0, le=0.25)] = 0.035
    accuracy_class: AccuracyClass = "B"  # of an axis whose reference was lost; turns are exact or refused
    limits: MasteringLimits | None = None
    room: MotionBounds = field(default_factory=MotionBounds)
    alarms: AlarmCodes = field(default_factory=AlarmCodes)


def fewest_captures(spec: MasteringRecoverySpec) -> MasteringRecoverySpec:
    """Return the spec of a recovery whose poses a person jogs to: every capture costs a minute of it.

    The gate still asks for twelve captures, and for more checks where these do not decide.
    """
    return replace(
        spec,
        check_captures=min(spec.check_captures, HAND_CHECKS),
        final_captures=min(spec.final_captures, HAND_FINALS),
    )


def refuse_other_gears(record: MasteringRecord, drive: DriveTrain) -> None:
    """Refuse a controller that counts by other gears than the record's."""
    if record.drive != drive:
        raise RefusalError(
            "the controller's gear data are not those of the record",
            code="procedure.wrong_record",
            remedy="Compare the gear ratios with the data sheet; restore the controller's backup.",
        )


def refuse_unknown_axes(spec: MasteringRecoverySpec, axes: int) -> None:
    """Refuse axes that the robot does not have."""
    if not all(1 <= axis <= axes for axis in spec.exchanged_axes):
        raise RefusalError(
            f"exchanged_axes names an axis that is not there: {spec.exchanged_axes}",
            remedy=f"Axes count from 1 to {axes}.",
        )
