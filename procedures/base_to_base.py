"""Where one robot's base is seen from another's: through one fixture that both are aligned with.

F. S. Cheng, Calibration of Robot Reference Frames for Enhanced Robot Positioning Accuracy, 2008, Eq. 9:
``R'_T_R = R'_T_Fix (R_T_Fix)^-1``. Run `fixture_alignment` on each robot first, without moving the fixture.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Annotated

import numpy as np
from pydantic import Field, TypeAdapter
from pydantic_core import to_jsonable_python

from cellcal.calibration.message import make_message
from cellcal.calibration.points.alignment import Alignment, without_points
from cellcal.calibration.points.fixture import refuse_bad_points
from cellcal.calibration.points.joint_bases import bases_together
from cellcal.drivers.interfaces import Counts, Instruction
from cellcal.procedures.accuracy_limits import FrameLimits
from cellcal.procedures.canonical_json import sha256_of
from cellcal.procedures.cell import Cell
from cellcal.procedures.forecast import ANSWER_S, Forecast, Knowledge, Prediction
from cellcal.procedures.procedure_definition import Phase, ProcedureDefinition, StoredResult
from cellcal.procedures.questions import ask_acceptance, ask_confirmation
from cellcal.procedures.refit import (
    STANDS_OUT,
    FitPoint,
    Refit,
    RefitResult,
    Use,
    misses_in_space,
    pose_values,
    values_of,
)
from cellcal.procedures.run import RefusalError, Run
from cellcal.procedures.run_history import Finding
from cellcal.procedures.setting_texts import FIXTURE, OWN_LIMITS, WRITE_ANYWAY, describe_setting
from cellcal.procedures.survey.base_result import (
    AlignmentsFound,
    BasesResult,
    SeenBase,
    bases_instruction,
    bases_shape_error,
    judge_bases,
    uncertain_bases_error,
)
from cellcal.procedures.verdict import (
    ProcedureVerdict,
)
from cellcal.procedures.write_review import (
    WriteAnyway,
    raise_first,
    refuse_failed,
    with_order_remark,
    with_verdict,
)

BASE_LIMITS = FrameLimits(0.0004, math.radians(0.02))


@dataclass(frozen=True, slots=True)
class BaseToBaseSpec:
    """Through which fixture, which robots (by serial number), and how well it must be known."""

    fixture: Annotated[str, Field(min_length=1, max_length=64), FIXTURE]
    robots: Annotated[
        tuple[str, ...],
        Field(max_length=20),
        describe_setting(
            "Robots to compare",
            "Serial numbers; the first one sees the others; empty: all robots aligned with this fixture.",
            "what",
            basic=True,
        ),
    ] = ()
    limits: Annotated[FrameLimits, OWN_LIMITS] = BASE_LIMITS
    write_anyway: Annotated[WriteAnyway, WRITE_ANYWAY] = ""


LEAST = 3
_STORED: TypeAdapter[AlignmentsFound] = TypeAdapter(AlignmentsFound)
_RESULT: TypeAdapter[BasesResult] = TypeAdapter(BasesResult)


async def base_to_base(run: Run, spec: BaseToBaseSpec) -> BasesResult:
    """Find robots' bases from one another through a fixture that each is aligned with."""
    await run.ensure("the fixture has not moved", ask_confirmation, _not_moved_instruction(spec.fixture))
    stored = await run.step("read the alignments", stored_alignments, spec.fixture)
    result = await run.solve("chain the bases", chain_bases, spec, stored)
    raise_first((bases_shape_error(result), uncertain_bases_error(result, spec.limits)), spec.write_anyway)
    verdict = judge_bases(result, spec.limits)
    refuse_failed(verdict, spec.write_anyway, result)
    shown = with_verdict(bases_instruction(result), verdict, "Keep it?", spec.write_anyway)
    await run.step("accept the result", ask_acceptance, shown, sha256_of(to_jsonable_python(result.bases)))
    return result


