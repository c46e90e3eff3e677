"""``cellcal poses``: which poses to measure, and how good the result will be, before anything is measured."""

import os
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from cyclopts import Parameter
from rich.markup import escape

from cellcal.service.cli.display_units import DEGREES_PER_RADIAN, DISPLAY_UNITS
from cellcal.service.cli.idle_options import OptionRule, refuse_idle_options
from cellcal.service.cli.model_argument import ModelArgument

if TYPE_CHECKING:
    from rich.console import Console

    from cellcal.calibration.poses.enough_poses import AcceptanceLimits
    from cellcal.calibration.poses.measurement_poses import DesignCriterion
    from cellcal.service.engineering.identification.pose_planning import PlanReport, PlanRequest

_MOST_SHOWN = 40
_UNKNOWN_M = 1.0
_RULES = (
    OptionRule(("sigma_deg",), only_for=("kind", ("pose",))),
    OptionRule(("anchor_mm", "wire_range_mm"), only_for=("kind", ("length",))),
    OptionRule(("offsets",), needs=("accept_offset_deg",)),
    OptionRule(("tip_link", "mesh_folder"), needs=("description",)),
)


def poses(  # noqa: PLR0913  # a command's options are its arguments
    *,
    robot: ModelArgument,
    sigma_mm: float,
    kind: str = "point",
    sigma_deg: float = 0.01,
    tool_mm: tuple[float, float, float] = (0.0, 0.0, 0.0),
    anchor_mm: tuple[float, float, float] = (0.0, 0.0, 0.0),
    wire_range_mm: float | None = None,
    count: int = 30,
    accept_tip_mm: float | None = None,
    accept_worst_tip_mm: float | None = None,
    accept_offset_deg: float | None = None,
    offsets: tuple[str, ...] = (),
    criterion: str | None = None,
    level: int = 2,
    drop_redundant: bool = False,
    candidates: int = 1000,
    seed: int = 1,
    after: Path | None = None,
    tests: Path | None = None,
    shape: Path | None = None,
    description: Path | None = None,
    tip_link: str = "flange",
    mesh_folder: tuple[str, ...] = (),
    out: Annotated[Path | None, Parameter(name="--csv")] = None,
    as_json: Annotated[bool, Parameter(name="--json")] = False,
) -> int:
    """Plan measurement poses, and predict parameter and tool point uncertainty before measuring.

    Parameters
    ----------
    robot
        Nominal model: a name of `cellcal models`, a model file (arm.toml), or 'arm.urdf?base=LINK&tip=LINK'.
    sigma_mm
        Standard deviation of one coordinate, or of one length.
    kind
        point (tracker on a target), pose (position and attitude), or length (draw-wire).
    sigma_deg
        Standard deviation of a measured attitude; poses only.
    tool_mm
        Place of target or hook in the flange.
    anchor_mm
        Place of the wire's anchor in the base.
    wire_range_mm
        Measuring range of the wire.
    count
        How many poses; with an acceptance, at most so many.
    accept_tip_mm
        Acceptance: standard deviation of the tool point's distance, rms over the test poses.
    accept_worst_tip_mm
        The same at the worst test pose.
    accept_offset_deg
        Acceptance: standard deviation of every joint offset.
    offsets
        Only these offsets are accepted or not, such as "J2 offset".
    criterion
        determinant, offsets, or test-poses. Chosen by the acceptance if not given.
    level
        What is unknown: 1 mastering offsets, 2 geometry, 3 and sag.
    drop_redundant
        Leave out parameters that others can imitate; otherwise their priors widen those others.
    candidates
        How many reachable, collision-free postures to choose from.
    seed
        Of the candidates.
    after
        Measurements that exist already: plan what to measure next.
    tests
        CSV with columns q1_deg, q2_deg …: where the robot works.
    shape
        TOML with obstacles and shapes of links.
    description
        URDF whose collision shapes are kept clear of obstacles and of each other, too (needs the extra planning).
    tip_link
        The link of the description that is the flange.
    mesh_folder
        Where package:// of the description starts.
    out
        Write the poses as CSV, in an order with short ways.
    as_json
        Print one JSON object on standard output.
    """
    refuse_idle_options(poses, locals(), _RULES)
    # Before numpy is imported: on matrices of this size a second BLAS thread only waits for the first.
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    from cellcal.calibration.poses.measurement_prediction import DesignInstrument
    from cellcal.service.cli.printing import STDERR_CONSOLE, print_json
    from cellcal.service.engineering.identification.pose_planning import (
        PlanRequest,
        RobotDescription,
        write_plan,
    )
    from cellcal.service.exit_codes import ExitCode
    from cellcal.service.files import refuse_existing

    if out is not None:
        refuse_existing(out)
    acceptance = _build_acceptance(accept_tip_mm, accept_worst_tip_mm, accept_offset_deg, offsets)
    instrument = DesignInstrument(kind, sigma_mm / 1e3, sigma_deg / DEGREES_PER_RADIAN, _to_metres(anchor_mm))
    report = _plan_and_show(
        PlanRequest(
            robot=robot,
            instrument=instrument,
            tool_in_flange_m=_to_metres(tool_mm),
            wire_range_m=None if wire_range_mm is None else wire_range_mm / 1e3,
            poses=count,
            acceptance=acceptance,
            criterion=_parse_criterion(criterion),
            level=level,
            drop_redundant=drop_redundant,
            candidates=candidates,
            seed=seed,
            after=after,
            tests=tests,
            shape=shape,
            description=None if description is None else RobotDescription(description, tip_link, mesh_folder),
        )
    )
    if as_json:
        print_json(report.as_document())
    else:
        _print_report(report)
    if report.plan is None:
        return ExitCode.OUT_OF_TOLERANCE
    if out is not None:
        write_plan(out, report)
        STDERR_CONSOLE.print(f"wrote {out}", markup=False, soft_wrap=True)
    return ExitCode.PASS


