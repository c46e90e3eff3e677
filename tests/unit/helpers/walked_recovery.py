"""A recovery as the procedure walks it, on the simulated arm: its poses, repeats and checks, without the travel."""

from dataclasses import dataclass, replace
from functools import cache

import numpy as np

from cellcal.calibration.mastering.recovery_walk import WalkPlanner, nearby_joints
from cellcal.calibration.mastering.turn_recovery import TurnRecovery, verification_power, verify_recovery
from cellcal.calibration.motion.motion_check import allowed_postures
from cellcal.procedures.motion import check_plans, lost_plans
from tests.unit.helpers.recovery_cases import (
    DRIVE,
    LIMITS,
    MODEL,
    PRIOR,
    SimulatedLoss,
    healthy_record,
    lose_turns,
    record_poses,
)
from tests.unit.helpers.wire_world import WireWorld

FIRST, MOST, CHECKS, MOST_CHECKS = 12, 30, 4, 8  # as a MasteringRecoverySpec has them
STARTS = 8
COUPLING_ERROR = 1e-3
OUTLIER_M = 0.008


@dataclass(frozen=True, slots=True)
class WalkedRecovery:
    """How a walked recovery ended, and what it took."""

    loss: SimulatedLoss
    recovery: TurnRecovery
    captures: int
    again: int

    def is_exact(self) -> bool:
        """Whether every motor got back the whole turns that it lost."""
        return np.array_equal(self.recovery.offset_turns, self.loss.true_turns)

    def is_wrong(self) -> bool:
        """Whether something false was accepted: turns that are not the true ones, or an offset far outside its U.

        An exchanged motor within the stated blind zone of a whole turn is the proviso of every whole turn.
        """
        if not self.recovery.accepted:
            return False
        off = np.array(self.recovery.offset_turns) - self.loss.true_turns
        blind = np.array(self.recovery.blind_turns or (0.0,) * 6)
        allowed = np.abs(np.array(self.recovery.offset_u_rad)) * 2.0
        in_rad = np.abs(self.loss.joint_error_rad(self.recovery))
        return bool(((np.abs(off) > blind) & (in_rad > allowed) & (np.abs(off) > 1e-9)).any())


def walk_planner(record):
    """Return the planner of walks in the test's cell."""
    return WalkPlanner(
        MODEL, record, lambda joints: allowed_postures(MODEL, joints, LIMITS, PRIOR.hook_in_flange_m)
    )


@cache
def first_walk(number):
    """Return the first captures from one of a few places where a robot may have stood."""
    return walk_planner(healthy_record(WireWorld(number))).plan_walk(record_poses()[number], FIRST, seed=0)


def loss_of(seed, *, outlier=False, shrunk=1.0, **more):
    """Lose the turns of a robot with backlash, sag and coupling errors, and walk the first captures."""
    at = first_walk(seed % STARTS)
    at = at[:1] + shrunk * (at - at[:1])
    loss = lose_turns(seed, poses=at, either_flank=seed % 3 == 0, coupling_error=COUPLING_ERROR, **more)
    if outlier:
        k = seed % FIRST
        loss.captures[k] = replace(loss.captures[k], length_m=loss.captures[k].length_m + OUTLIER_M)
    return loss, at


def recover_walking(loss, at, *, most=MOST):
    """Judge, measure again what does not fit, measure further, look at check poses: as the procedure does."""
    found, poses, again, changed = loss.recover_turns(), [*at], 0, False
    while len(poses) + again < most:
        if found.suspect_capture is not None:
            k = found.suspect_capture
            loss.captures[k] = loss.capture_poses(poses[k][None])[0]
            again += 1
        elif not found.accepted or _doubtful_axes(found):
            here = poses[-1]
            candidates = _candidate_poses(here)
            efold = 200.0 if not found.accepted and len(poses) < 16 else 800.0
            worth, gain = walk_planner(loss.record).rate_candidates(
                here, np.array(poses), candidates, efold_s=efold
            )
            best = int(np.argmax(worth))
            if found.accepted and gain[best] < 0.15:
                break
            poses.append(candidates[best])
            loss.captures += loss.capture_poses(poses[-1][None])
        else:
            break
        changed, found = found.mode == "geometry", loss.recover_turns()
        if changed and found.mode == "geometry":  # two judgements in a row, the second with one capture more
            break
    return WalkedRecovery(loss, _check_poses(loss, found, poses), len(poses), again)


def _doubtful_axes(found):
    return max(found.offset_u_rad) > 8.7e-4 or found.doubt_sigmas > 2.0


def _candidate_poses(here, count=lost_plans.NEARBY_CANDIDATES):
    near = nearby_joints(here, count, seed=3)
    near = near[allowed_postures(MODEL, near, LIMITS, PRIOR.hook_in_flange_m)]
    return np.vstack([near, record_poses()])


def _check_poses(loss, found, poses):
    if not found.accepted:
        return found
    poses, back = _corrected_poses(loss, found, poses)
    candidates = _candidate_poses(poses[-1], check_plans.NEARBY_CANDIDATES)
    apart = np.abs(candidates[:, None] - np.array(poses)[None]).max(axis=2).min(axis=1)
    candidates = candidates[apart > 0.02]
    power = verification_power(MODEL, loss.record, candidates, found.offset_covariance) / 6.0
    shown, checks, here, count = np.zeros(power.shape[1]), [], poses[-1], CHECKS
    while True:  # checks that are added look for what the earlier ones could not show
        chosen = walk_planner(loss.record).quick_checks(here, candidates, power, shown, count)
        checks += loss.capture_poses(candidates[chosen] - back)
        shown, here, count = np.maximum(shown, power[chosen].max(axis=0)), candidates[chosen[-1]], 2
        verified = verify_recovery(MODEL, loss.record, found, checks)
        failed = {check.name for check in verified.gate if not check.passed}
        if failed != {"verification power"} or len(checks) >= MOST_CHECKS:
            return verified
        candidates, power = np.delete(candidates, chosen, axis=0), np.delete(power, chosen, axis=0)


def _corrected_poses(loss, found, poses):
    """Return the poses by the recovered zero, and how far they were off: checks are gone to by that zero."""
    back = DRIVE.radians_per_turn() @ (np.array(found.offset_turns) - loss.provisional)
    return [*(np.array(poses) + back)], back
