"""Where a drift check measures: where the causes of a change look most different, reached the same way every time."""

import math
from dataclasses import dataclass, field
from typing import Annotated

import numpy as np
from pydantic import Field

from cellcal.calibration.drift.causes import most_informative_order
from cellcal.calibration.drift.reference import DriftReference
from cellcal.calibration.message import make_message
from cellcal.drivers.interfaces import Joints
from cellcal.procedures.arm.arm_bench import Bench, Method
from cellcal.procedures.arm.arm_motion import (
    MotionSpace,
    draw_poses,
    map_roads,
    way_is_free,
    way_to_one,
    way_to_rest,
)
from cellcal.procedures.forecast import Knowledge
from cellcal.procedures.motion.plans import MotionBounds
from cellcal.procedures.motion.speed_limit import SpeedLimit, TimedMotion
from cellcal.procedures.run import RefusalError
from cellcal.procedures.setting_texts import CANDIDATES, ROOM, SAMPLES, SEED, describe_setting

REPEAT_M = 3e-5  # how well an arm of this class comes back to a pose from the same side, one coordinate
ASSUMED_DISTANCE_M = 3.0  # of a target from its tracker, in a dry run


@dataclass(frozen=True, slots=True)
class DriftRules:
    """The number of poses, the care of each, and the limits of motion."""

    poses: Annotated[
        int,
        Field(ge=4, le=12),
        describe_setting("Poses of the reference", "So many poses make the reference.", "effort", unit="1"),
    ] = 6
    first: Annotated[
        int,
        Field(ge=4, le=12),
        describe_setting(
            "Poses of every check",
            "Each check measures so many poses; the others only where they decide.",
            "effort",
            unit="1",
        ),
    ] = 4
    candidates: Annotated[int, Field(ge=32, le=500), CANDIDATES] = 100
    samples: Annotated[int, Field(ge=1, le=1000), SAMPLES] = 5
    probability: Annotated[
        float,
        Field(ge=0.5, lt=1),
        describe_setting(
            "Certainty to name a cause",
            "A cause of the drift is named from this probability on.",
            "limits",
            unit="1",
        ),
    ] = 0.9
    seed: Annotated[int, Field(ge=0), SEED] = 1
    room: Annotated[MotionBounds, ROOM] = field(default_factory=MotionBounds)


@dataclass(frozen=True, slots=True)
class DriftPlan:
    """Poses in the order in which they are gone to, each with a free way from the one before."""

    ways_rad: tuple[tuple[Joints, ...], ...]
    way_to_rest_rad: tuple[Joints, ...]
    pace: SpeedLimit
    not_checked: tuple[str, ...]

    def total_motion(self, poses: int | None = None) -> TimedMotion:
        """Return how far and how long the arm goes to the first so many poses, or to all."""
        return self.pace.time_ways(self.way_to_rest_rad[-1], self.ways_rad[:poses])


def plan_reference(bench: Bench, rules: DriftRules) -> DriftPlan:
    """Plan the poses at which the causes of a change look most different; each with a free way from the rest."""
    reach = MotionSpace.from_bench(bench, rules.room)
    drawn = draw_poses(reach, rules.candidates, rules.seed)
    to_rest = way_to_rest(reach, bench.joints_rad, drawn)
    roads = map_roads(reach, to_rest[-1], drawn)
    near = tuple(pose for pose, hub in zip(roads.poses_rad[1:], roads.hub_of[1:], strict=True) if hub == 0)
    sigma_m = math.sqrt(2.0) * math.hypot(bench.sigma_m / 2.0, REPEAT_M)
    order = most_informative_order(bench.make_task(), np.array(near), sigma_m, rules.poses)
    return _make_plan(bench, reach, to_rest, tuple(near[k] for k in order))


def plan_check(bench: Bench, reference: DriftReference, rules: DriftRules) -> DriftPlan:
    """Plan the way to the poses of a reference."""
    reach = MotionSpace.from_bench(bench, rules.room)
    drawn = draw_poses(reach, rules.candidates, rules.seed)
    rest = reference.rest_rad
    to_rest = way_to_one(reach, bench.joints_rad, (rest,), drawn)
    lost = sum(not way_is_free(reach, rest, pose) for pose in reference.poses_rad)
    if lost:
        raise RefusalError(
            make_message(
                "{lost} poses of the reference have no free way from where the robot would rest", lost=lost
            ),
            code="procedure.unreachable",
            remedy="Give the workspace and wire that the reference was taken with, or take a new one (renew).",
        )
    return _make_plan(bench, reach, to_rest, reference.poses_rad)


def _make_plan(
    bench: Bench, reach: MotionSpace, to_rest: tuple[Joints, ...], poses: tuple[Joints, ...]
) -> DriftPlan:
    rest = to_rest[-1]
    ways = tuple((rest, pose) for pose in poses)  # always by way of the rest: the same approach every time
    return DriftPlan(ways, to_rest, reach.speed_limit(bench.limits.speed_rad_s), reach.not_checked())


def noise_before_m(knowledge: Knowledge, method: Method, samples: int) -> float:
    """Return the standard deviation [m] of one coordinate of a capture, as its device will state it; 0 unknown."""
    if method == "wire":
        gauge = knowledge.gauge
        # noise alone: what a wire gets wrong every time is the same in both rounds
        return (
            0.0 if gauge is None else math.hypot(gauge.sigma_m / 2.0 / math.sqrt(samples), gauge.resolution_m)
        )
    sees = knowledge.tracker
    return 0.0 if sees is None else sees.sigma_m + sees.sigma_per_m * ASSUMED_DISTANCE_M
