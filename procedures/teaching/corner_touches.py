"""Touches of a probe on the faces of a corner: first three, two, one; then where one more tells most.

The first face sets the approaches to the second right, both those to the third. Further touches are made until the
frame is known within its limits; where the limits are out of reach of so many, none is made.
"""

import math
import statistics
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from cellcal.calibration.geometry import Array, Pose
from cellcal.calibration.points.most_informative import most_informative_touch
from cellcal.calibration.points.three_two_one import (
    FACES,
    LEAST,
    CornerFrame,
    FaceName,
    corner_covariance,
    outward_in_frame,
    three_two_one,
)
from cellcal.drivers.interfaces import Joints
from cellcal.procedures.arm.arm_bench import ARM_SIGMA_M, read_healthy_arm
from cellcal.procedures.cell import Cell
from cellcal.procedures.motion.motion_gate import MotionCare
from cellcal.procedures.run import Run
from cellcal.procedures.steps.mastering import nominal_model
from cellcal.procedures.steps.touch import (
    ProbeApproach,
    TouchedPoint,
    leave_face,
    move_untouched,
    probe_of,
    touch_surface,
)
from cellcal.procedures.teaching.corner_places import CornerRules, FaceSpot, face_places, first_spots
from cellcal.procedures.teaching.corner_plan import (
    FacePlan,
    FaceTouch,
    ProbeBench,
    plan_check_touches,
    plan_spots,
    probed_faces,
    rest_of_way,
)

TOUCH_STEP: dict[FaceName, str] = {
    "z": "touch the z face",
    "y": "touch the y face",
    "x": "touch the x face",
}
CHECK_STEP = "touch a check point"
# Over which an arm's own errors become others: two points so far apart share none of them. Of 120 drawn arms (the
# M-6iB of fake_devices, 0.35 mm and 0.35 mrad at each parameter) 0.84 mm and 0.69 mrad, hence 1.7 m.
ERROR_SPAN_M = 1.7
Made = dict[FaceName, tuple[float, ...]]
SPARE = sum(LEAST.values()) + 1  # so many touches, and one can be compared


@dataclass(frozen=True, slots=True)
class CornerGoal:
    """The uncertainty that is asked for, k = 2, and the part that no touch lessens."""

    origin_u_m: float
    angle_u_rad: float
    arm_sigma_m: float  # of one coordinate
    tip_sigma_m: float  # the same for all touches, which are made in one attitude

    def expanded_uncertainties(self, covariance: Array) -> tuple[float, float]:
        """Return U (k = 2) of the origin's worst coordinate [m] and about the worst axis [rad]."""
        each = self._six_uncertainties(covariance)
        return float(each[:3].max()), float(each[3:].max())

    @property
    def arm_turn_rad(self) -> float:
        """Standard uncertainty of a direction that the arm's own errors leave, whatever is touched."""
        return math.sqrt(2.0) * self.arm_sigma_m / ERROR_SPAN_M

    def limit_shares(self, covariance: Array) -> Array:
        """Return the six U, shift before turn, over their limits."""
        return np.asarray(
            self._six_uncertainties(covariance) / np.repeat([self.origin_u_m, self.angle_u_rad], 3)
        )

    def _six_uncertainties(self, covariance: Array) -> Array:
        common = np.repeat([self.arm_sigma_m**2 + self.tip_sigma_m**2, self.arm_turn_rad**2], 3)
        return np.asarray(2.0 * np.sqrt(np.diag(covariance) + common))


@dataclass(frozen=True, slots=True)
class CornerPrediction:
    """The faces to touch again, in order, until the goal is met; the uncertainty then, k = 2."""

    again: tuple[FaceName, ...]
    reached: bool
    origin_u_m: float
    angle_u_rad: float
    in_turn: int  # touches for the same, were the faces touched in turn


@dataclass(frozen=True, slots=True)
class ProbedPoint:
    """A touch as it counts in a frame; what its times told stands in the journal."""

    face: FaceName
    tip_in_base_m: tuple[float, float, float]  # the ball's centre, by the nominal model
    sigma_m: float  # of probe and times, along the normal
    spread_m: float  # of its repeats

    @classmethod
    def from_touch(cls, touch: FaceTouch) -> "ProbedPoint":
        """Return what counts of a touch."""
        point = touch.point
        return cls(touch.face, point.tip_in_base_m, point.sigma_m, point.spread_m)


@dataclass(frozen=True, slots=True)
class CheckTouch:
    """By how much a touch that the frame was not found from misses its face, and what explains."""

    face: FaceName
    miss_m: float
    sigma_m: float


