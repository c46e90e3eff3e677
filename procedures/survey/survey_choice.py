"""Which pose of a survey comes next, and whether it is enough. Pure functions of what was measured."""

from dataclasses import dataclass, replace

import numpy as np

from cellcal.calibration.geometry import Array
from cellcal.calibration.message import make_message
from cellcal.calibration.points.fixture import MirrorPoint, mirror_gaps, mirror_image
from cellcal.calibration.wires.design import best_order, expected_covariance, look_ahead
from cellcal.calibration.wires.network import WireMounting
from cellcal.drivers.interfaces import Joints
from cellcal.procedures.steps.length import LengthCapture
from cellcal.procedures.survey.survey import Captures, Survey, SurveyPlan, goal_uncertainties
from cellcal.procedures.survey.survey_motion import way_between

SAME_POSE_RAD = 0.02
LENGTH_SIGMA_M = 3e-4  # of one length with all that blurs it, where two places are told apart
CURE_SIGMAS = 6.0
FEWEST_LENGTHS = 4


@dataclass(frozen=True, slots=True)
class SurveyProgress:
    """The progress of a survey: the captures, at which spot and posture, and how large disturbances are."""

    captures: Captures
    spot: int
    here_rad: Joints
    disturbance_factor: float


@dataclass(frozen=True, slots=True)
class SpotChoice:
    """The next pose at a spot, or why there is none; and how well the goal would be known in the end."""

    way_rad: tuple[Joints, ...]  # corners of the way to it; empty when there is none
    enough: bool
    origin_u_m: float  # expected once every other spot has as many captures
    angle_u_rad: float
    unreachable: bool = False  # too few lengths, and no pose that could be gone to
    ambiguous: str = ""  # two places fit, and no pose in reach tells them apart


def choose_pose(survey: Survey, standing: SurveyProgress) -> SpotChoice:
    """Choose the pose of the spot's pool that tells most and can be reached, unless all is known well enough."""
    origin_u_m, angle_u_rad = _expected_uncertainties(survey, standing)
    rules, spot = survey.rules, standing.spot
    taken = standing.captures[spot]
    reached = survey.plan.goal.is_promised_by(origin_u_m, angle_u_rad)
    found = SpotChoice((), reached and len(taken) >= rules.min_captures, origin_u_m, angle_u_rad)
    unseen = _unmeasured_poses(survey.plan.pools[spot], taken)
    if len(unseen) and (len(taken) < rules.min_captures or not (reached or len(taken) >= rules.max_captures)):
        candidates, mountings = (
            survey.planned_mounting(spot, unseen),
            survey.make_mountings(standing.captures),
        )
        place, factor = survey.place_of(spot), standing.disturbance_factor
        gains = look_ahead(
            survey.nominal_model(), survey.wire_network_prior(), mountings, candidates, place, factor
        ).gains
        way = _first_reachable(survey, standing, unseen[np.argsort(-gains)])
        if way:
            return replace(found, way_rad=way)
        if len(taken) < FEWEST_LENGTHS:
            return replace(found, way_rad=(), unreachable=True)
    return _choose_distinct(survey, standing, unseen, found)


def order_pools(survey: Survey) -> SurveyPlan:
    """Return the plan with the poses of each pool put in the order in which they tell most, spot after spot."""
    mountings: list[WireMounting] = survey.make_mountings(survey.empty_captures())
    best: list[tuple[int, ...]] = []
    for spot, pool in enumerate(survey.plan.pools):
        candidates, poses = survey.planned_mounting(spot, np.array(pool)), np.array(pool)
        order = best_order(
            survey.nominal_model(),
            survey.wire_network_prior(),
            mountings,
            candidates,
            survey.rules.max_captures,
        )
        best.append(order)
        mountings.append(survey.planned_mounting(spot, poses[list(order[: survey.rules.min_captures])]))
    return replace(survey.plan, best=tuple(best))


def expected_at_least(survey: Survey, count: int) -> tuple[float, float]:
    """Return the goal's U (k = 2) [m, rad] after so many of the best poses at every spot, before any is taken."""
    poses = [survey.best_poses(spot, count) for spot in range(len(survey.plan.spots))]
    return _with_planned(survey, poses, 1.0)


def fixed_plan_captures(survey: Survey, factor: float, reached: tuple[float, float]) -> int | None:
    """Return how many captures evenly drawn poses would need for the same U; None if more than there are."""
    counts = list(range(4, min(len(pool) for pool in survey.plan.pools) + 1))
    if not _is_reached_by_drawn(survey, counts[-1], factor, reached):
        return None
    while len(counts) > 1:  # more captures never tell less: halve until one is left
        middle = (len(counts) - 1) // 2
        good = _is_reached_by_drawn(survey, counts[middle], factor, reached)
        counts = counts[: middle + 1] if good else counts[middle + 1 :]
    return counts[0] * len(survey.plan.spots)


