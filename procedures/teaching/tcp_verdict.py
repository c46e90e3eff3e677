"""Claims about a taught tool frame: tip and axes with their uncertainty, and what was not checked."""

import math
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from cellcal.calibration.geometry import Array, Pose
from cellcal.calibration.message import make_message
from cellcal.calibration.points.tool_point import ToolAxes, ToolPoint
from cellcal.calibration.uncertainty import coverage_in_space, effective_degrees_of_freedom
from cellcal.procedures.accuracy_limits import TOOL, AccuracyClass, ToolLimits, limits_in_force, limits_text
from cellcal.procedures.teaching.tcp_methods import TeachingMethod
from cellcal.procedures.verdict import (
    PASS,
    UNDECIDED,
    Characteristic,
    Contribution,
    ProcedureVerdict,
    SetAside,
    state_evidence,
    state_fact,
)
from cellcal.procedures.write_review import frame_changes


class TaughtTool(Protocol):
    """A tool frame as found and written."""

    @property
    def tool_number(self) -> int: ...
    @property
    def tip(self) -> ToolPoint: ...
    @property
    def axes(self) -> ToolAxes | None: ...
    @property
    def touches(self) -> int: ...
    @property
    def fixed_plan_touches(self) -> int | None: ...
    @property
    def set_aside(self) -> tuple[SetAside, ...]: ...
    @property
    def before(self) -> Pose: ...
    @property
    def read_back(self) -> Pose: ...


@dataclass(frozen=True, slots=True)
class TcpCriteria:
    """The method of teaching the tool, and the criteria by which it is judged."""

    way: TeachingMethod
    square_sigma_rad: float
    arm_sigma_m: float
    accuracy_class: AccuracyClass
    limits: ToolLimits | None


def verdict_on_tool(judging: TcpCriteria, found: TaughtTool) -> ProcedureVerdict:
    """Return the verdict on a taught tool frame."""
    limits = limits_in_force(TOOL, judging.accuracy_class, judging.limits)
    tip = found.tip
    return ProcedureVerdict(
        (
            _tip_figure(tip, judging.arm_sigma_m, limits.tip_m),
            *(
                ()
                if found.axes is None
                else (_axes_figure(judging, found.axes, tip, limits.orientation_rad),)
            ),
            state_fact(
                "largest distance of a touch from the pin",
                tip.max_m <= limits.residual_m,
                "PASS if at most L; a residual is no accuracy",
                found=tip.max_m,
                limit=limits.residual_m,
                unit="m",
            ),
            *_leave_one_out_figures(tip, limits.residual_m),
            *_handedness_figures(judging.way),
        ),
        limits_from=limits_text(judging.accuracy_class, judging.limits),
        not_verified=_not_verified(judging.way),
        remarks=(_saving_text(found),),
        changes=frame_changes(found.before, found.read_back),
        set_aside=found.set_aside,
    )


def axes_u(way: TeachingMethod, sigma_m: float, square_sigma_rad: float) -> float:
    """Return U (95 %) of the axes' turn that poses of this quality would give [rad]."""
    ways = {0: (0.0, 0.0, 0.0), 2: (2.0, 1.0, 2.0)}  # two moves leave each other's axis to one of them
    shares = ways.get(len(way.move_axes), (1.0, 1.0, 1.0))
    variances = [share * (sigma_m / way.min_move_m) ** 2 + square_sigma_rad**2 for share in shares]
    return coverage_in_space(variances) * math.sqrt(sum(variances)) if sum(variances) else 0.0


def arm_u(arm_sigma_m: float) -> float:
    """Return the part of a tip's U (95 %, in space) that the arm's own errors have, whatever is touched [m]."""
    return coverage_in_space((1.0, 1.0, 1.0)) * math.sqrt(3.0) * arm_sigma_m


