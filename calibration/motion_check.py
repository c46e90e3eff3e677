"""Whether a list of joint targets may be commanded: limits, speed, workspace, singularity, draw-wire.

This is a check of a plan, not a safety function: stops and space limits are the controller's.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from calibration.errors import CalibrationError
from calibration.geometry import Array
from calibration.kinematics import RobotModel, chain_frames

_RATE_SAMPLE_RAD = 0.02  # paths are looked at this densely


@dataclass(frozen=True, slots=True)
class WirePath:
    """A draw-wire from an anchor in the base to a hook on the flange, with the range it may use."""

    anchor_in_base_m: tuple[float, float, float]
    hook_in_flange_m: tuple[float, float, float]
    range_m: float
    zero_m: float = 0.0
    lowest_fraction: float = 0.03
    highest_fraction: float = 0.97


@dataclass(frozen=True, slots=True)
class MotionLimits:
    """What a move must keep. ``None`` means that nothing is known, and the verdict says so."""

    joint_margin_rad: float = 0.0523599  # 3 deg
    mastering_uncertainty_rad: tuple[float, ...] = ()  # per joint, added to the margin
    joint_speed_rad_s: float = 0.0872665  # 5 deg/s
    tip_speed_m_s: float = 0.05
    box_low_m: tuple[float, float, float] | None = None  # the flange, the tip and the wrist stay inside
    box_high_m: tuple[float, float, float] | None = None
    smallest_singular_value: float | None = None  # of the Jacobian, in m/rad; for straight moves
    wire: WirePath | None = None


@dataclass(frozen=True, slots=True)
class MotionFinding:
    """One broken limit; ``target`` counts from 0."""

    target: int
    check: str
    found: float
    limit: float
    sentence: str


@dataclass(frozen=True, slots=True)
class MotionVerdict:
    """Whether every target and every way between them is allowed, and what was not checked at all."""

    allowed: bool
    findings: tuple[MotionFinding, ...]
    not_checked: tuple[str, ...]


@dataclass(frozen=True, slots=True)
class _Excess:
    """A quantity per pose and by how much it breaks its limit (> 0: broken)."""

    check: str
    found: Array
    limit: Array
    excess: Array
    unit: str


def check_moves(  # noqa: PLR0913 - one move needs all of it
    model: RobotModel,
    start_rad: Array | tuple[float, ...],
    targets_rad: Array,
    limits: MotionLimits,
    *,
    speed_rad_s: float,
    tip_in_flange_m: tuple[float, float, float] = (0.0, 0.0, 0.0),
    stops: Sequence[bool] | None = None,
) -> MotionVerdict:
    """Check joint moves from a start through targets, including the ways between them.

    Parameters
    ----------
    model : RobotModel
        The arm.
    start_rad : (n,)
        Where it stands [rad].
    targets_rad : (N, n)
        Where it shall go, in order [rad].
    limits : MotionLimits
        What to keep.
    speed_rad_s : float
        Commanded speed of the fastest joint [rad/s].
    tip_in_flange_m : (3,)
        Tool tip [m].
    stops : (N,), optional
        At which targets the robot stays; the others are corners of a way. All of them when not said.

    Returns
    -------
    MotionVerdict
        The first finding of each check for each target.

    Raises
    ------
    CalibrationError
        Wrong shapes. Numbers that are not finite are a finding, not an error: nothing else is computed then.

    Notes
    -----
    On its way back from beyond a limit a robot may be as far out as where it started, and no further; where
    it shall stay must keep the limit itself. Joints interpolate linearly; samples are at most 0.02 rad apart.
    Collisions with the cell are not checked.
    """
    targets, start = np.atleast_2d(np.asarray(targets_rad, dtype=float)), np.asarray(start_rad, dtype=float)
    if start.shape != (model.axes,) or targets.shape[1] != model.axes:
        raise CalibrationError(
            f"{model.name}: a start ({model.axes},) and targets (N, {model.axes}) are needed"
        )
    invalid = _not_finite(start, targets, (speed_rad_s, *tip_in_flange_m))
    if invalid:
        return MotionVerdict(False, invalid, ())
    owner, path = _sample(start, targets)
    with_start = np.vstack([start, path])
    stays = _stays(owner, stops)
    postures = _posture_excesses(model, with_start, limits, tip_in_flange_m)
    excesses = [_beyond_start(excess, stays) for excess in postures]
    excesses.append(_tip_speed(model, path, limits, (speed_rad_s, tip_in_flange_m)))
    findings = _joint_speed(model, limits, speed_rad_s)
    findings += [f for excess in excesses for f in _findings(excess, owner)]
    findings.sort(key=lambda f: f.target)
    return MotionVerdict(not findings, tuple(findings), _not_checked(limits))


def allowed_postures(
    model: RobotModel,
    joints_rad: Array,
    limits: MotionLimits,
    tip_in_flange_m: tuple[float, float, float] = (0.0, 0.0, 0.0),
) -> Array:
    """Return (N,) booleans: which postures keep joint limits, box, singularity and wire range."""
    joints = np.asarray(joints_rad, dtype=float)
    finite = np.isfinite(joints).all(axis=1)
    broken = np.zeros(len(joints), dtype=bool)
    for excess in _posture_excesses(model, np.where(finite[:, None], joints, 0.0), limits, tip_in_flange_m):
        broken |= excess.excess > 0
    allowed: Array = finite & ~broken
    return allowed


def _stays(owner: NDArray[np.int_], stops: Sequence[bool] | None) -> NDArray[np.bool_]:
    """Return which samples are targets to stay at: the last sample of each such target."""
    last = np.append(owner[1:] != owner[:-1], True)
    stays: NDArray[np.bool_] = last if stops is None else last & np.asarray(stops, dtype=bool)[owner]
    return stays


def _beyond_start(excess: _Excess, stays: NDArray[np.bool_]) -> _Excess:
    """Drop the start from a checked way; forgive on the way by how much the start breaks the limit."""
    forgiven = np.where(stays, 0.0, max(float(excess.excess[0]), 0.0))
    limit = np.broadcast_to(excess.limit, excess.excess.shape)
    return _Excess(excess.check, excess.found[1:], limit[1:], excess.excess[1:] - forgiven, excess.unit)


def _not_finite(start: Array, targets: Array, others: tuple[float, ...]) -> tuple[MotionFinding, ...]:
    bad = np.flatnonzero(~np.isfinite(targets).all(axis=1))
    if not np.isfinite([*start, *others]).all():
        bad = np.array([0])
    nan = float("nan")
    words = "a number is not finite: nothing may move"
    return tuple(MotionFinding(int(i), "finite", nan, nan, f"target {i + 1}: {words}") for i in bad)


def _sample(start: Array, targets: Array) -> tuple[NDArray[np.int_], Array]:
    """Return which target each sample belongs to, and the samples (S, n); every target is a sample."""
    owners, pieces, before = [], [], start
    for index, target in enumerate(targets):
        steps = max(int(np.ceil(np.abs(target - before).max() / _RATE_SAMPLE_RAD)), 1)
        share = np.arange(1, steps + 1)[:, None] / steps
        pieces.append(before + share * (target - before))
        owners.append(np.full(steps, index))
        before = target
    return np.concatenate(owners), np.concatenate(pieces)


def _posture_excesses(
    model: RobotModel, joints: Array, limits: MotionLimits, tip_in_flange_m: tuple[float, float, float]
) -> list[_Excess]:
    excesses = [_joint_limits(model, joints, limits)]
    if limits.box_low_m is not None and limits.box_high_m is not None:
        excesses.append(_box(model, joints, limits, tip_in_flange_m))
    if limits.smallest_singular_value is not None:
        excesses.append(_singularity(model, joints, limits.smallest_singular_value))
    if limits.wire is not None:
        excesses += _wire_range(model, joints, limits.wire)
    return excesses


def _joint_limits(model: RobotModel, joints: Array, limits: MotionLimits) -> _Excess:
    doubt = np.array(limits.mastering_uncertainty_rad or (0.0,) * model.axes)
    margin = limits.joint_margin_rad + doubt
    below, above = model.lower_rad + margin - joints, joints - model.upper_rad + margin
    outside = np.maximum(below, above)
    axis = np.argmax(outside, axis=1)
    rows = np.arange(len(joints))
    limit = np.where(
        below[rows, axis] > above[rows, axis],
        (model.lower_rad + margin)[axis],
        (model.upper_rad - margin)[axis],
    )
    return _Excess("joint limits", joints[rows, axis], limit, outside[rows, axis], "rad")


def _box(
    model: RobotModel, joints: Array, limits: MotionLimits, tip_in_flange_m: tuple[float, float, float]
) -> _Excess:
    low, high = np.array(limits.box_low_m), np.array(limits.box_high_m)
    origins = chain_frames(model, joints)[1].transpose(2, 0, 1)[:, 2:]
    points = np.concatenate(
        [origins, model.tip_positions(joints, np.array(tip_in_flange_m))[:, None]], axis=1
    )
    outside = np.maximum(low - points, points - high).reshape(len(joints), -1)
    worst = np.argmax(outside, axis=1)
    rows = np.arange(len(joints))
    found = points.reshape(len(joints), -1)[rows, worst]
    edges = np.where(
        found < np.tile(low, points.shape[1])[worst],
        np.tile(low, points.shape[1])[worst],
        np.tile(high, points.shape[1])[worst],
    )
    return _Excess("workspace box", found, edges, outside[rows, worst], "m")


def _singularity(model: RobotModel, joints: Array, limit: float) -> _Excess:
    values = np.linalg.svd(model.flange_jacobian(joints)[1], compute_uv=False)
    smallest = np.asarray(values[:, -1], dtype=np.float64)
    return _Excess("singularity", smallest, np.full(len(joints), limit), limit - smallest, "m/rad")


def _wire_range(model: RobotModel, joints: Array, wire: WirePath) -> list[_Excess]:
    tips = model.tip_positions(joints, np.array(wire.hook_in_flange_m))
    lengths = wire.zero_m + np.linalg.norm(tips - np.array(wire.anchor_in_base_m), axis=1)
    low, high = wire.lowest_fraction * wire.range_m, wire.highest_fraction * wire.range_m
    return [
        _Excess("wire too short", lengths, np.full(len(lengths), low), low - lengths, "m"),
        _Excess("wire too long", lengths, np.full(len(lengths), high), lengths - high, "m"),
    ]


def _tip_speed(
    model: RobotModel, path: Array, limits: MotionLimits, command: tuple[float, tuple[float, float, float]]
) -> _Excess:
    speed_rad_s, tip = command
    # The fastest joint turns at the commanded speed; the others in the proportion of the path's direction.
    direction = np.gradient(path, axis=0) if len(path) > 1 else np.ones_like(path)
    largest = np.abs(direction).max(axis=1, keepdims=True)
    rates = speed_rad_s * direction / np.where(largest > 0, largest, 1.0)
    tips = [np.array(tip), np.zeros(3)]
    speeds = [
        np.linalg.norm(np.einsum("nij,nj->ni", model.tip_jacobian(path, t)[1], rates), axis=1) for t in tips
    ]
    fastest = np.maximum(*speeds)
    return _Excess(
        "tip speed", fastest, np.full(len(path), limits.tip_speed_m_s), fastest - limits.tip_speed_m_s, "m/s"
    )


def _joint_speed(model: RobotModel, limits: MotionLimits, speed_rad_s: float) -> list[MotionFinding]:
    limit = min(limits.joint_speed_rad_s, float(np.min(model.max_speed_rad_s)))
    if 0 < speed_rad_s <= limit:
        return []
    words = f"joint speed: {speed_rad_s:.4g} rad/s is not within 0 and {limit:.4g} rad/s"
    return [MotionFinding(0, "joint speed", speed_rad_s, limit, words)]


def _findings(excess: _Excess, owner: NDArray[np.int_]) -> list[MotionFinding]:
    """Report, per target, the sample that breaks this limit most."""
    findings = []
    for target in np.unique(owner[excess.excess > 0]):
        samples = np.flatnonzero(owner == target)
        worst = samples[np.argmax(excess.excess[samples])]
        found, limit = float(excess.found[worst]), float(excess.limit[worst])
        words = (
            f"target {target + 1}, {excess.check}: {found:.4g} {excess.unit}, limit {limit:.4g} {excess.unit}"
        )
        findings.append(MotionFinding(int(target), excess.check, found, limit, words))
    return findings


def _not_checked(limits: MotionLimits) -> tuple[str, ...]:
    words = ["no obstacles known: path not checked for collisions"]
    if limits.box_low_m is None or limits.box_high_m is None:
        words.append("no workspace box known")
    if limits.wire is None:
        words.append("no draw-wire known")
    return tuple(words)
