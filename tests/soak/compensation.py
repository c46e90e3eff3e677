"""Compensation of random postures in their million: no leap to another branch, no failure that says nothing."""

from dataclasses import dataclass

import numpy as np

from cellcal.calibration.arm.kinematics import RobotModel, load_model
from cellcal.calibration.compensation.compensate import Compensation, PointStatus, compensate
from cellcal.calibration.geometry import Array, log_rotation
from tests.soak.stories import CampaignFigures

_ROBOTS = ("ur10", "abb_irb120", "fanuc_m6ib", "kuka_kr6_r900", "ur5e")
_BLOCK = 20_000
_NEAR_ENOUGH_M = 1e-8
_BRANCH_RAD = 0.5
_OTHER_STARTS = 12
_REGULAR = 0.04  # smallest singular value at the start, where nothing excuses a failure


@dataclass
class _CompensationTally:
    leaps: int = 0
    silent: int = 0
    wrong_numbers: int = 0
    missed: int = 0  # called unreachable or singular, but another start from near by arrives
    converged: int = 0
    regular: int = 0
    regular_converged: int = 0


def compensation(points: int) -> CampaignFigures:
    """Random postures of five arms with errors of a real arm's size, judged by forward kinematics apart."""
    tally, done = _CompensationTally(), 0
    for seed in range(-(-points // _BLOCK)):
        nominal = load_model(_ROBOTS[seed % len(_ROBOTS)])
        rng = np.random.default_rng(seed)
        errors = rng.normal(size=(nominal.axis_count, 5)) * [2.6e-3, 4e-4, 4e-4, 5e-4, 5e-4]
        count = min(_BLOCK, points - done)
        start = rng.uniform(nominal.lower_rad, nominal.upper_rad, (count, nominal.axis_count))
        _judge_points(tally, nominal.with_dh_errors(errors), nominal, start, rng)
        done += count
    line = (
        f"compensation: {tally.leaps} leaps, {tally.silent} silent failures, {tally.wrong_numbers} wrong errors in "
        f"{points} random postures; {tally.converged / points:.2%} converged, of regular ones inside their limits "
        f"{tally.regular_converged} of {tally.regular}; {tally.missed} given up "
        "though another start near by arrives on the same branch"
    )
    return CampaignFigures(line, tally.leaps + tally.silent + tally.wrong_numbers == 0)


def _judge_points(
    tally: _CompensationTally, real: RobotModel, nominal: RobotModel, start: Array, rng: np.random.Generator
) -> None:
    done = compensate(real, nominal, start)
    distance, angle = _pose_differences(real, nominal, done.joints_rad, start)
    arrived = (distance <= 1.001 * _NEAR_ENOUGH_M) & (angle <= 3e-8)
    inside = ((done.joints_rad >= nominal.lower_rad) & (done.joints_rad <= nominal.upper_rad)).all(axis=1)
    tally.leaps += int((np.abs(done.joints_rad - start) > _BRANCH_RAD + 1e-12).any(axis=1).sum())
    tally.silent += int((done.has_converged & ~(arrived & inside)).sum())
    tally.wrong_numbers += int((np.abs(done.position_error_m - distance) > 1e-11).sum())
    tally.converged += int(done.has_converged.sum())
    smallest = np.linalg.svd(nominal.flange_jacobian(start)[1], compute_uv=False)[:, -1]
    fair = (smallest > _REGULAR) & (done.status != PointStatus.LIMIT)
    tally.regular += int(fair.sum())
    tally.regular_converged += int((fair & done.has_converged).sum())
    tally.missed += _count_missed(real, nominal, start, done, rng)


def _count_missed(
    real: RobotModel, nominal: RobotModel, start: Array, done: Compensation, rng: np.random.Generator
) -> int:
    """Count points given up as unreachable or singular whose pose another start within the branch reaches."""
    given_up = np.isin(done.status, (PointStatus.UNREACHABLE, PointStatus.SINGULAR))
    target_poses = nominal.base_flange(start[given_up])
    branch = np.linalg.det(nominal.flange_jacobian(start[given_up])[1])  # its sign changes with the branch
    found = np.zeros(len(target_poses), dtype=bool)
    for _ in range(_OTHER_STARTS):
        joints = start[given_up] + rng.uniform(-_BRANCH_RAD, _BRANCH_RAD, start[given_up].shape)
        for _ in range(40):
            here, jacobian = real.flange_jacobian(joints)
            turn = log_rotation(target_poses[:, :3, :3] @ np.swapaxes(here[:, :3, :3], 1, 2))
            error = np.concatenate([target_poses[:, :3, 3] - here[:, :3, 3], turn], axis=1)
            damping = (1e-12 + 1e-2 * (error**2).sum(axis=1))[:, None, None] * np.eye(6)
            normal = jacobian @ np.swapaxes(jacobian, 1, 2) + damping
            step = np.swapaxes(jacobian, 1, 2) @ np.linalg.solve(normal, error[:, :, None])
            joints = joints + np.clip(step[:, :, 0], -0.2, 0.2)
        distance, angle = _pose_differences(real, nominal, joints, start[given_up])
        near = (np.abs(joints - start[given_up]) <= _BRANCH_RAD).all(axis=1)
        inside = ((joints >= nominal.lower_rad) & (joints <= nominal.upper_rad)).all(axis=1)
        same = np.linalg.det(real.flange_jacobian(joints)[1]) * branch > 0
        found |= (distance < _NEAR_ENOUGH_M) & (angle < 1e-8) & near & inside & same
    return int(found.sum())


def _pose_differences(
    real: RobotModel, nominal: RobotModel, joints: Array, start: Array
) -> tuple[Array, Array]:
    there, here = nominal.base_flange(start), real.base_flange(joints)
    turn = log_rotation(np.swapaxes(here[:, :3, :3], 1, 2) @ there[:, :3, :3])
    return np.linalg.norm(there[:, :3, 3] - here[:, :3, 3], axis=1), np.linalg.norm(turn, axis=1)
