"""Joint positions that make the real arm go where the nominal one would, and the way back.

A controller computes with the nominal arm. To make its robot stand right, every programmed position is
replaced by one whose *real* place is the intended one (upload); a position taught on the real robot is brought
back to the nominal world the other way round (download). Each point ends with a status, and with the error that
is left, seen by forward kinematics at the very joints that are returned.
"""

from collections.abc import Callable
from dataclasses import dataclass
from enum import IntEnum, StrEnum
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from cellcal.calibration.arm.joint_kinds import beyond_limits
from cellcal.calibration.arm.kinematics import RobotModel
from cellcal.calibration.compensation.bounded_steps import BoundedSearch
from cellcal.calibration.compensation.damped_solve import damped_step
from cellcal.calibration.compensation.pose_gap import (
    Flags,
    PoseGap,
    TargetPoses,
    TipArm,
    gap_between,
    refuse_few_joints,
)
from cellcal.calibration.errors import CalibrationError
from cellcal.calibration.geometry import Array, is_rigid
from cellcal.calibration.message import make_message

Rows: TypeAlias = slice | NDArray[np.intp]

_BLOCK = 2048  # postures at once: large enough for numpy, small enough for the cache
_QUICK_STEPS = 5
_FLOOR = 1e-12  # of the damping: keeps Cholesky real where the arm is singular
_SHARE = 0.01  # of the squared error that becomes damping: steps stay quadratic near the answer
_POSE = 6  # numbers of a pose: as many joints must be free


class PointStatus(IntEnum):
    """The outcome for a point. Only a converged one stands where it shall."""

    CONVERGED = 0
    LIMIT = 1  # a joint limit is in the way
    SINGULAR = 2  # the arm loses a direction of motion on the way, and the steps did not settle
    BRANCH_KEPT = 3  # the pose needs another branch, or a joint far from where it was
    UNREACHABLE = 4  # no posture near by is nearer: the arm is at the end of its reach


class ProgramDirection(StrEnum):
    """The direction in which a program is converted."""

    UPLOAD = "upload"  # nominal program to the real robot
    DOWNLOAD = "download"  # taught on the real robot, to the nominal world


@dataclass(frozen=True, slots=True)
class CompensationLimits:
    """When a pose counts as reached, and how far a joint may go for it."""

    position_m: float = 1e-8
    angle_rad: float = 1e-8
    max_step_rad: float = 0.3  # of any joint in one step
    branch_rad: float = 0.5  # of any joint from where it was: beyond is another branch
    held: tuple[int, ...] = ()  # joints (from 0) that stay where they are: a track, a redundant axis


@dataclass(frozen=True, eq=False)
class Compensation:
    """Compensated joints, the pose first.

    A point that is not converged carries the nearest posture that was allowed, never a worse one than it came
    with; its errors say how near that is.
    """

    joints_rad: Array  # (N, n)
    status: NDArray[np.int8]  # (N,), of PointStatus
    position_error_m: Array  # (N,)
    angle_error_rad: Array  # (N,)
    steps: NDArray[np.int64]  # (N,)

    @property
    def has_converged(self) -> Flags:
        """Which points (N,) stand where they shall."""
        reached: Flags = self.status == PointStatus.CONVERGED
        return reached


def compensate(
    real: TipArm | RobotModel,
    nominal: TipArm | RobotModel,
    joints_rad: Array,
    *,
    direction: ProgramDirection = ProgramDirection.UPLOAD,
    limits: CompensationLimits = CompensationLimits(),
) -> Compensation:
    """Find the joints that bring one arm's tip to where the other's is at the joints given.

    Parameters
    ----------
    real, nominal : Arm or RobotModel
        With the tip each of them has; a bare model's tip is its flange. Bases are the same frame.
    joints_rad : (N, n)
        Controller joints [rad]: of the nominal program (upload), or taught on the real robot (download).
    direction : Direction
        Upload finds joints for the real arm, download for the nominal one.
    limits : CompensationLimits
        Tolerances [m, rad], longest step and the way a joint may go.

    Returns
    -------
    Compensation
        No joint moves by more than ``limits.branch_rad``, and none of a converged point is beyond its limit.

    Raises
    ------
    CalibrationError
        Arms of different numbers of joints, joints of another shape or not finite, tolerances not positive.

    Notes
    -----
    Newton with a damping that fades with the squared error, for all points at once; the few that do not arrive,
    or leave the box of limits and branch, begin again with Levenberg-Marquardt inside that box. Sag and ripple
    enter the poses but not the derivatives, where they are a thousandth.

    References
    ----------
    T. Sugihara, Solvability-unconcerned inverse kinematics by the Levenberg-Marquardt method, IEEE Trans.
    Robotics 27 (2011) 984: damping by the error itself.
    """
    arms = {ProgramDirection.UPLOAD: (real, nominal), ProgramDirection.DOWNLOAD: (nominal, real)}
    moved, followed = (_as_arm(arm) for arm in arms[ProgramDirection(direction)])
    start = np.asarray(joints_rad, dtype=float)
    _check_input(moved, followed, start, limits)
    return _solve_poses(moved, lambda rows: TargetPoses.from_joints(followed, start[rows].T), start, limits)


