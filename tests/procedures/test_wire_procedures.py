"""What the procedures with a moved wire, and a moved workpiece, find and refuse."""

import math
from dataclasses import replace

import numpy as np
import pytest

from cellcal.calibration.errors import CalibrationError, DegenerateDataError
from cellcal.calibration.geometry import Pose, exp_rotation, homogeneous_matrix
from cellcal.calibration.points.frames import base_to_base as chained_frames
from cellcal.drivers.interfaces import MasteringData
from cellcal.procedures.accuracy_limits import FrameLimits
from cellcal.procedures.base_to_base import BaseToBaseSpec, base_to_base
from cellcal.procedures.catalogue import CATALOGUE
from cellcal.procedures.end_effector_points import MeasuredTool, end_effector_points
from cellcal.procedures.fixture_alignment import fixture_alignment, plan_alignment
from cellcal.procedures.forecast import Knowledge
from cellcal.procedures.frame_offset import DEFINITION as OFFSET
from cellcal.procedures.frame_offset import OffsetResult, frame_offset
from cellcal.procedures.motion.active_frames import is_same_pose
from cellcal.procedures.procedure_definition import with_planned_counts
from cellcal.procedures.refit import LEFT_OUT, MEASURED_AGAIN
from cellcal.procedures.run import DeclinedError, RefusalError, Run
from cellcal.procedures.steps.length import LengthCapture
from cellcal.procedures.survey.alignment_result import AlignmentResult
from cellcal.procedures.survey.base_result import BasesResult
from cellcal.procedures.survey.survey import EACH_CAPTURE, Survey, SurveyRules
from cellcal.procedures.survey.survey_choice import SurveyProgress, choose_pose
from cellcal.procedures.survey.wire_survey import read_survey_state
from cellcal.procedures.three_point_frame import three_point_frame
from tests.procedures.memory_ledgers import MemoryLedger
from tests.procedures.procedure_scenes import (
    BASE_FIXTURE,
    FIXTURE_POINTS,
    FLANGE_TOOL,
    FRAME,
    OFFSET_POINTS,
    OTHER_BASE_FIXTURE,
    QUICK,
    TARGETS,
    ProcedureScene,
    alignment_of,
    alignment_scene,
    base_to_base_scene,
    healthy_scene,
    hook_scene,
    moved_workpiece_scene,
    record_of,
    to_outer_frame,
    user_frame_scene,
)

CAREFUL = SurveyRules(samples=2)
FINE = FrameLimits(0.0002, math.radians(0.02))


async def _with_record(made: ProcedureScene) -> ProcedureScene:
    made.cell = replace(made.cell, record=await record_of(healthy_scene()))
    return made


async def _run_alignment(made: ProcedureScene) -> AlignmentResult:
    return await fixture_alignment(Run(made.cell, MemoryLedger()), made.spec)


async def _run_tool_measurement(made: ProcedureScene) -> MeasuredTool:
    return await end_effector_points(Run(made.cell, MemoryLedger()), made.spec)


async def _run_frame_offset(made: ProcedureScene) -> OffsetResult:
    return await frame_offset(Run(made.cell, MemoryLedger()), made.spec)


async def _run_base_to_base(made: ProcedureScene) -> BasesResult:
    return await base_to_base(Run(made.cell, MemoryLedger()), made.spec)


def _apart_m(one: Pose, other: Pose) -> float:
    return math.dist(one.position_m, other.position_m)


async def test_a_fixture_is_found_within_its_limits_with_fewer_captures_than_a_fixed_plan() -> None:
    made = await _with_record(alignment_scene(FIXTURE_POINTS, limits=FINE, rules=CAREFUL))
    result = await _run_alignment(made)
    assert result.placed.origin_u_m <= FINE.origin_m
    assert result.placed.angle_u_rad <= FINE.angle_rad
    assert _apart_m(result.alignment.base_fixture, BASE_FIXTURE) <= 1.5 * result.placed.origin_u_m
    assert result.fixed_plan_captures is not None
    assert result.captures <= 0.85 * result.fixed_plan_captures
    assert "saved" in result.saving_text
    assert made.technician.instructions.count("mount_wire_4") == 1
    verdict = CATALOGUE["fixture_alignment"].verdict
    assert verdict is not None
    assert verdict(made.spec, result).overall_decision == "pass"