def touch_sigma(touches: Sequence[FaceTouch]) -> float:
    """Return the standard uncertainty of a usual touch along its normal, the arm's scatter included."""
    return math.hypot(statistics.median(one.point.sigma_m for one in touches), ARM_SIGMA_M)


def predict_corner(rules: CornerRules, goal: CornerGoal, sigma_m: float, made: Made) -> CornerPrediction:
    """Return which faces to touch again so that the goal is met with few touches, one of them to spare.

    ``made``: the standard uncertainty of each touch made, by its face; ``sigma_m``: that of a further one.
    """
    again, now = list[FaceName](), dict(made)
    while not _is_enough(rules, goal, now) and (open_faces := _open_faces(rules, now)):
        after = [
            goal.limit_shares(_frame_covariance(rules, _add_touch(now, face, sigma_m))) for face in open_faces
        ]
        again.append(open_faces[most_informative_touch(after)])
        now = _add_touch(now, again[-1], sigma_m)
    origin, turn = goal.expanded_uncertainties(_frame_covariance(rules, now))
    reached = _is_enough(rules, goal, now)
    in_turn = _in_turn(rules, goal, sigma_m) if reached else 0
    return CornerPrediction(tuple(again), reached, origin, turn, in_turn)


async def read_probe_bench(cell: Cell) -> ProbeBench:
    """Read who the robot is, where it stands, and what its probe is like."""
    model, joints_rad = await read_healthy_arm(cell)
    probe, setup = probe_of(cell)
    can = probe.capabilities
    return ProbeBench(
        model=model.name,
        serial=(await cell.robot.identify()).serial,
        joints_rad=joints_rad,
        epoch=None if cell.mastering is None else await cell.mastering.encoder_epoch(),
        tip_in_flange_m=setup.tip_in_flange_m,
        tip_sigma_m=setup.sigma_tip_m,
        axis_in_flange=setup.axis_in_flange,
        radius_m=can.tip_radius_m - can.pretravel_m,
        probe_sigma_m=can.sigma_m,
        limits=cell.limits,
    )


async def touch_spot(
    cell: Cell, way_rad: tuple[Joints, ...], approach: ProbeApproach, label: str
) -> TouchedPoint:
    """Go along a planned way, or the rest of it; feel for the face; go back to where the tip hovers.

    All the way a contact stops the arm.
    """
    _, setup = probe_of(cell)
    await leave_face(cell, label, approach)  # nothing, unless this touch was broken off before
    here, standoff = (await cell.robot.read_joints()).joints_rad, way_rad[-1]
    tip = np.array(setup.tip_in_flange_m)
    at, above, end = nominal_model(cell).tip_positions(np.array([here, standoff, approach.end_rad]), tip)
    if np.linalg.norm(at - above) <= np.linalg.norm(
        end - above
    ):  # interrupted near the face, as a resume finds it
        await move_untouched(cell, label, [standoff], approach.travel_rad_s, care=MotionCare.TOUCHING)
    else:
        await move_untouched(cell, label, rest_of_way(way_rad, here), approach.travel_rad_s)
    found = await touch_surface(cell, label, approach)
    await move_untouched(cell, label, [standoff], approach.travel_rad_s, care=MotionCare.TOUCHING)
    return found


@dataclass(frozen=True, slots=True)
class CornerSetup:
    """The drawn place of a corner, and how it is felt."""

    bench: ProbeBench
    rules: CornerRules
    goal: CornerGoal
    nominal: Pose


async def touch_corner(run: Run, corner: CornerSetup, first: FacePlan) -> tuple[FaceTouch, ...]:
    """Feel for the three faces until they tell the frame well enough."""
    touches: list[FaceTouch] = []
    for face in FACES:
        spots = tuple(spot for spot in first_spots() if spot.face == face)
        if touches:
            first = await _plan_step(run, f"plan the {face} face", corner, touches, spots)
        await _touch_spots(run, first, spots, touches)
    further = 0
    while (prediction := predict_probed_corner(corner, touches)).reached and prediction.again:
        further += 1
        count = sum(one.face == prediction.again[0] for one in touches)
        spots = (FaceSpot(prediction.again[0], count),)
        plan = await _plan_step(run, f"plan a further touch {further}", corner, touches, spots)
        await _touch_spots(run, plan, spots, touches)
    return tuple(touches)


