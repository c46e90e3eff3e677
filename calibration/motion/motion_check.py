"""Whether a list of joint targets may be commanded: limits, speed, workspace, collision, singularity, draw-wire.

This is a check of a plan, not a safety function: stops and space limits are the controller's.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from cellcal.calibration.arm.kinematics import RobotModel
from cellcal.calibration.errors import CalibrationError
from cellcal.calibration.geometry import Array
from cellcal.calibration.message import make_message
from cellcal.calibration.motion.motion_quantities import (
    SHOWN_UNITS,
    LimitExcess,
    joint_limit_excess,
    singularity_excess,
    speed_excess,
    wire_range_excesses,
    wire_wrap_excess,
    workspace_excess,
)
from cellcal.calibration.motion.position_uncertainty import PositionUncertainty

_MOST_SLIDE_MARGIN_M = 0.005  # of a joint that slides: a quill travels 0.1 to 0.3 m
_FAR_BEYOND_RAD = 1.0  # beyond a joint's limit
_RATE_SAMPLE_RAD = 0.02  # paths are looked at this densely; more so where collisions are checked


class ClearanceCheck(Protocol):
    """A check that knows the shapes of arm and cell: `calibration.motion.collision.CollisionCheck`."""

    @property
    def not_checked(self) -> tuple[str, ...]: ...
    def compute_clearances(
        self, joints_rad: Array, position_uncertainty: PositionUncertainty | None = None
    ) -> LimitExcess:
        """Return the clearance of every pair of shapes in every posture, against what it must be."""
        ...

    def piece_count(self, start_rad: Array, stop_rad: Array) -> int:
        """Return into how many pieces a way must be cut for no point of the arm to move more than 5 mm."""
        ...


@dataclass(frozen=True, slots=True)
class WirePath:
    """A draw-wire from an anchor in the base to a hook on the flange, with the range it may use."""

    anchor_in_base_m: tuple[float, float, float]
    hook_in_flange_m: tuple[float, float, float]
    range_m: float
    zero_m: float = 0.0
    lowest_fraction: float = 0.03
    highest_fraction: float = 0.97
    wrap_rad: float = 4.712389  # 270 deg: how far it may wind about the flange from where a plan begins


@dataclass(frozen=True, slots=True)
class MotionLimits:
    """The limits of a move. ``None`` means that nothing is known, and the verdict says so."""

    joint_margin_rad: float = 0.0523599  # 3 deg
    mastering_uncertainty_rad: tuple[float, ...] = ()  # per joint, added to the margin
    position_uncertainty: PositionUncertainty | None = (
        None  # about where the arm stands: shapes and box keep more distance
    )
    joint_speed_rad_s: float = 0.0872665  # 5 deg/s
    tip_speed_m_s: float = 0.05
    box_low_m: tuple[float, float, float] | None = None  # the flange, the tip and the wrist stay inside
    box_high_m: tuple[float, float, float] | None = None
    smallest_singular_value: float | None = None  # of the Jacobian, in m/rad; for straight moves
    wire: WirePath | None = None
    clearances: ClearanceCheck | None = None


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

    def times_too_fast(self, legs: int, margin: float) -> Array:
        """Return (legs,): 1 where no part of the arm exceeds its cap, else how many times slower a leg must be."""
        times = np.ones(legs)
        for finding in self.findings:
            if finding.check == "tip speed":
                times[finding.target] = max(1.0, margin * finding.found / finding.limit)
        return times


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
    it shall stay must keep the limit itself. Joints interpolate linearly; samples are at most 0.02 rad apart,
    and where shapes are known no point of the arm moves more than 5 mm between two samples. The speeds of tip,
    flange and every joint's centre (elbow and wrist among them) are held to one cap.
    """
    targets, start = np.atleast_2d(np.asarray(targets_rad, dtype=float)), np.asarray(start_rad, dtype=float)
    if start.shape != (model.axis_count,) or targets.shape[1] != model.axis_count:
        raise CalibrationError(
            f"{model.label}: a start ({model.axis_count},) and targets (N, {model.axis_count}) are needed"
        )
    invalid = _not_finite(start, targets, (speed_rad_s, *tip_in_flange_m))
    if invalid:
        return MotionVerdict(False, invalid, ())
    findings = _joint_speed(model, limits, speed_rad_s)
    findings += _far_outside(model, np.vstack([targets, start]))
    if any(finding.check == "joint limits" for finding in findings):
        return MotionVerdict(False, tuple(findings), _not_checked(limits))
    owner, path, direction = sample_motion(start, targets, limits.clearances)
    with_start = np.vstack([start, path])
    stays = _is_stay(owner, stops)
    postures = _posture_excesses(model, with_start, limits, tip_in_flange_m)
    if limits.wire is not None:
        wire = limits.wire
        places = (wire.anchor_in_base_m, wire.hook_in_flange_m)
        postures.append(wire_wrap_excess(model, with_start, places, wire.wrap_rad))
    excesses = [excess.forgive_start(stays) for excess in postures]
    rates = speed_rad_s * direction
    excesses.append(speed_excess(model, path, rates, tip_in_flange_m, limits.tip_speed_m_s))
    findings += [f for excess in excesses for f in _worst_findings(excess, owner)]
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
        broken |= excess.is_broken()
    allowed: Array = finite & ~broken
    return allowed


