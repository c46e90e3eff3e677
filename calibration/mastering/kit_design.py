"""Which places a recovery kit should have: chosen while the robot is healthy for the smallest error it would leave.

Derived here from the recovery's own covariance (`place_evidence`): greedy A-optimality on the joints' offsets for the
places that will be fitted, then, for those kept for checking, the ones that together show every wrong turn best.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from cellcal.calibration.arm.kinematics import RobotModel
from cellcal.calibration.errors import CalibrationError, DegenerateDataError
from cellcal.calibration.geometry import Array
from cellcal.calibration.mastering.counts import DriveTrain, PlaceCapture, RecoveryKit
from cellcal.calibration.mastering.integer_search import success_probability
from cellcal.calibration.mastering.place_choice import PlaceChoice
from cellcal.calibration.mastering.place_evidence import PlaceProblem
from cellcal.calibration.mastering.place_recovery import FITTED, place_covariance, places_to_fit_of
from cellcal.calibration.mastering.turn_gate import SUCCESS_PROBABILITY
from cellcal.calibration.mastering.turn_recovery import SPARE_CAPTURES
from cellcal.calibration.mastering.turn_verification import detection_deviations
from cellcal.calibration.message import make_message

CHECKS = 3  # places of a kit of points or targets that are never fitted
_ASSUMED_NESTS_M = ((1.6, 0.9, -0.4), (1.4, -1.0, 0.5), (-0.6, 1.2, 0.2), (0.3, -1.3, 0.9))


@dataclass(frozen=True, slots=True)
class KitPlan:
    """The composition of a kit before any place is known: how many places of which kind, and how well each is met."""

    kind: str  # point, seat or target
    tip_in_flange_m: tuple[float, float, float]
    places: int  # of points or targets
    check_points: int  # touched beside a seat
    sigma_m: float
    sigma_rad: float
    sigma_tip_m: float


@dataclass(frozen=True, slots=True)
class KitPrediction:
    """The predicted result of a recovery by a kit.

    ``sigma_turns`` (n,) is of the motors [turns]; ``offset_u_rad`` (n,) of the joints' zeros, k = 2 [rad], were they
    all lost; ``check_sigmas`` is at how many deviations the check places would show the wrong turn that they show
    worst.
    """

    success_probability: float
    sigma_turns: tuple[float, ...]
    offset_u_rad: tuple[float, ...]
    check_sigmas: float
    fitted: int
    checked: int
    spare: int  # figures beyond the unknown turns, so that a mistake is noticed; the gate wants six

    @property
    def is_checkable(self) -> bool:
        """Whether the gate of a recovery would have enough figures to notice a mistake."""
        return self.spare >= SPARE_CAPTURES


def predict_kit_recovery(
    model: RobotModel, kit: RecoveryKit, robot: tuple[DriveTrain, tuple[int, ...]]
) -> KitPrediction:
    """Foretell a recovery that fits the best places of a kit and checks at the others.

    Raises
    ------
    CalibrationError
        The kit has no place that could be fitted.
    """
    fitted = places_to_fit_of(model, kit, robot)
    covariance = place_covariance(model, kit, robot, fitted)
    per_turn = robot[0].radians_per_turn()
    u_rad = 2.0 * np.sqrt(np.diag(per_turn @ covariance @ per_turn.T))
    checks = [c for c in kit.places if c.kind != "nest" and c.place not in fitted]
    kinds = {place.place: place.kind for place in kit.places}
    return KitPrediction(
        success_probability(covariance),
        tuple(float(v) for v in np.sqrt(np.diag(covariance))),
        tuple(float(v) for v in u_rad),
        _check_sigmas(model, kit, robot, checks, covariance),
        len(fitted),
        len(checks),
        sum(6 if kinds[number] == "seat" else 3 for number in fitted) - model.axis_count,
    )


def design_kit(
    model: RobotModel,
    robot: tuple[DriveTrain, tuple[int, ...]],
    plan: KitPlan,
    candidates_rad: Array,
    *,
    existing_kit: RecoveryKit | None = None,
) -> RecoveryKit:
    """Choose the postures at which the places of a kit should be, as if they had been visited there.

    Parameters
    ----------
    model : RobotModel
        Nominal model.
    robot : DriveTrain and counts at zero
        Of the healthy robot.
    plan : KitPlan
        What is wanted.
    candidates_rad : (C, n)
        Postures that can be gone to [rad].
    known : RecoveryKit, optional
        Places that are recorded already: one more is then chosen, for what they do not tell.

    Returns
    -------
    RecoveryKit
        Its places in the order in which they tell most; for targets also four assumed nests, whose true places only
        the instrument will tell.

    Raises
    ------
    DegenerateDataError
        Fewer candidates than places.
    """
    count = 1 + plan.check_points if plan.kind == "seat" else plan.places
    if len(candidates_rad) < count + 1:
        raise DegenerateDataError(
            make_message(
                "only {candidates_rad_count} postures can be reached, {count} places are wanted",
                candidates_rad_count=len(candidates_rad),
                count=count,
            ),
            remedy="Widen the workspace box, or bring the robot's tool nearer to the middle of its range.",
        )
    drawn = _as_kit(model, robot, plan, candidates_rad)
    if existing_kit is not None:
        return _add_best_candidate(model, robot, existing_kit, drawn)
    chosen = _choose_candidates(model, robot, drawn, plan)
    places = [place for place in drawn.places if place.kind == "nest"]
    places += [_numbered_capture(drawn, k, len(places) + n, plan, n) for n, k in enumerate(chosen)]
    return replace(drawn, places=tuple(places))


def _choose_candidates(
    model: RobotModel, robot: tuple[DriveTrain, tuple[int, ...]], drawn: RecoveryKit, plan: KitPlan
) -> list[int]:
    """Return which candidates to take, counted without the nests: those to fit first, then those to check at."""
    every = PlaceChoice.from_kit(model, drawn, robot)
    if plan.kind == "seat":
        fitted = every.best_fit(1)
        points = PlaceChoice.from_kit(model, _as_touched(drawn, plan), robot)
        return fitted + points.best_checks(every.turn_covariance(fitted), fitted, plan.check_points)
    fitted = every.best_fit(max(1, min(FITTED, plan.places - CHECKS)))
    return fitted + every.best_checks(every.turn_covariance(fitted), fitted, plan.places - len(fitted))


def _as_touched(drawn: RecoveryKit, plan: KitPlan) -> RecoveryKit:
    """Return the places of a seat as if they were touched."""
    points = tuple(replace(c, kind="point", sigma_rad=0.0, sigma_m=plan.sigma_m) for c in drawn.places)
    return replace(drawn, places=points)


def _numbered_capture(drawn: RecoveryKit, index: int, place: int, plan: KitPlan, order: int) -> PlaceCapture:
    found = [c for c in drawn.places if c.kind != "nest"][index]
    kind = "point" if plan.kind == "seat" and order > 0 else found.kind
    sigma_rad = found.sigma_rad if kind == "seat" else 0.0
    return replace(found, place=place, kind=kind, sigma_rad=sigma_rad, label=f"place {place + 1}")


def _add_best_candidate(
    model: RobotModel,
    robot: tuple[DriveTrain, tuple[int, ...]],
    existing_kit: RecoveryKit,
    drawn: RecoveryKit,
) -> RecoveryKit:
    """Return the known kit with one candidate more: the one that leaves least, or that shows wrong turns best."""
    number = 1 + max(place.place for place in existing_kit.places)
    more = [c for c in drawn.places if c.kind != "nest"]
    every = [replace(c, place=number + k, label=f"place {number + k + 1}") for k, c in enumerate(more)]
    choice = PlaceChoice.from_kit(model, replace(existing_kit, places=(*existing_kit.places, *every)), robot)
    there = [place for place in existing_kit.places if place.kind != "nest"]
    now, mine = predict_kit_recovery(model, existing_kit, robot), range(len(there))
    if now.is_checkable and now.success_probability > SUCCESS_PROBABILITY:
        fitted = set(places_to_fit_of(model, existing_kit, robot))
        covariance = choice.turn_covariance([k for k in mine if there[k].place in fitted])
        best = choice.best_checks(covariance, list(mine), 1)[0]
    else:
        best = choice.best_addition(list(mine))
    taken = replace(every[best - len(there)], place=number, label=f"place {number + 1}")
    return replace(existing_kit, places=(*existing_kit.places, taken))


def _as_kit(
    model: RobotModel, robot: tuple[DriveTrain, tuple[int, ...]], plan: KitPlan, joints_rad: Array
) -> RecoveryKit:
    """Return a kit with a place at each posture, as a nominal arm would have found them."""
    drive, zero = robot
    counts = drive.to_counts(joints_rad, np.array(zero))
    tips = model.tip_positions(joints_rad, np.array(plan.tip_in_flange_m))
    sigma_rad = plan.sigma_rad if plan.kind == "seat" else 0.0
    target = plan.kind == "target"
    nests = _ASSUMED_NESTS_M if target else ()
    places = [
        PlaceCapture("nest", k, tuple(int(z) for z in zero), plan.sigma_m, 0.0, at)
        for k, at in enumerate(nests)
    ]
    for k, (row, tip) in enumerate(zip(counts, tips, strict=True), len(nests)):
        tip_position_m = (float(tip[0]), float(tip[1]), float(tip[2])) if target else None
        place = PlaceCapture(
            plan.kind, k, tuple(int(c) for c in row), plan.sigma_m, sigma_rad, tip_position_m
        )
        places.append(place)
    return RecoveryKit(plan.tip_in_flange_m, tuple(places), plan.sigma_tip_m)


def _check_sigmas(
    model: RobotModel,
    kit: RecoveryKit,
    robot: tuple[DriveTrain, tuple[int, ...]],
    checks: Sequence[PlaceCapture],
    covariance: Array,
) -> float:
    if not checks:
        return 0.0
    nests = [c for c in kit.places if c.kind == "nest"]
    try:
        problem = PlaceProblem(model, kit, robot, [*nests, *checks])
    except CalibrationError:
        return 0.0
    local = problem.linearise_at(np.zeros(model.axis_count))
    spread = local.by_turn @ covariance @ local.by_turn.T
    local = replace(local, scatter=local.scatter + spread)
    return float(detection_deviations(problem, local).max(axis=0).min())