def _plan_and_show(request: "PlanRequest") -> "PlanReport":
    """Plan poses, and show what is being done; all processors identify what was measured already."""
    from cellcal.service.cli.identify_display import work_display
    from cellcal.service.engineering.identification.forked_parts import DisplayedRunner, share_parts
    from cellcal.service.engineering.identification.pose_planning import plan_poses

    with work_display("looking at the robot") as display:
        if request.after is None:
            return plan_poses(request, DisplayedRunner(display))
        with share_parts(display) as runner:
            return plan_poses(request, runner)


def _to_metres(millimetres: tuple[float, float, float]) -> tuple[float, float, float]:
    x, y, z = millimetres
    return x / 1e3, y / 1e3, z / 1e3


def _parse_criterion(word: str | None) -> "DesignCriterion | None":
    from cellcal.calibration.poses.measurement_poses import DesignCriterion
    from cellcal.service.engineering.identification.pose_planning import PlanError

    if word is None:
        return None
    if word not in list(DesignCriterion):
        raise PlanError(f"there is no criterion {word}.", remedy=f"Criteria: {', '.join(DesignCriterion)}.")
    return DesignCriterion(word)


def _build_acceptance(
    tip_mm: float | None, worst_mm: float | None, offset_deg: float | None, offsets: tuple[str, ...]
) -> "AcceptanceLimits | None":
    from cellcal.calibration.poses.enough_poses import AcceptanceLimits

    if tip_mm is None and worst_mm is None and offset_deg is None:
        return None
    return AcceptanceLimits(
        None if tip_mm is None else tip_mm / 1e3,
        None if worst_mm is None else worst_mm / 1e3,
        None if offset_deg is None else offset_deg / DEGREES_PER_RADIAN,
        offsets,
    )


def _print_report(report: "PlanReport") -> None:
    from rich.console import Console

    from cellcal.service.cli.printing import PlainTable

    console = Console(highlight=False, emoji=False)
    for words in report.not_checked:
        console.print(f"[yellow]not checked[/] {escape(words)}")
    if report.reason:
        console.print(f"[bold]{escape(report.reason[0].upper() + report.reason[1:])}.[/]")
    chosen = (
        "the best plan that was tried"
        if report.plan is None
        else f"{len(report.plan.indices)} poses of this plan"
    )
    table = PlainTable("predicted standard deviation of the tool point (mm)", "rms", "worst test pose")
    rows = [("known before", report.before), (chosen, report.prediction)]
    if report.random is not None:
        rows.insert(1, ("as many poses drawn at random", report.random))
    for title, prediction in rows:
        sizes = (prediction.tip_rms_m, prediction.tip_max_m)
        table.add_row(title, *("unknown" if v > _UNKNOWN_M else f"{v * 1e3:.4f}" for v in sizes))
    console.print(table)
    _print_parameters(console, report)
    if report.efficiency is not None:
        console.print(
            f"At least {report.efficiency:.0%} of what any choice from {report.candidates} candidates can reach."
        )
    _print_poses(console, report)


def _print_parameters(console: "Console", report: "PlanReport") -> None:
    from cellcal.service.cli.printing import PlainTable

    prediction = report.prediction
    hidden = {item.parameter: item for item in report.not_identified}
    table = PlainTable("parameter", "predicted sigma", "unit", "note")
    for name, unit, sigma in zip(prediction.parameters, prediction.units, prediction.sigma, strict=True):
        words = ""
        if name in hidden:
            words = (
                f"not identified: hides behind {hidden[name].partner}"
                if hidden[name].partner
                else "not identified"
            )
        shown, scale = DISPLAY_UNITS[unit]
        table.add_row(name, f"{sigma * scale:.4f}", shown, words)
    console.print(table)


def _print_poses(console: "Console", report: "PlanReport") -> None:
    from cellcal.service.cli.printing import PlainTable

    if report.plan is None or not len(report.order):
        return
    factors, columns = report.shown
    joints = report.plan.joints_rad * factors
    units = ["mm" if name.endswith("_mm") else "°" for name in columns]
    table = PlainTable(
        "pose", *(f"J{i + 1} {unit}" for i, unit in enumerate(units)), "rank", "way from the pose before"
    )
    for at, (rank, free) in enumerate(
        zip(report.order[:_MOST_SHOWN], report.ways_free, strict=False), start=1
    ):
        way = "" if at == 1 else ("free" if free else "BLOCKED")
        table.add_row(str(at), *(f"{v:.1f}" for v in joints[rank]), str(rank + 1), way)
    console.print(table)
    if not all(report.ways_free):
        console.print("BLOCKED: the straight joint move from the pose before comes too near; go round.")
    if len(report.order) > _MOST_SHOWN:
        console.print(f"… and {len(report.order) - _MOST_SHOWN} more (`--csv` writes all)")