def reach_poses(
    arm: TipArm | RobotModel,
    base_tip: Array,
    start_rad: Array,
    *,
    limits: CompensationLimits = CompensationLimits(),
    careful: bool = True,
) -> Compensation:
    """Find the joints that bring an arm's tip to poses (N, 4, 4) [m], from postures near by (N, n) [rad].

    As `compensate`, with poses in place of the other arm. Without care only the points that arrive within a few
    steps are answered; the others stay where they began.

    Raises
    ------
    CalibrationError
        Joints of another shape or not finite, poses that are not rigid, tolerances not positive.
    """
    moved, start = _as_arm(arm), np.asarray(start_rad, dtype=float)
    _check_input(moved, moved, start, limits)
    if base_tip.shape != (len(start), 4, 4) or (len(start) and not is_rigid(base_tip)):
        raise CalibrationError(
            make_message(
                "poses must be rigid transforms ({start_count}, 4, 4), not {shape}",
                start_count=len(start),
                shape=base_tip.shape,
            )
        )

    def target_of(rows: Rows) -> TargetPoses:
        poses = base_tip[rows]
        axes = np.ascontiguousarray(poses[:, :3, :3].transpose(2, 1, 0))
        return TargetPoses(axes, np.ascontiguousarray(poses[:, :3, 3].T))

    return _solve_poses(moved, target_of, start, limits, careful=careful)


def _solve_poses(
    moved: TipArm,
    target: Callable[[Rows], TargetPoses],
    start: Array,
    limits: CompensationLimits,
    *,
    careful: bool = True,
) -> Compensation:
    outcome = _PointResults.from_start(np.ascontiguousarray(start.T))
    rest = np.zeros(len(start), dtype=bool)
    for first in range(0, len(start), _BLOCK):
        block = slice(first, first + _BLOCK)
        rest[block] = _solve_unbounded(moved, target(block), outcome.view_block(block), limits)
    # Together, because many steps of a few points cost as much as many steps of a block.
    remaining = np.flatnonzero(rest)
    outcome.status[remaining] = PointStatus.SINGULAR
    for first in range(0, len(remaining) if careful else 0, _BLOCK):
        rows = remaining[first : first + _BLOCK]
        _solve_bounded(moved, target(rows), outcome, rows, limits)
    return Compensation(
        np.ascontiguousarray(outcome.joints.T),
        outcome.status,
        outcome.position_m,
        outcome.angle_rad,
        outcome.steps,
    )


@dataclass(eq=False)
class _PointResults:
    """The answers, filled in as points arrive; components first."""

    start: Array
    joints: Array
    status: NDArray[np.int8]
    position_m: Array
    angle_rad: Array
    steps: NDArray[np.int64]

    @classmethod
    def from_start(cls, start: Array) -> "_PointResults":
        n = start.shape[1]
        status = np.full(n, PointStatus.SINGULAR, dtype=np.int8)
        return cls(start, start.copy(), status, np.zeros(n), np.zeros(n), np.zeros(n, dtype=np.int64))

    def view_block(self, block: slice) -> "_PointResults":
        """Return a view of a block."""
        return _PointResults(
            self.start[:, block],
            self.joints[:, block],
            self.status[block],
            self.position_m[block],
            self.angle_rad[block],
            self.steps[block],
        )

    def store_points(
        self, rows: NDArray[np.intp], joints: Array, gap: PoseGap, chosen: Flags | slice
    ) -> None:
        self.joints[:, rows] = joints[:, chosen]
        self.position_m[rows] = gap.position_m[chosen]
        self.angle_rad[rows] = gap.angle_rad[chosen]


