"""What a dry run foretells is what the run then states: same cell, same settings, side by side."""

import re
from dataclasses import replace

import numpy as np
import pytest

from cellcal.procedures import base_to_base, drift_check, frame_offset, mastering_recovery
from cellcal.procedures.arm.drift_findings import DriftResult
from cellcal.procedures.cell import Cell
from cellcal.procedures.forecast import Forecast, Knowledge
from cellcal.procedures.run import Run
from cellcal.service.runs.run_preview import knowledge_of
from tests.procedures.memory_ledgers import MemoryLedger
from tests.procedures.procedure_scenes import (
    ProcedureScene,
    base_to_base_scene,
    drift_scene,
    healthy_scene,
    moved_workpiece_scene,
)
from tests.procedures.test_recovery_by_places import _lost_scene


def _figures_by_name(forecast: Forecast) -> dict[str, float]:
    return {one.name: one.expanded for one in forecast.predictions}


def _knowledge_of(cell: Cell) -> Knowledge:
    return knowledge_of(cell, None)


@pytest.mark.parametrize("origin_u_m", [0.002, 0.0012])
async def test_a_moved_frame_is_known_as_foretold_and_points_are_touched_again_where_it_helps(
    origin_u_m: float,
) -> None:
    made = moved_workpiece_scene()
    made.spec = replace(made.spec, origin_u_m=origin_u_m, old_sigma_m=0.0002, sigma_m=0.0007)
    for k in range(1, 5):
        made.technician.does[f"touch_point_{k}_again"] = made.technician.does[f"touch_point_{k}"]
    knowledge = frame_offset._forecast_run(made.spec, Knowledge())
    ledger = MemoryLedger()
    result = await frame_offset.frame_offset(Run(made.cell, ledger), made.spec)
    stated, named = result.found.placed, _figures_by_name(knowledge)
    assert named["frame's origin"] == pytest.approx(stated.origin_u_m, rel=1e-3)
    assert named["frame's angle"] == pytest.approx(stated.angle_u_rad, rel=1e-3)
    assert stated.origin_u_m <= origin_u_m
    touched = [
        f.step for f in ledger.past().findings if f.step.startswith("touch point") or "again" in f.step
    ]
    foreseen = [s for phase in frame_offset.DEFINITION.outline(made.spec) for s in phase.step_names]
    assert touched == [step for step in foreseen if "touch point" in step or "again" in step]
    assert sum(result.found.touches) == len(touched)
    further = len(touched) - 4
    assert (further > 0) == (origin_u_m < 0.002)
    (remark,) = frame_offset.DEFINITION.verdict(made.spec, result).remarks  # type: ignore[misc]
    assert remark.startswith(
        f"{len(touched)} touches, each further one" if further else "no saving: 4 touches"
    )


async def test_a_moved_frame_out_of_reach_is_foretold_with_the_points_alone() -> None:
    made = moved_workpiece_scene()
    made.spec = replace(made.spec, origin_u_m=0.0001, write_anyway="a test")
    knowledge = frame_offset._forecast_run(made.spec, Knowledge())
    result = await frame_offset.frame_offset(Run(made.cell, MemoryLedger()), made.spec)
    assert result.found.touches == (1, 1, 1, 1)
    assert _figures_by_name(knowledge)["frame's origin"] == pytest.approx(
        result.found.placed.origin_u_m, rel=1e-3
    )
    (remark, ordered) = frame_offset.DEFINITION.verdict(made.spec, result).remarks  # type: ignore[misc]
    assert "further ones were not asked for: 12 would leave the origin within" in remark
    assert "write_anyway" in ordered


def test_without_the_old_frame_the_origin_is_not_foretold() -> None:
    spec = frame_offset.FrameOffset(
        1, (0.0, 0.0, 0.1), old_points_in_base_m=((0.5, 0.0, 0.0), (0.9, 0.0, 0.0), (0.5, 0.3, 0.0))
    )
    knowledge = frame_offset._forecast_run(spec, Knowledge())
    assert set(_figures_by_name(knowledge)) == {"frame's angle"}
    assert any("origin" in line for line in knowledge.not_checked)


async def test_bases_are_known_as_foretold_from_the_stored_alignments() -> None:
    made = base_to_base_scene()
    forecast_figures = _figures_by_name(base_to_base._forecast_run(made.spec, _knowledge_of(made.cell)))
    result = await base_to_base.base_to_base(Run(made.cell, MemoryLedger()), made.spec)
    for base in result.bases:
        assert forecast_figures[f"origin of {base.robot_serial}"] == base.pose.origin_u_m
        assert forecast_figures[f"angle of {base.robot_serial}"] == base.pose.angle_u_rad
    lonely = replace(made.cell, alignments=made.cell.alignments[:1])
    assert "a second robot" in base_to_base._forecast_run(made.spec, _knowledge_of(lonely)).lacks[0]
    named = replace(made.spec, robots=("F-1", "F-9"))
    assert "F-9" in base_to_base._forecast_run(named, _knowledge_of(made.cell)).lacks[0]


