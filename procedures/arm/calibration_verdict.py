"""Claims of a robot's calibration, and what could not be checked."""

import math

from cellcal.calibration.message import make_message
from cellcal.procedures.accuracy_limits import CHECK, limits_in_force, limits_text
from cellcal.procedures.arm.calibration_result import ArmIdentification
from cellcal.procedures.arm.calibration_spec import CalibrationResult, RobotCalibration
from cellcal.procedures.arm.tool_write import UNKNOWN_ORIENTATION, tool_figures
from cellcal.procedures.verdict import (
    Characteristic,
    ProcedureVerdict,
    ValueChange,
    chi_square_rule,
    judge_value,
    known_within,
    state_evidence,
    state_fact,
    state_figure,
)
from cellcal.procedures.write_review import frame_changes


def verdict_on_calibration(spec: RobotCalibration, result: CalibrationResult) -> ProcedureVerdict:
    """Return the verdict: by poses that were not fitted, and by what was asked for."""
    found, out = result.identified, result.identified.hold_out
    limits = limits_in_force(CHECK, spec.accuracy_class, spec.limits)
    direction_text = "along the wire" if spec.method == "wire" else "a coordinate"
    doubt_m = out.after_rms_m / math.sqrt(2.0 * out.degrees_of_freedom)
    return ProcedureVerdict(
        (
            judge_value(
                make_message(
                    "RMS error at poses that were not fitted, {direction_text}", direction_text=direction_text
                ), out.after_rms_m, "m",
                u=doubt_m, limit=limits.check_rms_m, degrees_of_freedom=out.degrees_of_freedom,
            ),
            state_fact(
                "the check poses agree with the stated uncertainty", out.is_as_predicted,
                chi_square_rule("chi square of the errors against what was predicted, 99.9 %"), found=out.chi_square,
                limit=out.most_chi_square,
            ),
            *_goal_figures(spec, found),
            *(() if found.tool is None else tool_figures(found.tool, spec.limits_of_tool())),
            state_figure("largest error at poses that were not fitted", out.after_max_m, "m"),
            state_figure("residual of the fit", found.residual_rms_m, "m", rule="no accuracy"),
            state_figure("first pose, measured again at the end", result.moved_m or 0.0, "m", rule="else refused"),
            *_zero_figures(found),
        ),
        limits_from=limits_text(spec.accuracy_class, spec.limits),
        not_verified=_not_verified(spec, result),
        remarks=(found.saving_text, *((result.why_ended,) if result.why_ended else ()), *_tool_remarks(result)),
        changes=(
            ValueChange("RMS error at check poses", out.before_rms_m, out.after_rms_m, "m"),
            ValueChange("largest error at check poses", out.before_max_m, out.after_max_m, "m"),
            *(() if result.tool is None else frame_changes(result.tool.before, result.tool.read_back)),
        ),
        set_aside=result.set_aside,
        to_sign=("Taught positions were checked after the zeros were written.",) if result.written else (),
    )  # fmt: skip


def _goal_figures(spec: RobotCalibration, found: ArmIdentification) -> tuple[Characteristic, ...]:
    figures = []
    if spec.tip_u_m is not None:
        name = "target over the work, RMS of what the parameters leave open"
        figures.append(known_within(name, "m", u=found.tip_u_m / 2.0, limit=spec.tip_u_m))
    if spec.offset_sigma_rad is not None:
        rule = "upper 95 % limit of the deviation of every joint zero asked for; else measure more"
        largest = max(
            (o.u_rad / 2.0 for o in found.offsets if not spec.offsets_of or o.name in spec.offsets_of),
            default=0.0,
        )
        holds, limit = found.offsets_accepted == "pass", spec.offset_sigma_rad
        figures.append(
            state_evidence(
                "acceptance angular standard deviation", holds, rule, found=largest, limit=limit, unit="rad"
            )
        )
    return tuple(figures)


def _tool_remarks(result: CalibrationResult) -> tuple[str, ...]:
    found, not_written = result.identified.tool, result.tool_not_written
    if found is None:
        return ()
    counts = ", ".join(map(str, found.captures))
    message = make_message("Captures at the points of the end-effector: {counts}", counts=counts)
    return (
        message,
        *(
            (make_message("The tool frame was not written: {not_written}", not_written=not_written),)
            if not_written
            else ()
        ),
    )


def _zero_figures(found: ArmIdentification) -> tuple[Characteristic, ...]:
    known_offsets = (offset for offset in found.offsets if offset.known)
    return tuple(
        state_figure(
            make_message("{o_name}, true minus shown", o_name=o.name), o.value_rad, "rad", u=o.u_rad / 2.0
        )
        for o in known_offsets
    )


def _not_verified(spec: RobotCalibration, result: CalibrationResult) -> tuple[str, ...]:
    hidden = tuple(
        make_message(
            "{parameter} cannot be told{partner}: {cure}",
            parameter=h.parameter,
            partner=make_message(" from {partner}", partner=h.partner) if h.partner else "",
            cure=h.cure,
        )
        for h in result.identified.hidden
    )
    if result.identified.tool is not None and result.identified.tool.placed is None:
        hidden = (UNKNOWN_ORIENTATION, *hidden)
    if spec.method == "wire":
        scale = "lengths of the arm and the scale of the wire are told apart by the wire's certificate only"
        return ("The check poses saw the error along the wire, not across it.", scale, *hidden)
    return ("Where the tracker stands was fitted: base and tool of the robot are not verified.", *hidden)
