"""Which poses to measure: enough for the turns, reachable, and known to be so before measuring."""

from collections.abc import Callable, Sequence

import numpy as np

from cellcal.calibration.arm.joint_kinds import drawn_range
from cellcal.calibration.arm.kinematics import RobotModel
from cellcal.calibration.errors import DegenerateDataError
from cellcal.calibration.geometry import Array
from cellcal.calibration.mastering.counts import DriveTrain, MasteringRecord
from cellcal.calibration.mastering.integer_search import success_probability
from cellcal.calibration.message import make_message
from cellcal.calibration.motion.motion_check import MotionLimits, allowed_postures
from cellcal.calibration.wires.model import WirePoses, WirePrior, disturbance_covariance, wire_terms
from cellcal.calibration.wires.reference import WirePredictor, parameter_sigmas

TURN_UNCERTAINTY = 10.0  # deviation of a lost motor's turns before measuring, per motor
_EXCHANGE_ROUNDS = 2
_DESIGN_SIGMA_M = 0.0002
_CANDIDATES_A_POSE = 4  # of fewer a greedy choice is mostly made by chance
_MOST_BATCHES, _NEXT_SEED = 12, 1_000_003


def predict_turns(model: RobotModel, record: MasteringRecord, joints_rad: Array) -> tuple[float, Array]:
    """Predict, before measuring, what captures at these joints would tell about lost turns.

    Parameters
    ----------
    model : RobotModel
        Nominal model of the record.
    record : MasteringRecord
        Taken while the robot was healthy.
    joints_rad : (N, n)
        Joints of the captures [rad].

    Returns
    -------
    probability : float
        Lower bound on the chance that all turns are found right [1].
    sigma_turns : (n,)
        Standard deviation of each motor's real estimate [turns].
    """
    joints = np.asarray(joints_rad, dtype=float)
    covariance_of = turn_covariances(record, WirePredictor(model, *record.wire_lengths()), joints)
    covariance = covariance_of(len(joints))
    return success_probability(covariance), np.sqrt(np.diag(covariance))


def turn_covariances(
    record: MasteringRecord, predictor: WirePredictor, joints_rad: Array
) -> Callable[[int], Array]:
    """Return a function: covariance (n, n) [turns^2] of real estimates from the first so many captures."""
    terms = predictor.wire_terms(WirePoses.from_record_side(joints_rad, predictor.sigma_m))
    scatter = predictor.expected_lengths(terms)[1]
    by_turn = terms.by_joint @ record.drive.radians_per_turn()

    def covariance_of(count: int) -> Array:
        first = by_turn[:count]
        information = first.T @ np.linalg.solve(scatter[:count, :count], first)
        loose = np.eye(by_turn.shape[1]) / TURN_UNCERTAINTY**2
        return np.asarray(np.linalg.inv(information + loose), dtype=np.float64)

    return covariance_of


def next_poses(
    model: RobotModel, record: MasteringRecord, measured_joints: Array, candidates_joints: Array, k: int
) -> tuple[int, ...]:
    r"""Choose which k candidates to measure next, best first, given what is measured already.

    Greedy D-optimality on the turns: each choice raises ``log det`` of their information most. With
    correlated lengths this is ``log(v_T / v_S)`` of the conditional variances given all chosen, with and
    without unknown turns; one rank-one step per choice keeps both up to date for all candidates.

    Parameters
    ----------
    model : RobotModel
        Nominal model of the record.
    record : MasteringRecord
        Taken while the robot was healthy.
    measured_joints : (M, n)
        Joints already measured [rad]; may be empty.
    candidates_joints : (C, n)
        Joints that can be reached [rad].
    k : int
        How many.

    Returns
    -------
    tuple of int
        Indices of candidates, best first; all of them if there are no more than k.

    References
    ----------
    V. V. Fedorov, Theory of optimal experiments, 1972: the criterion.
    """
    candidates = np.asarray(candidates_joints, dtype=float)
    measured = np.asarray(measured_joints, dtype=float).reshape(-1, model.axis_count)
    predictor = WirePredictor(model, *record.wire_lengths())
    terms = predictor.wire_terms(
        WirePoses.from_record_side(np.vstack([measured, candidates]), predictor.sigma_m)
    )
    scatter = predictor.expected_lengths(terms)[1]
    by_turn = terms.by_joint @ record.drive.radians_per_turn()
    noise = np.diag(terms.noise_variance(record.wire_lengths()[1]))
    first = len(measured)
    known_covariance, unknown = scatter - noise, scatter - noise + TURN_UNCERTAINTY**2 * by_turn @ by_turn.T
    chosen = _choose_greedily(known_covariance, unknown, np.diag(noise), list(range(first)), k)
    return tuple(int(i) - first for i in chosen)