async def touch_checks(
    run: Run, corner: CornerSetup, touches: tuple[FaceTouch, ...]
) -> tuple[FaceTouch, ...]:
    """Feel for each face once more, where it was not felt before."""
    plan = await run.solve(
        "plan the check touches", plan_check_touches, corner.bench, corner.rules, corner.nominal, touches
    )
    checks = []
    for number, face in enumerate(reversed(FACES), 1):
        step, k = f"{CHECK_STEP} {number}", number - 1
        point = await run.move(step, touch_spot, plan.ways_rad[k], plan.approaches[k], step)
        checks.append(FaceTouch(face, point, plan.ways_rad[k][-1]))
    return tuple(checks)


def construct_corner(bench: ProbeBench, rules: CornerRules, touches: tuple[FaceTouch, ...]) -> CornerFrame:
    """Return the frame by all points felt."""
    return three_two_one(probed_faces(touches, ARM_SIGMA_M), radius_m=bench.radius_m, corner=rules.corner)


def compare_checks(
    bench: ProbeBench, rules: CornerRules, found: CornerFrame, checks: tuple[FaceTouch, ...]
) -> tuple[CheckTouch, ...]:
    """Return what the check touches miss the frame's planes by."""
    return tuple(_compare_check(bench, rules, found, check) for check in checks)


def predict_probed_corner(corner: CornerSetup, touches: Sequence[FaceTouch]) -> CornerPrediction:
    """Return what further touches would tell after those made."""
    made = {name: face.sigma_m for name, face in probed_faces(touches, ARM_SIGMA_M).items()}
    return predict_corner(corner.rules, corner.goal, touch_sigma(touches), made)


async def _plan_step(
    run: Run, step: str, corner: CornerSetup, touches: Sequence[FaceTouch], spots: tuple[FaceSpot, ...]
) -> FacePlan:
    return await run.solve(
        step, plan_spots, corner.bench, corner.rules, corner.nominal, tuple(touches), spots
    )


async def _touch_spots(run: Run, plan: FacePlan, spots: Sequence[FaceSpot], touches: list[FaceTouch]) -> None:
    for spot, way, approach in zip(spots, plan.ways_rad, plan.approaches, strict=False):
        step = f"{TOUCH_STEP[spot.face]} {spot.number + 1}"
        point = await run.move(step, touch_spot, way, approach, step)
        touches.append(FaceTouch(spot.face, point, way[-1]))


def _compare_check(bench: ProbeBench, rules: CornerRules, found: CornerFrame, check: FaceTouch) -> CheckTouch:
    axis = "xyz".index(check.face)
    frame = found.base_frame
    local = (np.array(check.point.tip_in_base_m) - np.array(frame.position_m)) @ frame.rotation_matrix()
    local = local - bench.radius_m * outward_in_frame(check.face, rules.corner)
    moved = np.zeros(6)  # by the frame's shift and turn, along the face's normal
    moved[axis] = 1.0
    moved[3:] = np.cross(local, np.eye(3)[axis])
    variance = float(moved @ np.array(found.covariance) @ moved)
    return CheckTouch(check.face, float(local[axis]), math.sqrt(variance + touch_sigma((check,)) ** 2))


def fewest_touches(sigma_m: float) -> Made:
    """Return the touches that fix a frame, each so good."""
    return {face: (sigma_m,) * LEAST[face] for face in FACES}


def _add_touch(made: Made, face: FaceName, sigma_m: float) -> Made:
    return {**made, face: (*made[face], sigma_m)}


def _is_enough(rules: CornerRules, goal: CornerGoal, made: Made) -> bool:
    spare = sum(map(len, made.values())) >= min(SPARE, rules.max_touches)
    return spare and bool(goal.limit_shares(_frame_covariance(rules, made)).max() <= 1.0)


def _open_faces(rules: CornerRules, made: Made) -> list[FaceName]:
    if sum(map(len, made.values())) >= rules.max_touches:
        return []
    return [face for face in FACES if len(made[face]) < len(face_places(rules)[face])]


def _in_turn(rules: CornerRules, goal: CornerGoal, sigma_m: float) -> int:
    now = fewest_touches(sigma_m)
    while not _is_enough(rules, goal, now) and (open_faces := _open_faces(rules, now)):
        behind = {face: len(now[face]) - LEAST[face] for face in open_faces}
        now = _add_touch(now, min(open_faces, key=lambda face: behind[face]), sigma_m)
    return sum(map(len, now.values()))


def _frame_covariance(rules: CornerRules, made: Made) -> Array:
    spot_places = face_places(rules)
    return corner_covariance({face: np.array(spot_places[face][: len(made[face])]) for face in FACES}, made)