def seems_free(
    model: RobotModel, start_rad: Array, targets_rad: Array, limits: MotionLimits, *, looks: int = 12
) -> Array:
    """Return (N,): to which targets the straight way seems free, looked at in a few places: to choose with.

    What is chosen is checked by ``check_moves``. Targets are finite.
    """
    targets = np.asarray(targets_rad, dtype=float).reshape(-1, model.axis_count)
    share = np.linspace(0.0, 1.0, looks + 1)[1:, None]
    ways = start_rad + share * (targets[:, None] - start_rad)
    free = np.ones(ways.shape[:2], dtype=bool)
    for excess in _posture_excesses(model, ways.reshape(-1, model.axis_count), limits, (0.0, 0.0, 0.0)):
        free &= ~excess.is_broken().reshape(free.shape)
    if limits.wire is not None:
        wire = limits.wire
        places = (wire.anchor_in_base_m, wire.hook_in_flange_m)
        for k, way in enumerate(ways):
            free[k] &= ~wire_wrap_excess(
                model, np.vstack([start_rad, way]), places, wire.wrap_rad
            ).is_broken()[1:]
    return np.asarray(free.all(axis=1))


def _is_stay(owner: NDArray[np.int_], stops: Sequence[bool] | None) -> NDArray[np.bool_]:
    """Return which samples are targets to stay at: the last sample of each such target."""
    last = np.append(owner[1:] != owner[:-1], True)
    stays: NDArray[np.bool_] = last if stops is None else last & np.asarray(stops, dtype=bool)[owner]
    return stays


def _not_finite(start: Array, targets: Array, others: tuple[float, ...]) -> tuple[MotionFinding, ...]:
    bad = np.flatnonzero(~np.isfinite(targets).all(axis=1))
    if not np.isfinite([*start, *others]).all():
        bad = np.array([0])
    nan = float("nan")
    words = [make_message("target {i}: a number is not finite, nothing may move", i=i + 1) for i in bad]
    return tuple(
        MotionFinding(int(i), "finite", nan, nan, message) for i, message in zip(bad, words, strict=True)
    )


def _far_outside(model: RobotModel, targets: Array) -> list[MotionFinding]:
    """Refuse targets, the last row a start, far beyond the limits: a way there is not worth looking at."""
    beyond = np.maximum(model.lower_rad - targets, targets - model.upper_rad)
    findings = []
    for index in np.flatnonzero((beyond > _FAR_BEYOND_RAD).any(axis=1)):
        axis = int(np.argmax(beyond[index]))
        found = float(targets[index, axis])
        limit = float(model.lower_rad[axis] if found < model.lower_rad[axis] else model.upper_rad[axis])
        called = (
            make_message("target {target_name}", target_name=index + 1)
            if index < len(targets) - 1
            else "the start"
        )
        sliding = model.sliding is not None and bool(model.sliding[axis])
        unit, scale = ("mm", 1e3) if sliding else SHOWN_UNITS["rad"]
        words = make_message(
            "{called}, joint limits of {name}: {found:.4g} {unit}, limit {limit:.4g} {unit}",
            called=called,
            name=f"J{axis + 1}",
            found=found * scale,
            unit=unit,
            limit=limit * scale,
        )
        findings.append(MotionFinding(int(index), "joint limits", found, limit, words))
    return findings


def sample_motion(
    start: Array, targets: Array, clearances: ClearanceCheck | None
) -> tuple[NDArray[np.int_], Array, Array]:
    """Return which target each sample belongs to, the samples (S, n), and the joints' rates there (S, n).

    Every target is a sample; the fastest joint has the rate 1.
    """
    owners, pieces, rates, before = [], [], [], start
    for index, target in enumerate(targets):
        way = target - before
        farthest = float(np.abs(way).max())
        steps = max(int(np.ceil(farthest / _RATE_SAMPLE_RAD)), 1)
        if clearances is not None:
            steps = max(steps, clearances.piece_count(before, target))
        share = np.arange(1, steps + 1)[:, None] / steps
        pieces.append(before + share * way)
        owners.append(np.full(steps, index))
        rates.append(np.broadcast_to(way / farthest if farthest > 0 else way, (steps, len(way))))
        before = target
    return np.concatenate(owners), np.concatenate(pieces), np.concatenate(rates)