async def test_a_dry_run_foretells_captures_and_uncertainty_without_a_device() -> None:
    made = await _with_record(alignment_scene(FIXTURE_POINTS, limits=FINE, rules=CAREFUL))
    forecast = CATALOGUE["fixture_alignment"].forecast
    assert forecast is not None
    knowledge = Knowledge(made.cell.model, made.cell.gauge_setup, made.wire.capabilities, made.cell.record)
    forecasts = forecast(made.spec, knowledge)
    assert forecasts.predictions[0].expanded <= FINE.origin_m
    assert 24 <= len(forecasts.poses) <= 160
    phases = with_planned_counts(CATALOGUE["fixture_alignment"].outline(made.spec), forecasts.planned)
    counts = {phase.name: len(phase.step_names) for phase in phases if phase.name in EACH_CAPTURE}
    assert counts == dict.fromkeys(EACH_CAPTURE, len(forecasts.poses))
    assert any("obstacles" in words for words in forecasts.not_checked)
    assert forecast(made.spec, Knowledge()).lacks
    assert made.arm.moves == []


def _spoil_lengths(made: ProcedureScene, *captures: int) -> ProcedureScene:
    """Let lengths be 20 mm wrong, counted from one as the run takes them."""
    first = made.wire.readings - 1
    made.wire.kink_m = {first + capture: 0.02 for capture in captures}
    return made


async def test_a_length_that_stays_wrong_when_taken_again_is_left_out_and_reported() -> None:
    rules = SurveyRules(min_captures=7, max_captures=8, candidates=24, samples=1)
    made = _spoil_lengths(
        alignment_scene(rules=rules), 4, 8, 9
    )  # the fourth, and both times that it is taken again
    result = await _run_alignment(made)
    assert [(aside.step, aside.reason) for aside in result.set_aside] == [
        ("capture 4", MEASURED_AGAIN),
        ("capture 8", MEASURED_AGAIN),
        ("capture 9", LEFT_OUT),
    ]
    assert _apart_m(result.alignment.base_fixture, BASE_FIXTURE) <= result.placed.origin_u_m
    verdict = CATALOGUE["fixture_alignment"].verdict
    assert verdict is not None
    assert verdict(made.spec, result).set_aside == result.set_aside


async def test_more_than_one_wrong_length_at_a_spot_is_refused() -> None:
    rules = SurveyRules(min_captures=7, max_captures=8, candidates=24, samples=1, retakes=0)
    with pytest.raises(RefusalError, match="contradict each other"):
        await _run_alignment(_spoil_lengths(alignment_scene(rules=rules), 2, 5))


async def test_alignment_points_on_one_line_are_refused_before_anything_moves() -> None:
    made = alignment_scene(((0.0, 0.0, 0.0), (0.3, 0.0, 0.0), (0.6, 0.01, 0.0)))
    with pytest.raises(DegenerateDataError, match="one line") as refused:
        await _run_alignment(made)
    assert "beside the line" in refused.value.remedy
    assert made.arm.moves == []


def _level_hook(
    made: ProcedureScene, pose: tuple[float, ...], hook_m: tuple[float, float, float]
) -> tuple[float, ...] | None:
    """Turn J2 until the hook is at one height; None where it cannot be."""
    turns = np.linspace(-1.2, 2.0, 4001)
    postures = np.tile(pose, (len(turns), 1))
    postures[:, 1] = turns
    heights = made.arm.model.tip_positions(postures, np.array(hook_m))[:, 2]
    best = int(np.argmin(np.abs(heights - 0.6)))
    return tuple(float(q) for q in postures[best]) if abs(heights[best] - 0.6) < 1e-3 else None


