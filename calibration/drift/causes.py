"""Readings at the same poses, earlier and now: did anything change, and what (warmth, tool, a zero, the device).

Each cause moves all readings together in a way of its own. How well each explains the changes, with how few numbers,
gives its probability; where two explain them alike, the pose is named at which they would differ most.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np

from cellcal.calibration.errors import CalibrationError
from cellcal.calibration.geometry import Array
from cellcal.calibration.poses.arm_fit import ArmTask
from cellcal.calibration.registration import best_fit_transform
from cellcal.calibration.uncertainty import chi_square_limit

NOTHING, WARMTH, TOOL, DEVICE, OTHER = "nothing", "warmth", "tool", "device", "other"
_GRIDS: dict[
    str, tuple[float, ...]
] = {  # how large a change may be, k = 1: the evidence is averaged over these
    WARMTH: (2e-5, 6e-5, 2e-4),  # growth: some 2, 5 and 16 K of steel
    TOOL: (1e-4, 3e-4, 1e-3, 3e-3),
    DEVICE: (1e-4, 3e-4, 1e-3, 3e-3, 1e-2),
    OTHER: (1e-4, 3e-4, 1e-3, 3e-3),
    "joint": tuple(float(v) for v in np.radians([0.003, 0.01, 0.03, 0.1, 0.3, 1.0])),
}
_BEFOREHAND = {NOTHING: 0.7, WARMTH: 0.1, TOOL: 0.07, DEVICE: 0.06, OTHER: 0.01, "joint": 0.06}
_DESIGN = {WARMTH: 6e-5, TOOL: 5e-4, DEVICE: 5e-4, OTHER: 5e-4, "joint": 5e-4}
_LEVER_M = 0.5  # turns the shift of a tracker into a turn of the same effect


@dataclass(frozen=True, eq=False)
class DriftCause:
    """One way in which readings change together: (channels N, k), of k numbers on one scale."""

    name: str  # nothing | warmth | tool | device | other | J1 …
    kind: str
    columns: Array

    def change_covariance(self, size: float) -> Array:
        """Return the covariance of the changes (M, M) where each number has this deviation."""
        covariance: Array = size**2 * (self.columns @ self.columns.T)
        return covariance


@dataclass(frozen=True, slots=True)
class ProbableCause:
    """One cause with its probability, and how large it would be."""

    name: str
    probability: float
    values: tuple[float, ...]  # its numbers, most likely; m, rad or 1
    sigma: tuple[float, ...]
    unexplained_m: float  # RMS of what it leaves


@dataclass(frozen=True, slots=True)
class DriftFinding:
    """A change and its possible causes: likeliest first."""

    suspects: tuple[ProbableCause, ...]
    change_rms_m: float  # of one coordinate
    change_max_m: float  # of one reading
    chi_square: float  # of the changes against their noise
    degrees_of_freedom: int

    @property
    def has_changed(self) -> bool:
        """Whether there is a change at all, at 99.9 %."""
        return self.chi_square > chi_square_limit(self.degrees_of_freedom)

    @property
    def likeliest_cause(self) -> ProbableCause:
        """The first of them."""
        return self.suspects[0]

    def is_decided(self, probability: float) -> bool:
        """Return whether there is no change to explain, or one cause of it is that probable."""
        named = self.likeliest_cause.name not in (OTHER, NOTHING)
        return not self.has_changed or (named and self.likeliest_cause.probability >= probability)


def drift_causes(task: ArmTask, joints_rad: Array, values_m: Array | None = None) -> tuple[DriftCause, ...]:
    """Return how each cause would move the readings at these joints.

    Parameters
    ----------
    task : ArmTask
        Which arm, seen by what.
    joints_rad : (N, n)
        Postures [rad].
    values_m : (N, 3) or None
        Places as a tracker saw them [m]: they tell how it is turned. Before anything is measured it is taken to
        look along the base's axes.
    """
    model, joints = task.nominal_model(), np.asarray(joints_rad, dtype=float)
    target = np.array(task.target_in_flange_m)
    tips, jacobian = model.tip_jacobian(joints, target)  # (N, 3), (N, 3, n)
    turns = model.base_flange(joints)[:, :3, :3]
    look = _reading_gradients(task, tips, values_m)  # (N, channels, 3)
    shift = np.repeat(np.eye(3)[None], len(joints), axis=0)
    moved = -shift if task.kind == "length" else np.concatenate([shift, _turn_motions(tips)], axis=2)
    grown = [tips[:, :, None]]
    if task.kind == "length":  # the wire grows, too
        grown.append((tips - np.array(task.anchor_in_base_m))[:, :, None])
    found = [
        DriftCause(NOTHING, NOTHING, np.zeros((look.shape[0] * look.shape[1], 1))),
        _cause_of_motions(WARMTH, WARMTH, look, np.concatenate(grown, axis=2)),
        _cause_of_motions(TOOL, TOOL, look, turns),
        _cause_of_motions(DEVICE, DEVICE, look, moved),
    ]
    found += [
        _cause_of_motions(f"J{k + 1}", "joint", look, jacobian[:, :, k : k + 1])
        for k in range(model.axis_count)
    ]
    return (*found, DriftCause(OTHER, OTHER, np.eye(look.shape[0] * look.shape[1])))


def explain_changes(of: Sequence[DriftCause], changes_m: Array, sigma_m: float) -> DriftFinding:
    r"""Return how probable each cause is, given the changes (N, channels) [m] of readings.

    A cause with columns A and numbers x ~ N(0, s^2) makes changes ~ N(0, s^2 A A' + sigma^2): its evidence is the
    density of the changes, averaged over a few sizes s. More numbers that are not needed lower it by themselves.

    Raises
    ------
    CalibrationError
        Changes that are not finite.
    """
    changes = np.asarray(changes_m, dtype=float)
    flat = changes.reshape(-1)
    if not (np.isfinite(flat).all() and sigma_m > 0):
        raise CalibrationError("changes of readings must be finite, and their deviation above zero")
    joints = sum(cause.kind == "joint" for cause in of)
    logs, best = [], []
    for cause in of:
        share = _BEFOREHAND[cause.kind] / (joints if cause.kind == "joint" else 1)
        by_size = [
            _log_density(cause.change_covariance(s), flat, sigma_m) for s in _GRIDS.get(cause.kind, (0.0,))
        ]
        logs.append(np.log(share) + np.logaddexp.reduce(by_size) - np.log(len(by_size)))
        best.append(_GRIDS.get(cause.kind, (0.0,))[int(np.argmax(by_size))])
    weights = np.exp(np.array(logs) - max(logs))
    suspects = [
        _probable_cause(cause, float(p), size, flat, sigma_m)
        for cause, p, size in zip(of, weights / weights.sum(), best, strict=True)
    ]
    return DriftFinding(
        tuple(sorted(suspects, key=lambda one: -one.probability)),
        float(np.sqrt(np.mean(flat**2))),
        float(np.linalg.norm(changes.reshape(len(changes), -1), axis=1).max()),
        float((flat / sigma_m) @ (flat / sigma_m)),
        len(flat),
    )


def most_informative_pose(
    taken: Sequence[DriftCause],
    both: Sequence[DriftCause],
    changes_m: Array,
    sigma_m: float,
    first: tuple[str, str],
) -> int:
    """Return which further pose would tell two causes apart best, given the changes so far.

    Parameters
    ----------
    taken, both : sequences of Cause
        At the poses compared so far; at these and then one by one at those that could follow.
    changes_m : (N, channels)
        So far [m].
    sigma_m : float
        Standard deviation of one coordinate of a change.
    first : (str, str)
        The names of both causes.
    """
    count = len(taken[0].columns)
    channels = np.asarray(changes_m).reshape(len(changes_m), -1).shape[1]
    flat = np.asarray(changes_m, dtype=float).reshape(-1)
    predicted = [_predict_changes(next(c for c in both if c.name == name), flat, sigma_m) for name in first]
    extra = len(both[0].columns) - count
    worth = []
    for start in range(0, extra, channels):
        rows = slice(start, start + channels)
        (m1, v1), (m2, v2) = ((m[rows], v[rows, rows]) for m, v in predicted)
        gap, mixed = m1 - m2, np.linalg.inv(v1) + np.linalg.inv(v2)
        apart = np.trace(np.linalg.solve(v1, v2) + np.linalg.solve(v2, v1)) + gap @ mixed @ gap
        worth.append(float(apart))
    return int(np.argmax(worth))


def most_informative_order(
    task: ArmTask, candidates_rad: Array, sigma_m: float, count: int
) -> tuple[int, ...]:
    """Return the poses at which all causes differ most, best first: the worst told pair counts.

    For changes of zero mean with covariances C and D the divergence is ``tr(C^-1 D + D^-1 C) / 2 - M``.
    """
    joints = np.asarray(candidates_rad, dtype=float)
    every = [cause for cause in drift_causes(task, joints) if cause.kind != OTHER]
    covariances = [cause.change_covariance(_DESIGN.get(cause.kind, 0.0)) for cause in every]
    channels = task.channel_count
    chosen: list[int] = []
    pairs = list(combinations(range(len(every)), 2))
    for _ in range(min(count, len(joints))):
        worth = np.full(len(joints), -np.inf)
        for pose in range(len(joints)):
            if pose in chosen:
                continue
            rows = np.concatenate([np.arange(channels) + channels * k for k in (*chosen, pose)])
            own = np.array([c[np.ix_(rows, rows)] + sigma_m**2 * np.eye(len(rows)) for c in covariances])
            inverse = np.linalg.inv(own)
            information = np.einsum("aij,bji->ab", inverse, own)
            apart = [
                np.log1p(max((information[a, b] + information[b, a]) / 2 - len(rows), 0.0)) for a, b in pairs
            ]
            worth[pose] = min(apart) + 0.05 * float(np.mean(apart))
        chosen.append(int(np.argmax(worth)))
    return tuple(chosen)


def _cause_of_motions(name: str, kind: str, look: Array, moves: Array) -> DriftCause:
    columns = np.einsum("nci,nik->nck", look, moves)
    return DriftCause(name, kind, columns.reshape(-1, columns.shape[2]))


def _reading_gradients(task: ArmTask, tips_m: Array, values_m: Array | None) -> Array:
    """Return how readings follow motions of the target in the base (N, channels, 3)."""
    if task.kind == "length":
        away = tips_m - np.array(task.anchor_in_base_m)
        return np.asarray((away / np.linalg.norm(away, axis=1, keepdims=True))[:, None, :])
    turn = np.eye(3)
    if values_m is not None:
        turn = best_fit_transform(
            tips_m.tolist(), np.asarray(values_m).tolist()
        ).target_source.rotation_matrix()
    return np.repeat(turn[None], len(tips_m), axis=0)


def _turn_motions(tips_m: Array) -> Array:
    """Return how small turns of the device about the middle move the places, a lever long (N, 3, 3)."""
    arms = tips_m - tips_m.mean(axis=0)
    return np.asarray(np.stack([np.cross(axis, arms) for axis in np.eye(3)], axis=2) / _LEVER_M)


def _log_density(covariance: Array, changes: Array, sigma_m: float) -> float:
    total = covariance + sigma_m**2 * np.eye(len(changes))
    _, log_volume = np.linalg.slogdet(total)
    return float(-0.5 * (log_volume + changes @ np.linalg.solve(total, changes)))


def _cause_posterior(cause: DriftCause, size: float, changes: Array, sigma_m: float) -> tuple[Array, Array]:
    columns = cause.columns[: len(changes)]
    information = columns.T @ columns / sigma_m**2 + np.eye(columns.shape[1]) / max(size, 1e-12) ** 2
    covariance = np.linalg.inv(information)
    mean: Array = covariance @ (columns.T @ changes) / sigma_m**2
    return mean, np.asarray(covariance, dtype=np.float64)


def _probable_cause(
    cause: DriftCause, probability: float, size: float, changes: Array, sigma_m: float
) -> ProbableCause:
    if cause.kind in (NOTHING, OTHER):
        return ProbableCause(cause.name, probability, (), (), float(np.sqrt(np.mean(changes**2))))
    mean, covariance = _cause_posterior(cause, size, changes, sigma_m)
    unexplained = changes - cause.columns @ mean
    sigma = np.sqrt(np.diag(covariance))
    values, uncertainties = tuple(float(v) for v in mean), tuple(float(v) for v in sigma)
    return ProbableCause(
        cause.name, probability, values, uncertainties, float(np.sqrt(np.mean(unexplained**2)))
    )


def _predict_changes(cause: DriftCause, changes: Array, sigma_m: float) -> tuple[Array, Array]:
    """Return mean and covariance of the changes still to come, at the size that fits those so far best."""
    sizes = _GRIDS.get(cause.kind, (0.0,))
    count, columns = len(changes), cause.columns
    fits = [_log_density(s**2 * columns[:count] @ columns[:count].T, changes, sigma_m) for s in sizes]
    mean, covariance = _cause_posterior(cause, sizes[int(np.argmax(fits))], changes, sigma_m)
    later = columns[count:]
    spread: Array = later @ covariance @ later.T + sigma_m**2 * np.eye(len(later))
    expected: Array = np.asarray(later @ mean, dtype=np.float64)
    return expected, spread