async def _take_reference(made: ProcedureScene) -> DriftResult:
    return await drift_check.drift_check(Run(made.cell, MemoryLedger()), made.spec)


async def test_a_drift_check_states_the_deviation_that_was_foretold() -> None:
    made = await drift_scene()
    assert made.cell.drift_references
    knowledge = drift_check._forecast_run(made.spec, _knowledge_of(made.cell))
    result = await _take_reference(made)
    assert not result.taken_now
    assert _figures_by_name(knowledge)["change of a reading"] == pytest.approx(2.0 * result.sigma_m, rel=0.2)
    assert [pose.joints_rad for pose in knowledge.poses] == list(result.reference.poses_rad)

    made.cell = replace(made.cell, drift_references=())
    knowledge = drift_check._forecast_run(made.spec, _knowledge_of(made.cell))
    assert len(knowledge.poses) == made.spec.rules.poses
    taken = await _take_reference(made)
    assert taken.taken_now
    assert _figures_by_name(knowledge)["a reference reading"] == pytest.approx(2.0 * taken.sigma_m, rel=0.2)
    renewed = replace(made.spec, renew=True)
    steps = [s for phase in drift_check.DEFINITION.outline(renewed) for s in phase.step_names]
    assert steps.count("capture again 1") == 1


@pytest.mark.parametrize("kind", ["point", "seat", "target"])
async def test_a_recovery_by_places_visits_the_places_that_were_foretold(kind: str) -> None:
    made, _ = await _lost_scene(kind)  # type: ignore[arg-type]
    knowledge = mastering_recovery._forecast_run(made.spec, _knowledge_of(made.cell))
    assert knowledge.lacks == ()
    ledger = MemoryLedger()
    result = await mastering_recovery.mastering_recovery(Run(made.cell, ledger), made.spec)
    assert result.verdict == "restored"
    visits = re.compile(r"(check )?place \d+|final place")
    visited = {f.step: f.value for f in ledger.past().findings if visits.fullmatch(f.step)}
    assert [pose.label for pose in knowledge.poses] == list(visited)
    record = made.cell.record
    assert record is not None
    for pose in knowledge.poses:
        zero = result.counts_at_zero
        found = record.drive.to_joints(np.array(visited[pose.label]["counts"]), np.array(zero))
        assert np.abs(found - pose.joints_rad).max() < 0.15  # by hand: near the posture of the record
    assert knowledge.duration_s > len(knowledge.poses) * 60.0
    (turns, zero_u) = knowledge.predictions
    assert turns.expanded < 0.5
    assert "1.000000" in turns.sentence
    assert 0.0 < zero_u.expanded < 0.01


async def test_the_zero_of_an_exchanged_motor_is_known_no_worse_than_foretold() -> None:
    made, _ = await _lost_scene("point")
    knowledge = mastering_recovery._forecast_run(made.spec, _knowledge_of(made.cell))
    made.arm.true_zero = tuple(z + (77_777 if k == 3 else 0) for k, z in enumerate(made.arm.true_zero))
    made.spec = replace(made.spec, exchanged_axes=(4,))
    result = await mastering_recovery.mastering_recovery(Run(made.cell, MemoryLedger()), made.spec)
    stated = max(joint.offset_u_rad for joint in result.joints)
    assert 0.1 * knowledge.predictions[1].expanded < stated <= knowledge.predictions[1].expanded * 1.05


async def test_missing_data_of_a_recovery_is_named_and_no_wire_walk_is_forecast_beside_a_wire_record() -> (
    None
):
    made, _ = await _lost_scene("target")
    knowledge = _knowledge_of(made.cell)
    record = knowledge.record
    assert record is not None
    assert record.wire is not None  # beside its places it holds lengths
    forecast = mastering_recovery._forecast_run(made.spec, knowledge)
    assert not any(pose.label.startswith("capture") for pose in forecast.poses)
    places_only = replace(made.spec, evidence="wire")
    by_record = mastering_recovery._forecast_run(
        places_only, replace(knowledge, record=replace(record, wire=None))
    )
    assert [pose.label for pose in by_record.poses] == [pose.label for pose in forecast.poses]

    def missing_remark(**changed: object) -> str:
        found = mastering_recovery._forecast_run(made.spec, replace(knowledge, **changed))  # type: ignore[arg-type]
        assert found.duration_s == 0.0
        return found.lacks[0]

    assert "tracker" in missing_remark(tracker=None)
    assert "recovery kit" in missing_remark(record=replace(record, kit=None))
    assert "mastering record" in missing_remark(record=None)
    wired = mastering_recovery._forecast_run(replace(made.spec, evidence="wire"), knowledge)
    assert "where the wire is" in wired.lacks


def test_the_wire_that_a_recovery_would_need_is_named() -> None:
    made = healthy_scene(mastering_recovery.MasteringRecoverySpec())
    assert mastering_recovery._forecast_run(made.spec, Knowledge()).lacks