async def test_poses_in_one_plane_are_refused_with_the_other_place_named() -> None:
    made = alignment_scene()
    state = await read_survey_state(made.cell)
    plan = plan_alignment(state, replace(made.spec, rules=replace(QUICK, candidates=40)))
    hook_m = plan.hooks[0].at_m
    level = tuple(q for pose in plan.pools[0] if (q := _level_hook(made, pose, hook_m)) is not None)
    survey = Survey(state, replace(plan, pools=(level, *plan.pools[1:])), made.spec.rules)
    assert len(level) > 10
    taken = tuple(LengthCapture("", pose, 1.0, 1e-4, (1.0,), (1,)) for pose in level[:8])
    choice = choose_pose(survey, SurveyProgress((taken, (), ()), 0, plan.rest_rad, 1.0))
    assert "nearly in one plane" in choice.ambiguous
    assert (choice.way_rad, choice.enough) == ((), False)

    off = replace(plan, pools=((*level, *plan.pools[0]), *plan.pools[1:]))
    cure = choose_pose(
        Survey(state, off, made.spec.rules), SurveyProgress((taken, (), ()), 0, plan.rest_rad, 1.0)
    )
    assert cure.way_rad[-1] in plan.pools[0]  # the pose that tells the two places apart is gone to


async def test_an_adaptor_on_the_wrong_point_is_refused_and_nothing_is_kept() -> None:
    made = await _with_record(alignment_scene(FIXTURE_POINTS, limits=FINE, rules=CAREFUL))
    wrong = to_outer_frame(BASE_FIXTURE, (0.355, -0.44, 0.0))
    made.technician.does["mount_wire_2"] = lambda: setattr(made.wire, "anchor_in_base_m", wrong)
    with pytest.raises(RefusalError) as refused:
        await _run_alignment(made)
    assert refused.value.code == "procedure.wrong_shape"
    assert "2" in refused.value.message
    assert isinstance(refused.value.evidence, AlignmentResult)


async def test_a_caught_wire_is_measured_again() -> None:
    made = await _with_record(alignment_scene(FIXTURE_POINTS, limits=FINE, rules=CAREFUL))
    made.wire.kink_m = {4: 0.02, 5: 0.02}  # both samples of the third capture
    ledger = MemoryLedger()
    result = await fixture_alignment(Run(made.cell, ledger), made.spec)
    assert result.network.is_consistent()
    assert _apart_m(result.alignment.base_fixture, BASE_FIXTURE) <= 1.5 * result.placed.origin_u_m


async def test_what_cannot_be_reached_ends_undecided_with_the_figures() -> None:
    made = alignment_scene(limits=FrameLimits(1e-5, 1e-5))
    with pytest.raises(RefusalError) as refused:
        await _run_alignment(made)
    assert refused.value.code == "procedure.undecided"
    assert isinstance(refused.value.evidence, AlignmentResult)
    assert refused.value.evidence.captures == 3 * QUICK.max_captures


async def test_a_robot_that_is_not_mastered_is_not_surveyed() -> None:
    made = alignment_scene()
    made.arm.data = MasteringData(made.arm.data.counts_at_zero, mastered=False)
    with pytest.raises(RefusalError) as refused:
        await _run_alignment(made)
    assert refused.value.code == "procedure.not_healthy"
    assert made.arm.moves == []


async def test_three_points_of_the_end_effector_give_the_tool_frame() -> None:
    made = await _with_record(hook_scene(rules=CAREFUL, tip_u_m=0.0003, angle_u_rad=math.radians(0.2)))
    result = await _run_tool_measurement(made)
    assert not result.position_only
    assert result.tip_u_m <= 0.0003
    assert _apart_m(result.flange_tool, FLANGE_TOOL) <= 1.5 * result.tip_u_m
    assert is_same_pose(made.arm.tools[4], result.flange_tool)


async def test_one_point_gives_the_place_only_and_says_so() -> None:
    made = await _with_record(hook_scene(TARGETS[:1], rules=CAREFUL, tip_u_m=0.0005))
    result = await _run_tool_measurement(made)
    assert result.position_only
    assert result.flange_tool.quaternion == made.spec.rough_flange_tool.quaternion
    assert _apart_m(result.flange_tool, FLANGE_TOOL) <= 1.5 * result.tip_u_m
    verdict = CATALOGUE["end_effector_points"].verdict
    assert verdict is not None
    assert "x, y, z only" in verdict(made.spec, result).not_verified[0]


@pytest.mark.parametrize("points", [TARGETS[:2], ((0.0, 0.0, 0.0), (0.1, 0.0, 0.0), (0.2, 0.001, 0.0))])
async def test_points_that_leave_a_turn_open_are_refused(points: tuple) -> None:
    made = hook_scene(points)
    with pytest.raises(CalibrationError, match="line"):
        await _run_tool_measurement(made)
    assert (made.arm.moves, made.arm.writes) == ([], 0)


