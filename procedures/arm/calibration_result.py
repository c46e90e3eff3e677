"""What a robot calibration found, and how it stands at poses that were never fitted."""

import math
from dataclasses import dataclass, replace

import numpy as np

from cellcal.calibration.arm.kinematics import load_model
from cellcal.calibration.geometry import Array
from cellcal.calibration.identification.estimator import ArmFit
from cellcal.calibration.identification.identifiability import not_identified
from cellcal.calibration.identification.offset_acceptance import accept_offsets
from cellcal.calibration.identification.parameters import OFFSETS
from cellcal.calibration.identification.tip_uncertainty import offset_slopes
from cellcal.calibration.mastering.counts import DriveTrain
from cellcal.calibration.message import make_message
from cellcal.calibration.poses.arm_fit import (
    ArmTask,
    errors_at,
    fit_placement,
    found_correlations,
    found_parameters,
    predict_from_fit,
    predicted_sigma,
    reading_sigma,
    target_expanded_u,
)
from cellcal.calibration.poses.calibrated_arm import CalibratedArm
from cellcal.drivers.interfaces import Counts
from cellcal.procedures.arm.arm_bench import ArmCapture, joints_of, observations_of, of_target, values_of
from cellcal.procedures.arm.calibration_plan import CalibrationSeries, fit_captures, fixed_plan_captures
from cellcal.procedures.arm.predicted_errors import PredictedErrors
from cellcal.procedures.arm.tool_result import FoundTool, find_tool

OFFSETS_EXPLAIN = (
    1.15  # of the whole model's RMS at the check poses: above, zeros alone are not the whole story
)


@dataclass(frozen=True, slots=True)
class JointOffset:
    """One joint's zero as a table of four numbers a joint has it: true minus shown, U with k = 2."""

    name: str
    value_rad: float
    u_rad: float
    known: bool  # false: the readings say no more than was expected beforehand


@dataclass(frozen=True, slots=True)
class HiddenParameter:
    """A parameter that these readings cannot determine."""

    parameter: str
    partner: str
    cure: str


@dataclass(frozen=True, slots=True)
class HoldOutErrors(PredictedErrors):
    """Errors of readings at poses that took no part in the fit, a coordinate [m]."""

    captures: int
    before_rms_m: float  # the nominal arm; device and target placed by the same readings as after
    before_max_m: float
    after_rms_m: float
    after_max_m: float
    offsets_only_rms_m: float  # with joint zeros as the only errors
    chi_square: float  # of the errors after, against what was predicted
    degrees_of_freedom: int

    @property
    def is_explained_by_offsets(self) -> bool:
        """Whether joint zeros alone predict the check poses as well as the whole model."""
        return self.offsets_only_rms_m <= OFFSETS_EXPLAIN * self.after_rms_m


@dataclass(frozen=True, slots=True)
class ArmIdentification:
    """The arm as found, with all that may be believed of it."""

    arm: CalibratedArm
    offsets: tuple[JointOffset, ...]
    offsets_accepted: (
        str  # pass | fail | undecided against the acceptance angular standard deviation; "" if not asked
    )
    hidden: tuple[HiddenParameter, ...]
    tip_u_m: float  # k = 2, over the work: RMS …
    tip_u_max_m: float  # … and at the worst posture
    residual_rms_m: float
    rejected: tuple[int, ...]  # captures, from 0
    hold_out: HoldOutErrors
    captures: int
    fixed_plan_captures: int | None  # evenly drawn poses for the same U; None: more than were drawn
    mastering: Counts  # counts at zero that would take the joint zeros away; empty if that cannot be said
    written_offsets_rad: tuple[float, ...]  # joint by joint, what those counts change
    tool: FoundTool | None = None  # where points of the end-effector were measured, too

    @property
    def saving_text(self) -> str:
        """The effort that choosing the poses saved, in words."""
        if self.fixed_plan_captures is None:
            return make_message(
                "{captures} captures; evenly drawn poses do not reach this U at all", captures=self.captures
            )
        share = 1.0 - self.captures / self.fixed_plan_captures
        return make_message(
            "{captures} captures; a fixed plan of evenly drawn poses needs {fixed_plan_captures} for "
            "the same U: {share_percent:.0f} % saved",
            captures=self.captures,
            fixed_plan_captures=self.fixed_plan_captures,
            share_percent=share * 100,
        )


