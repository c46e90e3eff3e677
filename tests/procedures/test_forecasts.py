"""What a dry run foretells is what the run then states: same cell, same settings, side by side."""

import re
from dataclasses import replace

import numpy as np
import pytest

from cellcal.procedures import base_to_base, drift_check, frame_offset, mastering_recovery
from cellcal.procedures.cell import Cell
from cellcal.procedures.forecast import Forecast, Knowledge
from cellcal.procedures.run import Run
from cellcal.service.runs.run_preview import knowledge_of
from tests.procedures.cells import Scene, drifting, moved_workpiece, scene, through_a_fixture
from tests.procedures.ledgers import MemoryLedger
from tests.procedures.test_recovery_by_places import _lost


def _named(told: Forecast) -> dict[str, float]:
    return {one.name: one.expanded for one in told.predictions}


def _known(cell: Cell) -> Knowledge:
    return knowledge_of(cell, None)


@pytest.mark.parametrize("origin_u_m", [0.002, 0.0012])
async def test_a_moved_frame_is_known_as_foretold_and_points_are_touched_again_where_it_helps(
    origin_u_m: float,
) -> None:
    made = moved_workpiece()
    made.spec = replace(made.spec, origin_u_m=origin_u_m, old_sigma_m=0.0002, sigma_m=0.0007)
    for k in range(1, 5):
        made.hands.does[f"touch_point_{k}_again"] = made.hands.does[f"touch_point_{k}"]
    told = frame_offset._forecast_run(made.spec, Knowledge())
    ledger = MemoryLedger()
    result = await frame_offset.frame_offset(Run(made.cell, ledger), made.spec)
    stated, named = result.found.placed, _named(told)
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
    (said,) = frame_offset.DEFINITION.verdict(made.spec, result).remarks  # type: ignore[misc]
    assert said.startswith(f"{len(touched)} touches, each further one" if further else "no saving: 4 touches")


async def test_a_moved_frame_out_of_reach_is_foretold_with_the_points_alone() -> None:
    made = moved_workpiece()
    made.spec = replace(made.spec, origin_u_m=0.0001, write_anyway="a test")
    told = frame_offset._forecast_run(made.spec, Knowledge())
    result = await frame_offset.frame_offset(Run(made.cell, MemoryLedger()), made.spec)
    assert result.found.touches == (1, 1, 1, 1)
    assert _named(told)["frame's origin"] == pytest.approx(result.found.placed.origin_u_m, rel=1e-3)
    (said, ordered) = frame_offset.DEFINITION.verdict(made.spec, result).remarks  # type: ignore[misc]
    assert "further ones were not asked for: 12 would leave the origin within" in said
    assert "write_anyway" in ordered


def test_without_the_old_frame_the_origin_is_not_foretold() -> None:
    spec = frame_offset.FrameOffset(
        1, (0.0, 0.0, 0.1), old_points_in_base_m=((0.5, 0.0, 0.0), (0.9, 0.0, 0.0), (0.5, 0.3, 0.0))
    )
    told = frame_offset._forecast_run(spec, Knowledge())
    assert set(_named(told)) == {"frame's angle"}
    assert any("origin" in line for line in told.not_checked)


async def test_bases_are_known_as_foretold_from_the_stored_alignments() -> None:
    made = through_a_fixture()
    told = _named(base_to_base._forecast_run(made.spec, _known(made.cell)))
    result = await base_to_base.base_to_base(Run(made.cell, MemoryLedger()), made.spec)
    for base in result.bases:
        assert told[f"origin of {base.robot_serial}"] == base.pose.origin_u_m
        assert told[f"angle of {base.robot_serial}"] == base.pose.angle_u_rad
    lonely = replace(made.cell, alignments=made.cell.alignments[:1])
    assert "a second robot" in base_to_base._forecast_run(made.spec, _known(lonely)).lacks[0]
    named = replace(made.spec, robots=("F-1", "F-9"))
    assert "F-9" in base_to_base._forecast_run(named, _known(made.cell)).lacks[0]


async def _reference(made: Scene) -> drift_check.DriftResult:
    return await drift_check.drift_check(Run(made.cell, MemoryLedger()), made.spec)


