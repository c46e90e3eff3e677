"""How a calibration's series is conducted: how many poses, how carefully, and what motion must keep to."""

import math
from dataclasses import dataclass, field
from typing import Annotated

from pydantic import Field

from cellcal.procedures.arm.arm_bench import ARM_SIGMA_M, Triple
from cellcal.procedures.motion.plans import MotionBounds
from cellcal.procedures.setting_texts import (
    CANDIDATES,
    DRAWING_SIGMA,
    MAX_CAPTURES,
    MIN_CAPTURES,
    MOUTH_AT,
    RETAKES,
    ROOM,
    SAMPLES,
    SEAT_SIGMA,
    SEED,
    describe_setting,
)


@dataclass(frozen=True, slots=True)
class SeriesRules:
    """The number of poses, the care of each, and the limits of motion."""

    first: Annotated[
        int,
        Field(ge=1, le=100),
        describe_setting(
            "Poses of the first look",
            "So many poses are measured before the arm is worked out for the first time.",
            "effort",
            unit="1",
        ),
    ] = 12
    # After them so many are chosen at a time, to be gone to in the order of shortest ways: one by one costs 40 % more
    # way. Each capture is looked at all the same, and what is enough ends the series.
    batch: Annotated[
        int,
        Field(ge=1, le=50),
        describe_setting(
            "Poses at a time", "After the first look so many poses are chosen at a time.", "effort", unit="1"
        ),
    ] = 4
    min_captures: Annotated[int, Field(ge=4, le=200), MIN_CAPTURES] = 16
    max_captures: Annotated[int, Field(ge=4, le=400), MAX_CAPTURES] = 90
    checks: Annotated[
        int,
        Field(ge=8, le=100),
        describe_setting(
            "Fewest check poses",
            "At least so many poses are kept for checking and never fitted.",
            "effort",
            unit="1",
        ),
    ] = 8
    check_share: Annotated[
        float,
        Field(ge=0.3, le=1.0),
        describe_setting(
            "Share of check poses", "Check poses as a share of those that are fitted.", "effort", unit="1"
        ),
    ] = 0.3
    candidates: Annotated[int, Field(ge=32, le=4000), CANDIDATES] = 600
    tests: Annotated[
        int,
        Field(ge=8, le=500),
        describe_setting(
            "Postures that stand for the work",
            "At so many postures of the whole work the accuracy is predicted.",
            "technical",
            unit="1",
        ),
    ] = 80
    samples: Annotated[int, Field(ge=1, le=1000), SAMPLES] = 5
    retakes: Annotated[int, Field(ge=0, le=50), RETAKES] = 5
    arm_sigma_m: Annotated[
        float,
        Field(gt=0, le=0.005),
        describe_setting(
            "Repeatability of the arm",
            "By how much the arm scatters when it comes back to a pose (standard deviation).",
            "doubt",
            unit="m",
        ),
    ] = ARM_SIGMA_M
    seed: Annotated[int, Field(ge=0), SEED] = 1
    mouth_at_m: Annotated[Triple | None, MOUTH_AT] = None
    point_min: Annotated[
        int,
        Field(ge=4, le=100),
        describe_setting(
            "Fewest poses at each tool point",
            "At each point of the end-effector at least so many poses are measured.",
            "effort",
            unit="1",
        ),
    ] = 5
    point_max: Annotated[
        int,
        Field(ge=4, le=200),
        describe_setting(
            "Most poses at each tool point",
            "At each point of the end-effector no more poses than these are measured.",
            "effort",
            unit="1",
        ),
    ] = 25
    point_checks: Annotated[
        int,
        Field(ge=1, le=20),
        describe_setting(
            "Check poses at each tool point",
            "So many poses at each point are kept for checking.",
            "effort",
            unit="1",
        ),
    ] = 2
    point_candidates: Annotated[
        int,
        Field(ge=16, le=2000),
        describe_setting(
            "Tool poses to choose from",
            "From so many possible poses at a point the most telling ones are chosen.",
            "technical",
            unit="1",
        ),
    ] = 90
    seat_sigma_m: Annotated[float, Field(gt=0, le=0.005), SEAT_SIGMA] = 2e-5
    drawing_sigma_m: Annotated[float, Field(ge=0, le=0.005), DRAWING_SIGMA] = 0.0
    room: Annotated[MotionBounds, ROOM] = field(default_factory=MotionBounds)

    @property
    def point_sigma_m(self) -> float:
        """Standard uncertainty of one coordinate of a point of the end-effector, drawing and seat [m]."""
        return math.hypot(self.seat_sigma_m, self.drawing_sigma_m)

    def checks_for(self, captures: int) -> int:
        """Return how many poses verify a fit of so many captures."""
        return max(self.checks, math.ceil(self.check_share * captures))