async def stored_alignments(cell: Cell, fixture: str) -> AlignmentsFound:
    """Return the alignments with one fixture, and what tells whether the connected robot's still holds."""
    serial = (await cell.robot.identify()).serial
    counts: Counts = ()
    if cell.mastering is not None:
        counts = (await cell.mastering.read_mastering()).counts_at_zero
    return AlignmentsFound(tuple(a for a in cell.alignments if a.fixture == fixture), serial, counts)


def chain_bases(spec: BaseToBaseSpec, stored: AlignmentsFound) -> BasesResult:
    """Find every robot's base from the reference's by all their alignments in one fit, uncertainties included."""
    latest, serials, lacking = _alignments_to_chain(spec, stored.alignments)
    if lacking:
        raise RefusalError(
            make_message(
                "no alignment of {lacking} with {fixture} is stored", lacking=lacking, fixture=spec.fixture
            ),
            code="procedure.no_alignment",
            remedy="Run fixture_alignment on each robot with this fixture, and do not move it in between.",
        )
    chosen = tuple(latest[serial] for serial in dict.fromkeys(serials))
    _refuse_other_drawing(chosen)
    _refuse_other_mastering(chosen, stored)
    found = bases_together(chosen)
    bases = tuple(
        SeenBase(other.robot_serial, base) for other, base in zip(chosen[1:], found.bases, strict=True)
    )
    return BasesResult(
        spec.fixture,
        chosen[0].robot_serial,
        bases,
        chosen,
        found.jointly,
        found.chi_square,
        found.degrees_of_freedom,
    )


def _alignments_to_chain(
    spec: BaseToBaseSpec, alignments: Sequence[Alignment]
) -> tuple[dict[str, Alignment], tuple[str, ...], str]:
    """Return each robot's newest alignment, the robots that are asked for, and which of them has none."""
    latest = {alignment.robot_serial: alignment for alignment in alignments}  # the newest comes last
    serials = spec.robots or tuple(sorted(latest))
    missing = [serial for serial in serials if serial not in latest]
    few = len(set(serials)) < 2
    return latest, serials, ", ".join(missing) or ("a second robot" if few else "")


def _refuse_other_drawing(alignments: tuple[Alignment, ...]) -> None:
    first = alignments[0]
    for other in alignments[1:]:
        if other.points_in_fixture_m != first.points_in_fixture_m:
            raise RefusalError(
                make_message(
                    "the alignments of {first_serial} and {other_serial} name different points of "
                    "{fixture}: it may be two fixtures",
                    first_serial=first.robot_serial,
                    other_serial=other.robot_serial,
                    fixture=first.fixture,
                ),
                code="procedure.other_fixture",
                remedy="Align both robots with the same points of the same fixture.",
            )


def _refuse_other_mastering(alignments: tuple[Alignment, ...], stored: AlignmentsFound) -> None:
    for alignment in alignments:
        mine = alignment.robot_serial == stored.connected_serial
        if mine and alignment.counts_at_zero != stored.counts_at_zero:
            raise RefusalError(
                make_message(
                    "robot {robot_serial} was mastered anew since it was aligned with {fixture}",
                    robot_serial=alignment.robot_serial,
                    fixture=alignment.fixture,
                ),
                code="procedure.alignment_outdated",
                remedy="Run fixture_alignment on it again.",
            )


def _not_moved_instruction(fixture: str) -> Instruction:
    return Instruction(
        "fixture_not_moved",
        make_message(
            "{fixture} and the robots' bases stand as they did when each robot was aligned.", fixture=fixture
        ),
    )


def _outline_phases(spec: BaseToBaseSpec) -> tuple[Phase, ...]:
    del spec
    return (Phase("read the alignments"), Phase("chain the bases"), Phase("accept the result"))


def _results_to_store(spec: BaseToBaseSpec, result: BasesResult) -> StoredResult:
    return StoredResult("base_to_base", spec.fixture, result)


def _make_verdict(spec: BaseToBaseSpec, result: BasesResult) -> ProcedureVerdict:
    return with_order_remark(judge_bases(result, spec.limits), spec.write_anyway)


