"""What a mastering recovery is told beforehand."""

from dataclasses import dataclass, field, replace
from typing import Annotated, Literal

from pydantic import Field

from cellcal.calibration.mastering.counts import DriveTrain, MasteringRecord
from cellcal.calibration.message import make_message
from cellcal.drivers.interfaces import Counts
from cellcal.procedures.accuracy_limits import AccuracyClass, MasteringLimits
from cellcal.procedures.motion.plans import MotionBounds
from cellcal.procedures.recovery.position_alarms import AlarmCodes
from cellcal.procedures.run import RefusalError
from cellcal.procedures.setting_texts import (
    ACCURACY_CLASS,
    EVIDENCE,
    FIRST_CAPTURES,
    MAX_CAPTURES,
    OWN_LIMITS,
    ROOM,
    SAMPLES,
    TOLERANCE_COUNTS,
    describe_setting,
)

HAND_CHECKS, HAND_FINALS = 2, 1  # captures, where a person jogs


@dataclass(frozen=True, slots=True)
class MasteringRecoverySpec:
    """Facts about the time before the loss, and how much may be measured."""

    evidence: Annotated[Literal["wire", "places"], EVIDENCE] = "wire"
    last_counts: Annotated[
        Counts | None,
        describe_setting(
            "Last healthy encoder counts",
            "One number for each axis, from before the loss; usually the watch has noted them.",
            "what",
            unit="count",
        ),
    ] = None
    exchanged_axes: Annotated[
        tuple[Annotated[int, Field(ge=1)], ...],
        describe_setting(
            "Axes with exchanged parts",
            "Axes whose motor, encoder, belt or gear was exchanged, as the pendant names them; empty: none.",
            "what",
            unit="1",
            basic=True,
            axes=True,
        ),
    ] = ()
    first_captures: Annotated[int, Field(ge=6, le=200), FIRST_CAPTURES] = 12
    max_captures: Annotated[int, Field(ge=6, le=200), MAX_CAPTURES] = 30
    wanted_u_rad: Annotated[
        float,
        Field(gt=0),
        describe_setting(
            "Certainty of an axis' zero",
            "The series goes on until zeros that are no whole turns are known so well (k = 2).",
            "limits",
            unit="rad",
        ),
    ] = 8.7e-4
    check_captures: Annotated[
        int,
        Field(ge=1, le=50),
        describe_setting(
            "Poses of the check",
            "So many further poses check the answer before anything is written.",
            "effort",
            unit="1",
        ),
    ] = 4
    max_check_captures: Annotated[
        int,
        Field(ge=1, le=100),
        describe_setting(
            "Most poses of the check", "The check may go on up to this number.", "effort", unit="1"
        ),
    ] = 8
    final_captures: Annotated[
        int,
        Field(ge=1, le=50),
        describe_setting(
            "Poses after writing",
            "So many poses show at the end that what was written is right.",
            "effort",
            unit="1",
        ),
    ] = 3
    visits_again: Annotated[
        int,
        Field(ge=0, le=20),
        describe_setting(
            "Repeats of doubtful places",
            "So many places that contradict the others are gone to once more.",
            "effort",
            unit="1",
        ),
    ] = 3
    samples: Annotated[int, Field(ge=1, le=1000), SAMPLES] = 5
    tolerance_counts: Annotated[int, Field(ge=0), TOLERANCE_COUNTS] = 50
    index_speed_rad_s: Annotated[
        float,
        Field(gt=0, le=0.25),
        describe_setting(
            "Speed of turning one axis",
            "How fast a single axis turns when its encoder looks for its index.",
            "motion",
            unit="rad/s",
        ),
    ] = 0.035
    accuracy_class: Annotated[AccuracyClass, ACCURACY_CLASS] = "B"
    limits: Annotated[MasteringLimits | None, OWN_LIMITS] = None
    room: Annotated[MotionBounds, ROOM] = field(default_factory=MotionBounds)
    alarms: Annotated[
        AlarmCodes,
        describe_setting(
            "Alarm names of the controller", "Alarms that the recovery knows how to answer.", "technical"
        ),
    ] = field(default_factory=AlarmCodes)


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
            make_message(
                "exchanged_axes names an axis that is not there: {exchanged_axes}",
                exchanged_axes=spec.exchanged_axes,
            ),
            remedy=make_message("Axes count from 1 to {axes}.", axes=axes),
        )
