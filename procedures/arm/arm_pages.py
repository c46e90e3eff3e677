"""What a screen draws of procedures on a whole arm: their plans, and what new joint zeros change."""

from cellcal.calibration.message import make_message
from cellcal.drivers.interfaces import Joints
from cellcal.procedures.accuracy_limits import TOOL
from cellcal.procedures.arm.arm_bench import Bench
from cellcal.procedures.arm.calibration_plan import CalibrationPlan
from cellcal.procedures.arm.calibration_result import ArmIdentification
from cellcal.procedures.arm.series_rules import SeriesRules
from cellcal.procedures.arm.tool_plan import ToolPlan
from cellcal.procedures.forecast import Prediction
from cellcal.procedures.steps.pages import ARM_CHECKS, WIRE_CHECKS, PlannedMoves, joint_displacement
from cellcal.procedures.verdict import ValueChange

_POSTURES = 40  # of those that stand for the whole work


def series_moves(plan: CalibrationPlan, rules: SeriesRules, *, wired: bool) -> PlannedMoves:
    """Return a calibration's plan as it is shown: the poses that are expected to tell most, and those that verify."""
    points = 0 if plan.tool is None else len(plan.tool.points) * (rules.point_max + rules.point_checks)
    return PlannedMoves(
        ways_rad=(*plan.foreseen_rad, *(way for _, way in tool_ways(plan.tool))),
        speed_rad_s=plan.expected_motion().fastest_rad_s,
        checked=WIRE_CHECKS if wired else ARM_CHECKS,
        not_checked=(*plan.not_checked, plan.shortfall),
        most=rules.max_captures + rules.checks_for(rules.max_captures) + points,
        predictions=(
            Prediction("target over the work, RMS", plan.tip_u_m, "m"),
            Prediction("target over the work, at worst", plan.tip_u_max_m, "m"),
            *tool_predictions(plan.tool),
        ),
        names=(
            *(str(k) for k in range(1, plan.expected_captures + 1)),
            *(f"C{k}" for k in range(1, plan.expected_checks + 1)),
            *(name for name, _ in tool_ways(plan.tool)),
        ),
        planned=planned_steps(plan, rules),
    )


def planned_steps(plan: CalibrationPlan, rules: SeriesRules) -> dict[str, int]:
    """Return how often each phase of a series is expected, by the plan."""
    counts = series_steps(rules, plan.expected_captures, plan.expected_checks)
    if plan.tool is not None:
        points = sum(plan.tool.captures)
        counts |= {"choose a point pose": points, "go to point pose": points, "capture point": points}
    return counts


def series_steps(rules: SeriesRules, captures: int, checks: int) -> dict[str, int]:
    """Return how often each phase of a series comes with so many captures and checks."""
    looks = 1 + max(0, captures - rules.first) + 1
    poses = {"choose poses": looks, "go to pose": captures, "capture": captures}
    return poses | {"go to check": checks, "capture check": checks}


def tool_ways(plan: ToolPlan | None) -> tuple[tuple[str, tuple[Joints, ...]], ...]:
    """Return the names of the poses of the end-effector's points with the ways to them, as they are expected."""
    points = () if plan is None else plan.points
    return tuple(
        (f"{k}.{number}", way)
        for k, point in enumerate(points, 1)
        for number, way in enumerate(point.foreseen_rad[:-1], 1)
    )


def tool_predictions(plan: ToolPlan | None) -> tuple[Prediction, ...]:
    """Return how well the tool frame is expected to be known."""
    if plan is None:
        return ()
    tip = Prediction("tip", plan.tip_u_m, "m", {name: limits.tip_m for name, limits in TOOL.items()})
    if len(plan.points) == 1:
        return (tip,)
    limits = {name: limits.orientation_rad for name, limits in TOOL.items()}
    return (tip, Prediction("axes", plan.angle_u_rad, "rad", limits))


def zero_changes(bench: Bench, found: ArmIdentification) -> tuple[ValueChange, ...]:
    """Return each joint's counts at zero before and after, and by how much its zero turns."""
    names = bench.nominal_model().joint_names
    counts = zip(names, bench.counts_at_zero, found.mastering, strict=True)
    turned = zip(names, found.written_offsets_rad, strict=True)
    return (
        *(
            ValueChange(make_message("{name}: counts at zero", name=name), float(old), float(new), "count")
            for name, old, new in counts
        ),
        *(
            ValueChange(make_message("{name}: zero turns by", name=name), 0.0, angle, "rad")
            for name, angle in turned
        ),
    )


def zero_displacement(
    bench: Bench, plan: CalibrationPlan, found: ArmIdentification
) -> dict[str, float | str]:
    """Return by how much the target is displaced at most by new zeros, over postures of the work."""
    postures = plan.tests[:_POSTURES] or (bench.joints_rad,)
    return joint_displacement(
        bench.nominal_model(), postures, found.written_offsets_rad, bench.target_in_flange_m
    )
