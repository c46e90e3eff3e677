"""What a mastering recovery is told beforehand."""

from dataclasses import dataclass, field
from typing import Annotated, Literal

from pydantic import Field

from drivers.interfaces import Counts
from procedures.limits import AccuracyClass, MasteringLimits
from procedures.motion.plans import Room
from procedures.recovery.waking import AlarmCodes


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
    final_captures: Annotated[int, Field(ge=1, le=50)] = 2
    visits_again: Annotated[int, Field(ge=0, le=20)] = 3  # of places that the others contradict
    samples: Annotated[int, Field(ge=1, le=1000)] = 5
    tolerance_counts: Annotated[int, Field(ge=0)] = 50
    index_speed_rad_s: Annotated[float, Field(gt=0, le=0.25)] = 0.035
    accuracy_class: AccuracyClass = "B"  # of an axis whose reference was lost; turns are exact or refused
    limits: MasteringLimits | None = None
    room: Room = field(default_factory=Room)
    alarms: AlarmCodes = field(default_factory=AlarmCodes)