async def test_a_declined_tool_is_not_written() -> None:
    made = hook_scene(TARGETS[:1])
    made.technician.refuses = {"accept_tool"}
    with pytest.raises(DeclinedError):
        await _run_tool_measurement(made)
    assert made.arm.writes == 0


async def test_a_moved_workpiece_takes_its_frame_along() -> None:
    old_new = Pose.from_matrix(homogeneous_matrix(FRAME.rotation_matrix(), np.array([0.03, -0.02, 0.004])))
    made = moved_workpiece_scene(FRAME, old_new)
    result = await _run_frame_offset(made)
    assert is_same_pose(result.found.old_new, old_new)
    assert is_same_pose(made.arm.frames[2], FRAME @ old_new)
    assert result.found.shift_m == pytest.approx(math.hypot(0.03, 0.02, 0.004))
    far = np.array(result.found.far_point_in_frame_m)
    moved = old_new.rotation_matrix() @ far + np.array(old_new.position_m) - far
    assert result.found.far_shift_m == pytest.approx(float(np.linalg.norm(moved)))


@pytest.mark.parametrize(("turn_deg", "warns"), [(90.0, True), (1.0, False)])
async def test_corners_of_a_square_that_may_be_exchanged_are_named_before_the_write(
    turn_deg: float, warns: bool
) -> None:
    square = ((0.0, 0.0, 0.0), (0.4, 0.0, 0.0), (0.4, 0.4, 0.0), (0.0, 0.4, 0.0))
    turn = exp_rotation(np.array([0.0, 0.0, math.radians(turn_deg)]))
    middle = np.array([0.2, 0.2, 0.0])
    old_new = Pose.from_matrix(homogeneous_matrix(turn, middle - turn @ middle + [0.003, 0.001, 0.0]))
    made = moved_workpiece_scene(FRAME, old_new, square)
    result = await _run_frame_offset(made)
    remarks = OFFSET.verdict(made.spec, result).remarks  # type: ignore[misc]
    for text in (made.technician.read["accept_offset"], " ".join(remarks)):
        assert ("turned by 0.0 deg, not by 90.0 deg: see that none were exchanged" in text) == warns


async def test_points_touched_before_the_move_serve_as_well_as_a_drawing() -> None:
    made = moved_workpiece_scene()
    want = (await _run_frame_offset(moved_workpiece_scene())).found.old_new
    before = tuple(to_outer_frame(FRAME, point) for point in OFFSET_POINTS)
    made.spec = replace(made.spec, points_in_frame_m=(), old_points_in_base_m=before, old_frame=FRAME)
    assert is_same_pose((await _run_frame_offset(made)).found.old_new, want)


async def test_points_of_another_shape_are_refused_and_the_frame_stays() -> None:
    made = moved_workpiece_scene()
    third = made.technician.does["touch_point_3"]

    def touch_beside() -> None:
        third()
        taught = made.arm.taught
        assert taught is not None
        x, y, z = taught.position_m
        made.arm.taught = Pose((x + 0.008, y + 0.008, z), taught.quaternion)

    made.technician.does["touch_point_3"] = touch_beside
    with pytest.raises(RefusalError) as refused:
        await _run_frame_offset(made)
    assert refused.value.code == "procedure.wrong_shape"
    assert made.arm.frames[2] == FRAME


async def test_a_check_point_below_the_plane_is_refused() -> None:
    made = moved_workpiece_scene()
    made.technician.does["touch_above"] = lambda: setattr(made.arm, "taught", Pose((0.5, 0.0, -0.9)))
    with pytest.raises(CalibrationError, match="below"):
        await _run_frame_offset(made)
    assert made.arm.writes == 0


async def test_both_kinds_of_points_or_none_are_refused() -> None:
    made = moved_workpiece_scene()
    made.spec = replace(made.spec, old_points_in_base_m=OFFSET_POINTS)
    with pytest.raises(CalibrationError, match="either"):
        await _run_frame_offset(made)


async def test_two_bases_are_chained_through_the_fixture() -> None:
    made = base_to_base_scene()
    result = await _run_base_to_base(made)
    assert [base.robot_serial for base in result.bases] == ["F-2"]
    assert is_same_pose(
        result.bases[0].pose.other_base_base, chained_frames(OTHER_BASE_FIXTURE, BASE_FIXTURE)
    )
    assert (
        result.bases[0].pose.origin_u_m > math.sqrt(2) * 1e-4
    )  # both alignments, and the lever of the angle