def _posture_excesses(
    model: RobotModel, joints: Array, limits: MotionLimits, tip_in_flange_m: tuple[float, float, float]
) -> list[LimitExcess]:
    excesses = [_joint_limits(model, joints, limits)]
    if limits.box_low_m is not None and limits.box_high_m is not None:
        box = (limits.box_low_m, limits.box_high_m)
        excesses.append(workspace_excess(model, joints, box, tip_in_flange_m, limits.position_uncertainty))
    if limits.smallest_singular_value is not None:
        excesses.append(singularity_excess(model, joints, limits.smallest_singular_value))
    if limits.wire is not None:
        wire = limits.wire
        low, high = wire.lowest_fraction * wire.range_m, wire.highest_fraction * wire.range_m
        places = (wire.anchor_in_base_m, wire.hook_in_flange_m)
        excesses += wire_range_excesses(model, joints, places, wire.zero_m, (low, high))
    if limits.clearances is not None:
        excesses.append(limits.clearances.compute_clearances(joints, limits.position_uncertainty))
    return excesses


def _joint_limits(model: RobotModel, joints: Array, limits: MotionLimits) -> LimitExcess:
    return joint_limit_excess(model, joints, _joint_margins(model, limits))


def _joint_margins(model: RobotModel, limits: MotionLimits) -> Array:
    """Return the distance that each joint keeps from its limits (n,) [rad, m]."""
    margins: Array = np.full(model.axis_count, limits.joint_margin_rad)
    if model.sliding is not None:
        margins[model.sliding] = min(limits.joint_margin_rad, _MOST_SLIDE_MARGIN_M)
    if limits.mastering_uncertainty_rad:
        margins += limits.mastering_uncertainty_rad
    return margins


def narrow_joints(model: RobotModel, limits: MotionLimits) -> tuple[int, ...]:
    """Return the joints (from 0) whose range is within the margins at its two ends: no posture keeps them."""
    within = model.upper_rad - model.lower_rad <= 2.0 * _joint_margins(model, limits)
    return tuple(np.flatnonzero(within).tolist())


def _joint_speed(model: RobotModel, limits: MotionLimits, speed_rad_s: float) -> list[MotionFinding]:
    limit = min(limits.joint_speed_rad_s, float(np.min(model.max_speed_rad_s)))
    if 0 < speed_rad_s <= limit:
        return []
    words = make_message(
        "joint speed: {speed:.4g} deg/s is not within 0 and {limit:.4g} deg/s",
        speed=np.rad2deg(speed_rad_s),
        limit=np.rad2deg(limit),
    )
    return [MotionFinding(0, "joint speed", speed_rad_s, limit, words)]


def _worst_findings(excess: LimitExcess, owner: NDArray[np.int_]) -> list[MotionFinding]:
    """Report, per target, the sample that breaks this limit most."""
    findings = []
    for target in np.unique(owner[excess.is_broken()]):
        samples = np.flatnonzero(owner == target)
        row, column = np.unravel_index(np.argmax(excess.excess[samples]), excess.excess[samples].shape)
        worst = samples[row]
        found, limit = float(excess.found[worst, column]), float(excess.limit[worst, column])
        what = excess.quantity_names[column] if excess.quantity_names else excess.check
        unit, scale = excess.shown_as(int(column))
        words = make_message(
            "target {target}, {what}: {found:.4g} {unit}, limit {limit:.4g} {unit}",
            target=target + 1,
            what=what,
            found=found * scale,
            unit=unit,
            limit=limit * scale,
        )
        if excess.uncertainty is not None:
            words = make_message(
                "{words}, of which {uncertainty:.3g} m are for turns that are not known yet",
                words=words,
                uncertainty=excess.uncertainty[worst, column],
            )
        findings.append(MotionFinding(int(target), excess.check, found, limit, words))
    return findings


def _not_checked(limits: MotionLimits) -> tuple[str, ...]:
    words = [] if limits.clearances is None else list(limits.clearances.not_checked)
    if limits.clearances is None:
        words.append("no obstacles known: path not checked for collisions")
    if limits.box_low_m is None or limits.box_high_m is None:
        words.append("no workspace box known")
    if limits.wire is None and "the draw-wire is not part of this plan" not in words:
        words.append("the draw-wire is not part of this plan")
    return tuple(words)