async def test_a_drift_check_states_the_deviation_that_was_foretold() -> None:
    made = await drifting()
    assert made.cell.drift_references
    told = drift_check._forecast_run(made.spec, _known(made.cell))
    result = await _reference(made)
    assert not result.taken_now
    assert _named(told)["change of a reading"] == pytest.approx(2.0 * result.sigma_m, rel=0.2)
    assert [pose.joints_rad for pose in told.poses] == list(result.reference.poses_rad)

    made.cell = replace(made.cell, drift_references=())
    told = drift_check._forecast_run(made.spec, _known(made.cell))
    assert len(told.poses) == made.spec.rules.poses
    taken = await _reference(made)
    assert taken.taken_now
    assert _named(told)["a reference reading"] == pytest.approx(2.0 * taken.sigma_m, rel=0.2)
    renewed = replace(made.spec, renew=True)
    steps = [s for phase in drift_check.DEFINITION.outline(renewed) for s in phase.step_names]
    assert steps.count("capture again 1") == 1


@pytest.mark.parametrize("kind", ["point", "seat", "target"])
async def test_a_recovery_by_places_visits_the_places_that_were_foretold(kind: str) -> None:
    made, _ = await _lost(kind)  # type: ignore[arg-type]
    told = mastering_recovery._forecast_run(made.spec, _known(made.cell))
    assert told.lacks == ()
    ledger = MemoryLedger()
    result = await mastering_recovery.mastering_recovery(Run(made.cell, ledger), made.spec)
    assert result.verdict == "restored"
    visits = re.compile(r"(check )?place \d+|final place")
    visited = {f.step: f.value for f in ledger.past().findings if visits.fullmatch(f.step)}
    assert [pose.label for pose in told.poses] == list(visited)
    record = made.cell.record
    assert record is not None
    for pose in told.poses:
        zero = result.counts_at_zero
        found = record.drive.to_joints(np.array(visited[pose.label]["counts"]), np.array(zero))
        assert np.abs(found - pose.joints_rad).max() < 0.15  # by hand: near the posture of the record
    assert told.duration_s > len(told.poses) * 60.0
    (turns, zero_u) = told.predictions
    assert turns.expanded < 0.5
    assert "1.000000" in turns.sentence
    assert 0.0 < zero_u.expanded < 0.01


async def test_the_zero_of_an_exchanged_motor_is_known_no_worse_than_foretold() -> None:
    made, _ = await _lost("point")
    told = mastering_recovery._forecast_run(made.spec, _known(made.cell))
    made.arm.true_zero = tuple(z + (77_777 if k == 3 else 0) for k, z in enumerate(made.arm.true_zero))
    made.spec = replace(made.spec, exchanged_axes=(4,))
    result = await mastering_recovery.mastering_recovery(Run(made.cell, MemoryLedger()), made.spec)
    stated = max(joint.offset_u_rad for joint in result.joints)
    assert 0.1 * told.predictions[1].expanded < stated <= told.predictions[1].expanded * 1.05


async def test_what_a_recovery_lacks_is_said_and_no_wire_walk_is_foretold_beside_a_wire_record() -> None:
    made, _ = await _lost("target")
    known = _known(made.cell)
    record = known.record
    assert record is not None
    assert record.wire is not None  # beside its places it holds lengths
    told = mastering_recovery._forecast_run(made.spec, known)
    assert not any(pose.label.startswith("capture") for pose in told.poses)
    places_only = replace(made.spec, evidence="wire")
    by_record = mastering_recovery._forecast_run(
        places_only, replace(known, record=replace(record, wire=None))
    )
    assert [pose.label for pose in by_record.poses] == [pose.label for pose in told.poses]

    def lacks(**changed: object) -> str:
        found = mastering_recovery._forecast_run(made.spec, replace(known, **changed))  # type: ignore[arg-type]
        assert found.duration_s == 0.0
        return found.lacks[0]

    assert "tracker" in lacks(tracker=None)
    assert "recovery kit" in lacks(record=replace(record, kit=None))
    assert "mastering record" in lacks(record=None)
    wired = mastering_recovery._forecast_run(replace(made.spec, evidence="wire"), known)
    assert "where the wire is" in wired.lacks


def test_the_wire_that_a_recovery_would_need_is_named() -> None:
    made = scene(mastering_recovery.MasteringRecoverySpec())
    assert mastering_recovery._forecast_run(made.spec, Knowledge()).lacks