def kit_poses(  # noqa: PLR0913 - a kit depends on all of it
    model: RobotModel,
    drive: DriveTrain,
    prior: WirePrior,
    limits: MotionLimits,
    k: int,
    *,
    seed: int = 1,
    usable: Callable[[Array], Array] | None = None,
) -> Array:
    r"""Choose the k poses of a mastering record: reachable, and D-optimal for turns and nuisance together.

    Candidates are drawn evenly between the joint limits, those that break a limit are dropped; a greedy
    choice is then improved by exchanging one pose after another while the information grows.

    Parameters
    ----------
    model : RobotModel
        The arm, nominal.
    drive : DriveTrain
        Its motors.
    prior : WirePrior
        Places of the wire.
    limits : MotionLimits
        What every posture must keep; its ``wire`` gives the usable range.
    k : int
        How many poses, 24 to 36 in practice.
    seed : int
        Of the candidates.
    usable : callable, optional
        From candidates (C, n) to (C,): which of them can be gone to.

    Returns
    -------
    (k, n)
        Joints [rad].

    Raises
    ------
    DegenerateDataError
        Fewer than 2 k candidates keep the limits and can be gone to.
    """
    candidates, tried = _enough_candidates(model, limits, prior, k, seed, usable)
    if len(candidates) < 2 * k:
        raise DegenerateDataError(
            make_message(
                "only {candidate_count} of {tried} postures tried keep all limits and can be gone to "
                "from here",
                candidate_count=len(candidates),
                tried=tried,
            ),
            remedy="Jog the robot towards the middle of its range, move the anchor of the wire, or widen the "
            "workspace box.",
        )
    sigma_x = parameter_sigmas(model, prior)
    nominal = np.zeros(len(sigma_x))
    nominal[:8] = [*prior.anchor_in_base_m, *prior.hook_in_flange_m, prior.zero_m, 1.0]
    terms = wire_terms(model, nominal, WirePoses.from_record_side(candidates, _DESIGN_SIGMA_M))
    by_turn = terms.by_joint @ drive.radians_per_turn()
    weighted = terms.by_parameter * sigma_x
    known_covariance = disturbance_covariance(prior, terms, terms)
    unknown = known_covariance + TURN_UNCERTAINTY**2 * by_turn @ by_turn.T + weighted @ weighted.T
    noise = terms.noise_variance(prior)
    chosen = _choose_greedily(known_covariance, unknown, noise, [], k)
    for _ in range(_EXCHANGE_ROUNDS):
        before = list(chosen)
        for place in range(k):
            others = chosen[:place] + chosen[place + 1 :]
            chosen[place] = _choose_greedily(known_covariance, unknown, noise, others, 1)[0]
        if chosen == before:
            break
    return candidates[chosen]


def _enough_candidates(
    model: RobotModel,
    limits: MotionLimits,
    prior: WirePrior,
    k: int,
    seed: int,
    usable: Callable[[Array], Array] | None,
) -> tuple[Array, int]:
    """Return usable candidates (C, n), drawn until a choice of k is no narrow one, and how many were tried."""
    found, tried = list[Array](), 0
    for batch in range(_MOST_BATCHES):
        drawn = candidate_joints(
            model,
            limits,
            max(400, 12 * k),
            seed=seed + batch * _NEXT_SEED,
            hook_in_flange_m=prior.hook_in_flange_m,
        )
        tried += len(drawn)
        found.append(drawn if usable is None else drawn[usable(drawn)])
        if sum(map(len, found)) >= _CANDIDATES_A_POSE * k or not len(drawn):
            break
    return np.concatenate(found), tried


def candidate_joints(
    model: RobotModel,
    limits: MotionLimits,
    count: int,
    *,
    seed: int = 1,
    hook_in_flange_m: tuple[float, float, float] = (0.0, 0.0, 0.0),
) -> Array:
    """Return up to ``count`` postures (C, n), drawn evenly between the joint limits, that keep all limits."""
    generator = np.random.default_rng(seed)
    low, high = drawn_range(model)
    accepted: list[Array] = []
    for _ in range(40):
        drawn = generator.uniform(low, high, (4 * count, model.axis_count))
        accepted.append(drawn[allowed_postures(model, drawn, limits, hook_in_flange_m)])
        if sum(map(len, accepted)) >= count:
            break
    return np.concatenate(accepted)[:count]


def _choose_greedily(
    known_covariance: Array, unknown: Array, noise: Array, chosen_before: Sequence[int], k: int
) -> list[int]:
    """Return k indices, greedily maximising the information gained by noisy looks at correlated values."""
    known_covariance, unknown = (
        _condition_on(known_covariance, noise, chosen_before),
        _condition_on(unknown, noise, chosen_before),
    )
    chosen: list[int] = []
    for _ in range(min(k, len(noise) - len(chosen_before))):
        gain = np.log((np.diag(unknown) + noise) / (np.diag(known_covariance) + noise))
        gain[[*chosen_before, *chosen]] = -np.inf
        best = int(np.argmax(gain))
        chosen.append(best)
        known_covariance, unknown = (
            _condition_on(matrix, noise, [best]) for matrix in (known_covariance, unknown)
        )
    return chosen


def _condition_on(covariance: Array, noise: Array, indices: Sequence[int]) -> Array:
    """Return the covariance (a copy) after noisy looks at the entries ``chosen_before``."""
    if not len(indices):
        return covariance.copy()
    rows = list(indices)
    block = covariance[np.ix_(rows, rows)] + np.diag(noise[rows])
    conditioned: Array = covariance - covariance[:, rows] @ np.linalg.solve(block, covariance[rows])
    return conditioned
