"""The questions of a calibration to a person: its plan, its parameters and the zeros that it would write."""

import math

from cellcal.calibration.message import join_messages, make_message
from cellcal.drivers.interfaces import Instruction
from cellcal.procedures.arm.arm_pages import series_moves, tool_ways
from cellcal.procedures.arm.calibration_plan import CalibrationPlan
from cellcal.procedures.arm.calibration_result import ArmIdentification
from cellcal.procedures.arm.calibration_spec import CalibrationResult, RobotCalibration
from cellcal.procedures.arm.tool_write import tool_words
from cellcal.procedures.motion.plan_words import PlanTour, plan_words
from cellcal.procedures.steps.pages import plan_page


def plan_instruction(plan: CalibrationPlan, spec: RobotCalibration) -> Instruction:
    """Return the plan that is to be accepted: what moves, how far, and what comes of it."""
    rules, expected, checks = spec.rules, plan.expected_captures, plan.expected_checks
    what = make_message(
        "the robot, to about {expected} (at most {max_captures}) of {pool_count} poses, chosen a "
        "few at a time, and to {checks} more that verify. Expected then: target known within "
        "{tip_u_mm:.3f} mm over the work (k=2, RMS), {tip_u_max_mm:.3f} mm at worst",
        expected=expected,
        max_captures=rules.max_captures,
        pool_count=len(plan.pool),
        checks=checks,
        tip_u_mm=plan.tip_u_m * 1000.0,
        tip_u_max_mm=plan.tip_u_max_m * 1000.0,
    )
    if plan.shortfall:
        what = make_message("{what}. Beware: {shortfall}", what=what, shortfall=plan.shortfall)
    stops, hands = expected + checks, ""
    if plan.tool is not None:
        points, poses = len(plan.tool.points), len(tool_ways(plan.tool))
        stops += poses
        what = make_message(
            "{what}; and to about {poses} poses with {points} points of the end-effector. Expected: tip within "
            "{tip_u_mm:.3f} mm, axes within {angle_u_deg:.3f} deg",
            what=what,
            poses=poses,
            points=points,
            tip_u_mm=plan.tool.tip_u_m * 1e3,
            angle_u_deg=math.degrees(plan.tool.angle_u_rad),
        )
        hands = make_message("change the target {count} times", count=points + 1)
    tour = PlanTour(stops, plan.expected_motion(), hands)
    instruction = Instruction("accept_plan", plan_words(what, tour, plan.not_checked))
    return plan_page(instruction, tour, series_moves(plan, spec.rules, wired=spec.method == "wire"))


def result_instruction(result: CalibrationResult) -> Instruction:
    """Return the identified parameters that are to be accepted."""
    found, out = result.identified, result.identified.hold_out
    sentences = [
        make_message(
            "At {captures} poses that were not fitted the error fell from {before_rms_mm:.3f} to {after_rms_mm:.3f} "
            "mm RMS a coordinate; the target is known within {tip_u_mm:.3f} mm over the work (k=2, RMS).",
            captures=out.captures,
            before_rms_mm=out.before_rms_m * 1e3,
            after_rms_mm=out.after_rms_m * 1e3,
            tip_u_mm=found.tip_u_m * 1e3,
        ),
        make_message("{saving_text}.", saving_text=found.saving_text),
    ]
    if not result.goal_reached:
        sentences.append(make_message("The goal was not reached: {why}.", why=result.why_ended))
    if found.tool:
        sentences.append(tool_words(found.tool))
    return Instruction("accept_parameters", join_messages(" ", sentences))


def zeros_instruction(found: ArmIdentification) -> Instruction:
    """Return the joint zeros that are to be accepted before they are written."""
    turned = ", ".join(f"J{k + 1} {math.degrees(v):+.4f}" for k, v in enumerate(found.written_offsets_rad))
    return Instruction(
        "accept_zeros",
        make_message("Joint zeros alone explain the readings: {turned} deg.", turned=turned),
    )
