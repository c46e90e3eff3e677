"""Plans of checks: captures at poses that were not fitted, where a wrong turn of any motor would show."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from cellcal.calibration.arm.kinematics import load_model
from cellcal.calibration.geometry import Array
from cellcal.calibration.mastering.counts import MasteringRecord
from cellcal.calibration.mastering.recovery_walk import NEEDED_POWER, nearby_joints
from cellcal.calibration.mastering.turn_recovery import verification_power
from cellcal.calibration.motion.motion_check import MotionLimits
from cellcal.drivers.interfaces import Joints
from cellcal.procedures.motion.lost_plans import (
    candidate_postures,
    unmeasured_postures,
    unreachable_error,
    walk_planner,
)
from cellcal.procedures.motion.plan_ways import travel_order
from cellcal.procedures.motion.plans import MotionBounds, MotionPlan, timed_plan
from cellcal.procedures.motion.turn_uncertainty import Turns, lost_limits, sure_turns
from cellcal.procedures.motors import MotorState

VERIFICATION_SIGMAS = 6.0
DRAWS = 3  # of poses to choose from: the soonest checks of them are taken
NEARBY_CANDIDATES = 2500  # among few of them none may show a wrong turn, and the robot goes far
LACK_S = 300.0  # of robot time for a wrong turn that would not show at all
_CHOICES_TRIED = 8


@dataclass(frozen=True, slots=True)
class CheckContext:
    """The facts that a recovery has when it plans its checks."""

    here_rad: Joints
    visited: tuple[Joints, ...]
    checked: tuple[Joints, ...]
    offset_covariance: tuple[tuple[float, ...], ...]  # turns^2
    doubt_turns: Turns = ()  # of each motor; none: what the covariance leaves


def plan_checks(
    record: MasteringRecord,
    state: MotorState,
    room: MotionBounds,
    context: CheckContext,
    poses: int,
    sigmas: float = VERIFICATION_SIGMAS,
) -> MotionPlan:
    """Plan check captures at poses not fitted, which together see a wrong turn of every one and two motors.

    ``sigmas`` are the deviations at which a wrong turn shall show; where more are wanted than for whole turns, a
    fraction of a turn is sought, and the captures are judged all together.
    """
    search = _CheckSearch(record, state, room, context, sigmas)
    plans = [plan for seed in range(DRAWS) if (plan := search.plan_best(poses, seed)) is not None]
    if not plans:
        raise unreachable_error(np.array(context.here_rad), search.motion_limits)
    return min(plans, key=search.plan_cost)


@dataclass(frozen=True)
class _CheckSearch:
    """The search for check captures, among one draw of poses after the other."""

    record: MasteringRecord
    state: MotorState
    room: MotionBounds
    context: CheckContext
    sigmas: float

    @cached_property
    def motion_limits(self) -> MotionLimits:
        """The limits that each way keeps."""
        turns = self.context.doubt_turns or sure_turns(self.context.offset_covariance)
        return lost_limits(self.state, self.record, self.room, turns)

    def plan_cost(self, plan: MotionPlan) -> float:
        """Return the time of a plan, and of what it leaves open, which is dearer than any way [s]."""
        visible = self._visible_power(
            np.vstack([self._power_shown, self._turn_power(np.array(plan.poses_rad))])
        )
        return plan.moving_s + LACK_S * float(np.maximum(0.0, NEEDED_POWER - visible).sum())

    def plan_best(self, poses: int, seed: int) -> MotionPlan | None:
        """Return the plan of the best that can be reached of one draw; None where none can."""
        record, state, context, limits = self.record, self.state, self.context, self.motion_limits
        model, here = load_model(record.model), np.array(context.here_rad)
        near = nearby_joints(here, NEARBY_CANDIDATES, seed=seed)
        found = unmeasured_postures(candidate_postures(model, record, limits, near), context.visited)
        power, visible = self._turn_power(found), self._visible_power(self._power_shown)
        planner = walk_planner(model, record, limits, state)
        ordered: list[Array] = []
        for _ in range(_CHOICES_TRIED):  # the best that can be reached, where some of the best cannot
            chosen = planner.quick_checks(here, found, power, visible, poses, together=self._is_summed)
            ordered = travel_order(model, context.here_rad, found[chosen], limits, one_by_one=True)
            if len(ordered) == len(chosen):
                break
            lost = [k for k in chosen if not any(np.array_equal(found[k], pose) for pose in ordered)]
            found, power = np.delete(found, lost, axis=0), np.delete(power, lost, axis=0)
        if not ordered:
            return None
        speed = state.limits.jog_speed_rad_s
        return timed_plan(model, context.here_rad, ordered, limits, speed, one_by_one=True)

    @property
    def _is_summed(self) -> bool:
        return self.sigmas > VERIFICATION_SIGMAS

    @cached_property
    def _power_shown(self) -> Array:
        return self._turn_power(np.array(self.context.checked))

    def _turn_power(self, joints_rad: Array) -> Array:
        """Return what postures (N, n) show of every wrong turn (N, m), 1 being enough."""
        model = load_model(self.record.model)
        postures = joints_rad.reshape(-1, model.axis_count)
        power: Array = verification_power(model, self.record, postures, self.context.offset_covariance)
        return power / self.sigmas

    def _visible_power(self, power: Array) -> Array:
        together: Array = np.sqrt(np.sum(power**2, axis=0))
        return together if self._is_summed else power.max(axis=0, initial=0.0)