def _solve_unbounded(
    moved: TipArm, target: TargetPoses, outcome: _PointResults, limits: CompensationLimits
) -> Flags:
    """Take a few Newton steps for all points of a block, and return which ones need more care."""
    joints = outcome.start
    rows = np.arange(joints.shape[1])
    for step in range(_QUICK_STEPS + 1):
        gap = gap_between(moved, joints, target)
        met = gap.is_reached(limits.position_m, limits.angle_rad)
        last = step == _QUICK_STEPS or bool(met.all())
        if last or met.sum() * 8 > len(met):
            outcome.store_points(rows[met], joints, gap, met)
            outcome.status[rows[met]] = PointStatus.CONVERGED
            outcome.steps[rows[met]] = step
            remaining = ~met
            rows, joints, target, gap = (
                rows[remaining],
                joints[:, remaining],
                target.select_poses(remaining),
                gap.select_poses(remaining),
            )
        if last:
            break
        joints = joints + _quick_step(moved, gap, limits)
    model, going = moved.model, outcome.joints
    inside = (beyond_limits(model, going.T) <= 0.0).all(axis=1)
    near = (np.abs(going - outcome.start) <= limits.branch_rad).all(axis=0)
    has_failed: Flags = (outcome.status != PointStatus.CONVERGED) | ~inside | ~near
    return has_failed


def _quick_step(arm: TipArm, gap: PoseGap, limits: CompensationLimits) -> Array:
    damping = _SHARE * np.einsum("in,in->n", gap.error, gap.error) + _FLOOR
    columns = gap.tip_jacobian(arm)
    columns[list(limits.held)] = 0.0
    step = damped_step(columns, gap.error, damping)
    longest = np.maximum(step.max(axis=0), -step.min(axis=0))
    if longest.max() > limits.max_step_rad:
        step *= np.minimum(1.0, limits.max_step_rad / np.maximum(longest, 1e-300))
    return step


def _solve_bounded(
    moved: TipArm,
    target: TargetPoses,
    outcome: _PointResults,
    rows: NDArray[np.intp],
    limits: CompensationLimits,
) -> None:
    """Search inside the box of joint limits and branch, and say what was in the way."""
    start = outcome.start[:, rows]
    lower, upper = moved.model.lower_rad[:, None], moved.model.upper_rad[:, None]
    # A point that comes in from beyond a limit may stay there: it will say so.
    low = np.minimum(np.maximum(lower, start - limits.branch_rad), start)
    high = np.maximum(np.minimum(upper, start + limits.branch_rad), start)
    held = list(limits.held)
    low[held] = high[held] = start[held]
    search = BoundedSearch.start_inside(moved, target, start.copy(), (low, high))
    search.approach_poses(limits)
    outcome.store_points(rows, search.joints, search.gap, slice(None))
    outcome.steps[rows] = search.steps
    outcome.status[rows] = _point_status(search, limits)


def _point_status(search: BoundedSearch, limits: CompensationLimits) -> NDArray[np.int8]:
    model = search.arm.model
    lower, upper = model.lower_rad[:, None], model.upper_rad[:, None]
    low, high = search.find_pushes()
    met = search.gap.is_reached(limits.position_m, limits.angle_rad)
    beyond = (beyond_limits(model, search.joints.T) > 0.0).any(axis=1)
    at_limit = ((low & (search.joints <= lower)) | (high & (search.joints >= upper))).any(axis=0)
    conditions = [beyond | (at_limit & ~met), met, (low | high).any(axis=0), search.settled]
    answers = [
        PointStatus.LIMIT,
        PointStatus.CONVERGED,
        PointStatus.BRANCH_KEPT,
        PointStatus.UNREACHABLE,
    ]
    return np.select(conditions, answers, PointStatus.SINGULAR).astype(np.int8)


def _as_arm(arm: TipArm | RobotModel) -> TipArm:
    return TipArm(arm) if isinstance(arm, RobotModel) else arm


def _check_input(moved: TipArm, followed: TipArm, joints: Array, limits: CompensationLimits) -> None:
    n = moved.model.axis_count
    if followed.model.axis_count != n:
        raise CalibrationError(
            make_message(
                "arms of {n} and {axis_count} joints cannot stand in for each other",
                n=n,
                axis_count=followed.model.axis_count,
            )
        )
    held = set(limits.held)
    refuse_few_joints(moved.model)
    if not held <= set(range(n)) or n - len(held) < _POSE:
        raise CalibrationError(
            make_message(
                "{label}: of {n} joints {held} cannot stay: a pose needs six others.",
                label=moved.model.label,
                n=n,
                held=sorted(held),
            )
        )
    if joints.ndim != 2 or joints.shape[1] != n or not np.isfinite(joints).all():
        raise CalibrationError(
            make_message(
                "joints must be finite and (N, {axis_count}), not {shape}", axis_count=n, shape=joints.shape
            )
        )
    sizes = (limits.position_m, limits.angle_rad, limits.max_step_rad, limits.branch_rad)
    if not all(np.isfinite(size) and size > 0 for size in sizes):
        raise CalibrationError("tolerances and limits of compensation must be positive and finite")