async def test_the_newest_alignment_of_a_robot_counts() -> None:
    made = base_to_base_scene()
    newer = alignment_of("F-2", BASE_FIXTURE)
    made.cell = replace(made.cell, alignments=(*made.cell.alignments, newer))
    result = await _run_base_to_base(made)
    assert is_same_pose(result.bases[0].pose.other_base_base, Pose((0.0, 0.0, 0.0)))


@pytest.mark.parametrize(
    ("spec", "code"),
    [
        (BaseToBaseSpec("table", ("F-1", "F-9")), "procedure.no_alignment"),
        (BaseToBaseSpec("other"), "procedure.no_alignment"),
        (BaseToBaseSpec("table", limits=FrameLimits(1e-5, 1e-5)), "procedure.undecided"),
    ],
)
async def test_bases_without_enough_are_refused(spec: BaseToBaseSpec, code: str) -> None:
    made = base_to_base_scene()
    made.spec = spec
    with pytest.raises(RefusalError) as refused:
        await _run_base_to_base(made)
    assert refused.value.code == code


async def test_an_alignment_of_an_earlier_mastering_or_of_other_points_is_refused() -> None:
    made = base_to_base_scene()
    mine, other = made.cell.alignments
    made.cell = replace(made.cell, alignments=(replace(mine, counts_at_zero=(1,) * 6), other))
    with pytest.raises(RefusalError, match="mastered anew"):
        await _run_base_to_base(made)
    made.cell = replace(made.cell, alignments=(mine, replace(other, points_in_fixture_m=TARGETS)))
    with pytest.raises(RefusalError, match="two fixtures"):
        await _run_base_to_base(made)


async def test_more_points_make_a_taught_frame_surer_and_a_stray_one_is_named() -> None:
    made, plain = user_frame_scene(), user_frame_scene()
    made.spec = replace(made.spec, more_on_x=2, more_in_plane=3)
    tip = np.array(made.spec.tip_in_flange_m)
    attitude = np.diag([1.0, -1.0, -1.0])

    def touch_places(places: list[tuple[float, float, float]]) -> None:
        point = np.array(to_outer_frame(FRAME, places.pop(0)))
        made.arm.taught = Pose.from_matrix(homogeneous_matrix(attitude, point - attitude @ tip))

    on_x = [(0.2, 0.0, 0.0), (0.3, 0.0, 0.0)]
    in_plane = [(0.3, -0.3, 0.0), (0.4, 0.2, 0.0), (0.0, 0.4, 0.0)]
    made.technician.does |= {
        "touch_more_on_x": lambda: touch_places(on_x),
        "touch_more_on_xy": lambda: touch_places(in_plane),
    }
    setup = await three_point_frame(Run(made.cell, MemoryLedger()), made.spec)
    three = await three_point_frame(Run(plain.cell, MemoryLedger()), plain.spec)
    assert is_same_pose(setup.taught.base_frame, FRAME)
    assert setup.taught.redundancy == 7
    assert max(setup.taught.rotation_sigma_rad) < max(three.taught.rotation_sigma_rad)

    stray, rest = (0.3, -0.3, 0.02), [(0.4, 0.2, 0.0), (0.0, 0.4, 0.0)]
    on_x[:], in_plane[:] = [(0.2, 0.0, 0.0), (0.3, 0.0, 0.0)], [stray, (0.3, -0.3, 0.0), *rest]
    mended = await three_point_frame(Run(made.cell, MemoryLedger()), made.spec)
    assert is_same_pose(mended.taught.base_frame, FRAME)
    assert [one.step for one in mended.set_aside] == ["touch another point of the plane 1"]

    on_x[:] = [(0.2, 0.0, 0.0), (0.3, 0.0, 0.0)]
    in_plane[:] = [stray, stray, *(one for one in rest for _ in range(2))]  # each is asked for anew: in vain
    made.arm.frames.clear()
    with pytest.raises(CalibrationError, match="misses its line or plane"):
        await three_point_frame(Run(made.cell, MemoryLedger()), made.spec)
    assert made.arm.frames == {}
