"""How a calibration's series is conducted: how many poses, how carefully, and what motion must keep to."""

import math
from dataclasses import dataclass, field
from typing import Annotated

from pydantic import Field

from cellcal.procedures.arm.arm_bench import ARM_SIGMA_M, Triple
from cellcal.procedures.motion.plans import MotionBounds


@dataclass(frozen=True, slots=True)
class SeriesRules:
    """How many poses, how carefully, and what motion must keep to."""

    first: Annotated[int, Field(ge=1, le=100)] = 12  # before the first look at the readings
    # After them so many are chosen at a time, to be gone to in the order of shortest ways: one by one costs 40 % more
    # way. Each capture is looked at all the same, and what is enough ends the series.
    batch: Annotated[int, Field(ge=1, le=50)] = 4
    min_captures: Annotated[int, Field(ge=4, le=200)] = 16
    max_captures: Annotated[int, Field(ge=4, le=400)] = 90
    checks: Annotated[int, Field(ge=8, le=100)] = 8  # poses that are never fitted, at least
    check_share: Annotated[float, Field(ge=0.3, le=1.0)] = 0.3  # of the captures that are fitted
    candidates: Annotated[int, Field(ge=32, le=4000)] = 600
    tests: Annotated[int, Field(ge=8, le=500)] = 80  # postures that stand for the whole work
    samples: Annotated[int, Field(ge=1, le=1000)] = 5
    retakes: Annotated[int, Field(ge=0, le=50)] = 5  # of readings that the others contradict
    arm_sigma_m: Annotated[float, Field(gt=0, le=0.005)] = ARM_SIGMA_M
    seed: Annotated[int, Field(ge=0)] = 1
    mouth_at_m: Triple | None = None  # where the wire's mouth looks; None: the middle of the work
    point_min: Annotated[int, Field(ge=4, le=100)] = 5  # captures at each point of the end-effector
    point_max: Annotated[int, Field(ge=4, le=200)] = 25
    point_checks: Annotated[int, Field(ge=1, le=20)] = 2  # at each point, that are never fitted
    point_candidates: Annotated[int, Field(ge=16, le=2000)] = 90
    seat_sigma_m: Annotated[float, Field(gt=0, le=0.005)] = 2e-5  # of hook or target in a point, each axis
    drawing_sigma_m: Annotated[float, Field(ge=0, le=0.005)] = 0.0  # of a point's place on the drawing
    room: MotionBounds = field(default_factory=MotionBounds)

    @property
    def point_sigma_m(self) -> float:
        """Standard uncertainty of one coordinate of a point of the end-effector, drawing and seat [m]."""
        return math.hypot(self.seat_sigma_m, self.drawing_sigma_m)

    def checks_for(self, captures: int) -> int:
        """Return how many poses verify a fit of so many captures."""
        return max(self.checks, math.ceil(self.check_share * captures))