def _tip_figure(tip: ToolPoint, arm_sigma_m: float, limit: float) -> Characteristic:
    u, by_arm, k = (
        tip.tip_u_in_space_m / tip.coverage_in_space,
        math.sqrt(3.0) * arm_sigma_m,
        tip.coverage_in_space,
    )
    rule = make_message(
        "PASS if U (k = {coverage:.2f}, 95 %, in space) <= L, else UNDECIDED: measure more", coverage=k
    )
    if arm_u(arm_sigma_m) >= limit:
        rule = make_message(
            "PASS if U (k = {k:.2f}, 95 %, in space) <= L, else UNDECIDED: the arm's own errors "
            "alone (arm_sigma_m) leave {arm_u:.2f} mm, and no touch lessens them",
            k=k,
            arm_u=arm_u(arm_sigma_m) * 1000.0,
        )
    word = PASS if tip.tip_u_in_space_m <= limit else UNDECIDED
    figure = Characteristic(
        "position of the tool's tip", tip.tip_u_in_space_m, "m", u, tip.coverage_in_space, limit, word, rule
    )
    by_touches = math.sqrt(max(u**2 - by_arm**2, 0.0))
    return figure.with_budget(
        Contribution("scatter of the touches, through the fit", by_touches, "measured"),
        Contribution("the arm's own errors, arm_sigma_m", by_arm, "estimated"),
    )


def _axes_figure(judging: TcpCriteria, axes: ToolAxes, tip: ToolPoint, limit: float) -> Characteristic:
    """Judge the turn of the axes: scatter over the moves, their angles, how squarely the tool was held."""
    freedom = float(tip.degrees_of_freedom)
    touch_m2 = tip.rms_m**2 * (freedom + 6.0) / freedom  # the scatter, freed of the fitted unknowns
    by_touch: Array = np.array(axes.turn_gain_per_m2) * touch_m2
    by_square, by_hand = axes.squareness_rad / 2.0, judging.square_sigma_rad
    covariance = by_touch + (by_square**2 / 3.0 + by_hand**2) * np.eye(3)
    measured, estimated = math.sqrt(float(np.trace(by_touch))), math.sqrt(3.0) * by_hand
    dof = effective_degrees_of_freedom([(measured, freedom), (by_square, math.inf), (estimated, math.inf)])
    u = math.sqrt(float(np.trace(covariance)))
    k = coverage_in_space(np.linalg.eigvalsh(covariance).clip(0.0).tolist(), dof) if u else 2.0
    rule = make_message(
        "PASS if U (k = {k:.2f}, 95 %, about any axis) <= L, else UNDECIDED: measure more", k=k
    )
    word = PASS if k * u <= limit else UNDECIDED
    figure = Characteristic("turn of the tool's axes", k * u, "rad", u, k, limit, word, rule)
    return figure.with_budget(
        Contribution("scatter of the touches over the moves", measured, "measured"),
        Contribution("moves not at right angles", by_square, "measured"),
        Contribution("how squarely the tool was held, square_sigma_rad", estimated, "estimated"),
    )


def _leave_one_out_figures(tip: ToolPoint, limit: float) -> tuple[Characteristic, ...]:
    if tip.leave_one_out_max_m is None:
        return ()
    worst = int(np.argmax(tip.leave_one_out_m)) + 1
    rule = make_message(
        "a touch as the others foretell it, worst touch {worst}: PASS if at most 2 L, else UNDECIDED",
        worst=worst,
    )
    return (
        state_evidence(
            "largest distance of a touch from where the others have it",
            tip.leave_one_out_max_m <= 2.0 * limit,
            rule,
            found=tip.leave_one_out_max_m,
            limit=2.0 * limit,
            unit="m",
        ),
    )


def _handedness_figures(way: TeachingMethod) -> tuple[Characteristic, ...]:
    if len(way.move_axes) < 3:
        return ()
    return (
        state_fact(
            "handedness: the three moves form a right-handed frame", True, "refused where they do not"
        ),
    )


def _not_verified(way: TeachingMethod) -> tuple[str, ...]:
    unseen = "The tip was not checked in an attitude that was not fitted."
    forms = (
        "The forms of pin and tip count only as they scatter, the arm's own errors as stated (arm_sigma_m): "
        "touches on one pin do not show them."
    )
    if way.method == "four_point":
        return unseen, forms, "The axes were not taught: they stay as the controller held them."
    if way.is_by_attitude:
        return (
            unseen,
            forms,
            "How squarely the tool was held is as stated (square_sigma_rad): nothing shows it.",
        )
    if len(way.move_axes) < 3:
        return unseen, forms, "A move in the wrong direction leaves no trace: no third move was taught."
    return unseen, forms, "Two moves both taken in the wrong direction leave no trace."


def _saving_text(found: TaughtTool) -> str:
    fixed = found.fixed_plan_touches
    plan = "more than 60" if fixed is None else str(fixed)
    return make_message(
        "{touches} touches, each where it tells most; a plan fixed beforehand at 30 degrees "
        "would take {plan} for the U of the limits",
        touches=found.touches,
        plan=plan,
    )