def _forecast_run(spec: BaseToBaseSpec, knowledge: Knowledge) -> Forecast:
    stored = tuple(a for a in knowledge.alignments if a.fixture == spec.fixture)
    lacking = _alignments_to_chain(spec, stored)[2]
    if lacking:
        return Forecast(
            2 * ANSWER_S,
            lacks=(
                make_message(
                    "an alignment of {lacking} with {fixture}", lacking=lacking, fixture=spec.fixture
                ),
            ),
        )
    chained = chain_bases(spec, AlignmentsFound(stored, "", ()))
    origin_mm, angle_deg = spec.limits.origin_m * 1e3, math.degrees(spec.limits.angle_rad)
    words = make_message(
        "{origin_mm:.3f} mm and {angle_deg:.4f} deg are asked for", origin_mm=origin_mm, angle_deg=angle_deg
    )
    return Forecast(
        duration_s=2 * ANSWER_S,
        predictions=tuple(
            prediction
            for base in chained.bases
            for prediction in (
                Prediction(
                    make_message("origin of {robot_serial}", robot_serial=base.robot_serial),
                    base.pose.origin_u_m,
                    "m",
                    sentence=words,
                ),
                Prediction(
                    make_message("angle of {robot_serial}", robot_serial=base.robot_serial),
                    base.pose.angle_u_rad,
                    "rad",
                    sentence=words,
                ),
            )
        ),
        assumed=(
            make_message(
                "the newest alignments still hold: {fixture} and the bases have not moved",
                fixture=spec.fixture,
            ),
        ),
        not_checked=("whether the connected robot was mastered anew since",),
    )


def _make_refit(spec: BaseToBaseSpec, findings: Sequence[Finding]) -> Refit | None:
    found = values_of(findings)
    stored = _STORED.validate_python(found["read the alignments"])
    recorded = _RESULT.validate_python(found["chain the bases"])
    points_by_robot = {a.robot_serial: a.points for a in recorded.alignments if a.points is not None}
    if len(points_by_robot) < len(recorded.alignments):
        return None  # chained one by one: there is no fit of points
    seen_m = {serial: points.found_m for serial, points in points_by_robot.items()}
    steps = tuple(
        f"alignment point {k}" for k in range(1, len(recorded.alignments[0].points_in_fixture_m) + 1)
    )
    sigma_m = max(math.sqrt(2.0) * points.sigma_seat_m for points in points_by_robot.values())
    before = {base.robot_serial: base.pose.other_base_base for base in recorded.bases}

    def solve_again(use: Use) -> RefitResult:
        fewer = replace(stored, alignments=tuple(without_points(a, use) for a in recorded.alignments))
        refuse_bad_points(fewer.alignments[0].points_in_fixture_m)
        result = chain_bases(replace(spec, robots=tuple(seen_m)), fewer)
        poses = {base.robot_serial: base.pose.other_base_base for base in result.bases}
        carried = [
            np.array(seen_m[serial]) @ pose.rotation_matrix().T + np.array(pose.position_m)
            for serial, pose in poses.items()
        ]
        gaps = np.stack(carried) - np.array(seen_m[result.reference_serial])
        worst = gaps[np.linalg.norm(gaps, axis=2).argmax(axis=0), np.arange(len(steps))]
        values = (v for serial, pose in poses.items() for v in pose_values(pose, before[serial], serial))
        u_m = max(base.pose.origin_u_m for base in result.bases)
        return RefitResult(misses_in_space(worst.tolist(), sigma_m, STANDS_OUT), u_m, tuple(values))

    return Refit("place", tuple(FitPoint(step) for step in steps), LEAST, "origin", solve_again)


DEFINITION = ProcedureDefinition(
    name="base_to_base",
    title="Robot bases through one fixture",
    version=2,
    procedure=base_to_base,
    spec_type=BaseToBaseSpec,
    needs=(),
    needs_position=False,
    commands_motion=False,
    outline=_outline_phases,
    results_to_store=_results_to_store,
    verdict=_make_verdict,
    forecast=_forecast_run,
    refit=_make_refit,
)