def saving_text(captures: int, fixed: int | None) -> str:
    """Return what choosing the poses saved against evenly drawn ones, as a sentence."""
    if fixed is None:
        return make_message(
            "{captures} captures; evenly drawn poses do not reach this U at all", captures=captures
        )
    if fixed <= captures:
        return make_message(
            "no saving: {captures} captures; evenly drawn poses need {fixed} for the same U",
            captures=captures,
            fixed=fixed,
        )
    return make_message(
        "{captures} captures; a fixed plan of evenly drawn poses needs {fixed_plan_captures} for "
        "the same U: {share_percent:.0f} % saved",
        captures=captures,
        fixed_plan_captures=fixed,
        share_percent=(1.0 - captures / fixed) * 100,
    )


def _is_reached_by_drawn(survey: Survey, count: int, factor: float, reached: tuple[float, float]) -> bool:
    found = _with_planned(survey, [np.array(pool[:count]) for pool in survey.plan.pools], factor)
    return found[0] <= reached[0] and found[1] <= reached[1]


def _with_planned(survey: Survey, poses: list[Array], factor: float) -> tuple[float, float]:
    mountings = survey.make_mountings(survey.empty_captures())
    mountings += [survey.planned_mounting(spot, drawn) for spot, drawn in enumerate(poses)]
    covariance = expected_covariance(
        survey.nominal_model(), survey.wire_network_prior(), mountings, survey.list_places(), factor
    )
    return goal_uncertainties(survey.plan.goal, covariance, survey.rules.point_sigma_m)


def _expected_uncertainties(survey: Survey, standing: SurveyProgress) -> tuple[float, float]:
    """Return the goal's U if the spots still to come get as many captures as this one has."""
    mountings, taken = survey.make_mountings(standing.captures), len(standing.captures[standing.spot])
    count = max(taken, survey.rules.min_captures)
    for spot in range(standing.spot if taken == 0 else standing.spot + 1, len(survey.plan.spots)):
        mountings.append(survey.planned_mounting(spot, survey.best_poses(spot, count)))
    covariance = expected_covariance(
        survey.nominal_model(),
        survey.wire_network_prior(),
        mountings,
        survey.list_places(),
        standing.disturbance_factor,
    )
    return goal_uncertainties(survey.plan.goal, covariance, survey.rules.point_sigma_m)


def _choose_distinct(
    survey: Survey, standing: SurveyProgress, unseen: Array, found: SpotChoice
) -> SpotChoice:
    """Check that the lengths allow one place only; else choose the pose that tells, or say that there is none."""
    spot = standing.spot
    joints = np.array([capture.joints_rad for capture in standing.captures[spot]])
    wire = survey.wire_at(spot)
    place_m = wire[0] if survey.plan.spots[spot].seeks_exit else wire[1]
    mirror = mirror_image(survey.stations_at(spot, joints), place_m, LENGTH_SIGMA_M)
    if mirror.is_excluded:
        return found
    gaps_m = mirror_gaps(survey.stations_at(spot, unseen), place_m, mirror)
    order = np.argsort(-gaps_m)
    way = _first_reachable(survey, standing, unseen[order[gaps_m[order] > CURE_SIGMAS * LENGTH_SIGMA_M]])
    if way:
        return replace(found, way_rad=way, enough=False)
    gap_m = float(gaps_m.max()) if len(gaps_m) else 0.0
    return replace(found, enough=False, ambiguous=_two_places_text(spot, mirror, gap_m))


def _two_places_text(spot: int, mirror: MirrorPoint, gap_m: float) -> str:
    x, y, z = (value * 1e3 for value in mirror.at_m)
    return make_message(
        "the poses at spot {spot} lie nearly in one plane: the point may as well be at x {x:.0f}, y {y:.0f}, "
        "z {z:.0f} mm, and the pose that tells most changes the length by {gap_mm:.2f} mm; "
        "a pose well off that plane, and a way to it, would tell",
        spot=spot + 1,
        x=x,
        y=y,
        z=z,
        gap_mm=gap_m * 1e3,
    )


def _unmeasured_poses(pool: tuple[Joints, ...], taken: tuple[LengthCapture, ...]) -> Array:
    poses = np.array(pool)
    if not taken:
        return poses
    measured = np.array([capture.joints_rad for capture in taken])
    apart = np.abs(poses[:, None, :] - measured[None]).max(axis=2).min(axis=1)
    unseen: Array = poses[apart > SAME_POSE_RAD]
    return unseen


def _first_reachable(survey: Survey, standing: SurveyProgress, poses: Array) -> tuple[Joints, ...]:
    """Return the way to the first of these poses that has one, and a way back."""
    wire, room, plan = survey.wire_at(standing.spot), survey.rules.room, survey.plan
    for pose in poses:
        ends = (standing.here_rad, tuple(float(q) for q in pose))
        way = way_between(survey.state.model, wire, room, plan.rest_rad, ends)
        if way:
            return way
    return ()