def identify_arm(
    series: CalibrationSeries, captures: tuple[ArmCapture, ...], checks: tuple[ArmCapture, ...]
) -> ArmIdentification:
    """Fit the arm to the captures, and see what that is worth at the check poses."""
    task, plan = series.make_task(), series.plan
    robust = fit_captures(task, captures)
    u_m, u_max_m = target_expanded_u(predict_from_fit(task, robust), series.test_poses())
    state, goal = robust.fit.state, plan.goal
    kept_errors = np.delete(errors_at(state, observations_of(task, captures)), robust.rejected, axis=1)
    accepted = ""
    if goal.offset_sigma_rad is not None:
        accepted = accept_offsets(robust, goal.offset_sigma_rad, goal.offsets_of).verdict.value
    zero, turned = _corrected_mastering(series, captures)
    x, y, z = (float(v) for v in state.flange_tool[:3, 3])
    arm = CalibratedArm(
        robot_serial=series.bench.serial,
        model=series.bench.model,
        counts_at_zero=series.bench.counts_at_zero,
        device=series.bench.method,
        parameters=found_parameters(robust.fit),
        target_in_flange_m=(x, y, z),
        fitted_joints_rad=tuple(capture.joints_rad for capture in captures),
        correlations=found_correlations(robust.fit),
    )
    return ArmIdentification(
        arm=arm,
        offsets=_joint_offsets(robust.fit),
        offsets_accepted=accepted,
        hidden=tuple(HiddenParameter(h.parameter, h.partner, h.cure) for h in not_identified(robust.fit)),
        tip_u_m=u_m,
        tip_u_max_m=u_max_m,
        residual_rms_m=_rms_of(kept_errors),
        rejected=tuple(int(k) for k in robust.rejected),
        hold_out=_hold_out(task, captures, of_target(checks, 0)),
        captures=len(of_target(captures, 0)),
        fixed_plan_captures=fixed_plan_captures(series, captures, u_m),
        mastering=zero,
        written_offsets_rad=turned,
        tool=None
        if goal.tool is None
        else find_tool(task, goal.tool, robust, captures, tuple(c for c in checks if c.target)),
    )


def arm_after_mastering(
    arm: CalibratedArm, written_rad: tuple[float, ...], counts_at_zero: Counts
) -> CalibratedArm:
    """Return the parameters as they are once some of the zeros were written into the robot."""
    coupled = load_model(arm.model).joint_coupling @ np.array(written_rad)
    taken = {f"J{k + 1} offset": float(angle) for k, angle in enumerate(coupled)}
    moved = tuple(replace(p, value=p.value - taken.get(p.name, 0.0)) for p in arm.parameters)
    return replace(arm, parameters=moved, counts_at_zero=counts_at_zero)


def errors_after(
    series: CalibrationSeries,
    captures: tuple[ArmCapture, ...],
    written_rad: tuple[float, ...],
    finals: tuple[ArmCapture, ...],
) -> float:
    """Return the RMS error [m] of readings after the zeros were written, against what the fit says of them."""
    task, joints = series.make_task(), joints_of(finals, len(written_rad))
    as_before = task.to_observations(joints - np.array(written_rad), values_of(finals))
    return _rms_of(errors_at(fit_captures(task, captures).fit.state, as_before))


def _hold_out(
    task: ArmTask, captures: tuple[ArmCapture, ...], checks: tuple[ArmCapture, ...]
) -> HoldOutErrors:
    check_rows, robust = observations_of(task, checks), fit_captures(task, captures)
    nominal = fit_placement(task, observations_of(task, captures), {}).state
    before, after = errors_at(nominal, check_rows), errors_at(robust.fit.state, check_rows)
    zeros = errors_at(fit_captures(task, captures, OFFSETS).fit.state, check_rows)
    sigma = np.hypot(predicted_sigma(robust.fit, task, check_rows.joints_rad), reading_sigma(task, robust))
    return HoldOutErrors(
        captures=len(checks),
        before_rms_m=_rms_of(before),
        before_max_m=float(np.linalg.norm(before, axis=0).max()),
        after_rms_m=_rms_of(after),
        after_max_m=float(np.linalg.norm(after, axis=0).max()),
        offsets_only_rms_m=_rms_of(zeros),
        chi_square=float(((after / sigma) ** 2).sum()),
        degrees_of_freedom=int(after.size),
    )


def _joint_offsets(fit: ArmFit) -> tuple[JointOffset, ...]:
    parameters = {p.name: p for p in found_parameters(fit)}
    found = []
    for name, slope in offset_slopes(fit).items():
        sigma = math.sqrt(max(float(slope @ fit.covariance @ slope), 0.0))
        is_known = sigma < 0.5 * parameters[name].prior
        found.append(JointOffset(name, parameters[name].value, 2.0 * sigma, is_known))
    return tuple(found)


def _corrected_mastering(
    series: CalibrationSeries, captures: tuple[ArmCapture, ...]
) -> tuple[Counts, tuple[float, ...]]:
    """Return counts at zero without the joint zeros that are known, and by how much that turns each joint."""
    drive, zero = series.bench.drive, series.bench.counts_at_zero
    if drive is None or not zero:
        return (), ()
    fit = fit_captures(series.make_task(), captures, OFFSETS).fit
    known_offsets = {p.name: p.value for p in found_parameters(fit) if p.role == "offset" and p.is_determined}
    model = load_model(series.bench.model)
    coupled = np.array([known_offsets.get(f"J{k + 1} offset", 0.0) for k in range(model.axis_count)])
    return _written_counts(drive, zero, np.linalg.solve(model.joint_coupling, coupled))


def _written_counts(drive: DriveTrain, zero: Counts, turned_rad: Array) -> tuple[Counts, tuple[float, ...]]:
    per_count = np.array(drive.radians_per_count)
    change = np.rint(np.linalg.solve(per_count, turned_rad))
    counts = tuple(int(before - by) for before, by in zip(zero, change, strict=True))
    return counts, tuple(float(angle) for angle in per_count @ change)


def _rms_of(errors_m: Array) -> float:
    return float(np.sqrt(np.mean(errors_m**2)))
