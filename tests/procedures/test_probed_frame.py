"""A user frame felt at a corner: what is found, what is claimed, and what is refused before or on the way."""

import asyncio
import math
from dataclasses import replace

import numpy as np
import pytest
from pydantic_core import to_jsonable_python

from cellcal.calibration.errors import CellError, DegenerateDataError
from cellcal.calibration.geometry import (
    Pose,
    exp_rotation,
    homogeneous_matrix,
    inverse_transform,
    log_transform,
)
from cellcal.calibration.points.three_two_one import FACES, Corner, FaceName, outward_in_frame
from cellcal.procedures.accuracy_limits import FrameLimits
from cellcal.procedures.cell import MotionLevel
from cellcal.procedures.probed_frame import DEFINITION, ProbedSetup, probed_frame
from cellcal.procedures.procedure_definition import all_missing
from cellcal.procedures.run import DeclinedError, RefusalError, Run
from cellcal.procedures.steps.contact_errors import (
    AlreadyInContactError,
    ContactError,
    NoContactError,
    StuckContactError,
)
from cellcal.procedures.teaching.corner_places import CornerRules
from cellcal.procedures.teaching.corner_plan import rest_of_way
from cellcal.procedures.teaching.corner_touches import CornerGoal, fewest_touches, predict_corner
from cellcal.procedures.verdict import ProcedureVerdict
from cellcal.service.runs.run_preview import knowledge_of
from tests.procedures.memory_ledgers import CrashError, MemoryLedger, MortalLedger
from tests.procedures.probed_corner import IdealProbe, ProbingArm, home_at
from tests.procedures.procedure_scenes import ProcedureScene, probing_scene


async def probe_frame(made: ProcedureScene, ledger: MemoryLedger | None = None) -> ProbedSetup:
    return await probed_frame(Run(made.cell, ledger or MemoryLedger()), made.spec)


def arm_of(made: ProcedureScene) -> ProbingArm:
    assert isinstance(made.arm, ProbingArm)
    return made.arm


def true_frame(made: ProcedureScene) -> np.ndarray:
    feeler = arm_of(made).feeler
    assert feeler is not None
    return feeler.base_frame


def judge_setup(made: ProcedureScene, setup: ProbedSetup) -> ProcedureVerdict:
    assert DEFINITION.verdict is not None
    return DEFINITION.verdict(made.spec, setup)


async def expect_refusal(made: ProcedureScene, error: type[CellError], words: str) -> CellError:
    """Return the refusal of a run that writes nothing."""
    before = dict(made.arm.frames)
    with pytest.raises(error, match=words) as error_info:
        await probe_frame(made)
    assert made.arm.frames == before
    assert error_info.value.remedy
    return error_info.value


@pytest.mark.parametrize("corner", ["outside", "inside"])
async def test_a_corner_that_is_off_its_drawing_is_felt_and_written(corner: Corner) -> None:
    made = probing_scene(corner)
    setup = await probe_frame(made)
    twist = log_transform(inverse_transform(true_frame(made)) @ setup.found.base_frame.to_matrix())
    assert np.abs(twist[:3]).max() < 5e-6
    assert np.abs(twist[3:]).max() < 5e-5
    assert made.arm.frames[5] == setup.read_back == setup.found.base_frame
    assert judge_setup(made, setup).overall_decision == "pass"
    assert len(setup.points) == 7  # six, and one to spare
    assert [check.face for check in setup.checks] == ["x", "y", "z"]


async def test_a_resumed_run_feels_for_no_point_twice() -> None:
    whole = probing_scene()
    await probe_frame(whole)
    made, facts = probing_scene(), []
    with pytest.raises(CrashError):
        await probed_frame(Run(made.cell, MortalLedger(facts, 21, stored=True)), made.spec)
    ledger = MemoryLedger(facts)
    done = [finding.step for finding in ledger.past().findings]
    assert "touch the y face 1" in done
    await probed_frame(Run(made.cell, ledger, ledger.past()), made.spec)
    assert arm_of(made).contacts == arm_of(whole).contacts


async def broken_off_in_contact(made: ProcedureScene) -> MemoryLedger:
    """Cancel a run while its tip still presses a face; return what it had found."""
    arm, ledger = arm_of(made), MemoryLedger()

    def cancel_where_it_presses(_: int) -> None:
        if arm.clearance_m() < 0.0:
            going.cancel()

    arm.midway = cancel_where_it_presses
    going = asyncio.create_task(probe_frame(made, ledger))
    with pytest.raises(asyncio.CancelledError):
        await going
    arm.midway = None
    assert arm.clearance_m() < 0.0
    return MemoryLedger(ledger.facts)


async def test_a_touch_that_was_broken_off_in_contact_leaves_its_face_and_ends_as_ever() -> None:
    made = probing_scene()
    ledger = await broken_off_in_contact(made)
    resumed = await probed_frame(Run(made.cell, ledger, ledger.past()), made.spec)
    assert to_jsonable_python(resumed) == to_jsonable_python(await probe_frame(probing_scene()))


@pytest.mark.parametrize(
    ("aside_rad", "error"), [(0.0, StuckContactError), (0.02, AlreadyInContactError)], ids=["there", "aside"]
)
async def test_a_contact_that_no_way_back_opens_is_refused(aside_rad: float, error: type[CellError]) -> None:
    made = probing_scene()
    ledger = await broken_off_in_contact(made)
    moves, frames = len(made.arm.moves), dict(made.arm.frames)
    made.arm.write_program(made.arm.true_joints + np.array([aside_rad, 0.0, 0.0, 0.0, 0.0, 0.0]))
    assert isinstance(made.cell.probe, IdealProbe)
    made.cell.probe.stuck_closed = True
    with pytest.raises(error):
        await probed_frame(Run(made.cell, ledger, ledger.past()), made.spec)
    assert (len(made.arm.moves) == moves) == (error is AlreadyInContactError)
    assert made.arm.frames == frames


async def test_what_no_touch_lessens_is_counted_and_further_touches_are_not_made_for_it() -> None:
    made = probing_scene(arm_sigma_m=0.0003, accuracy_class="B")
    setup = await probe_frame(made)
    verdict = judge_setup(made, setup)
    assert (len(setup.points), verdict.overall_decision) == (6, "undecided")
    origin = verdict.characteristics[0]
    parts = [line.standard_uncertainty for line in origin.budget]
    assert origin.standard_uncertainty == pytest.approx(math.hypot(*parts), rel=1e-9)
    assert parts[1:] == [5e-5, 0.0003]
    assert origin.expanded_uncertainty > 2 * 0.0003
    assert "further ones were not asked for: 12 would leave the origin within" in verdict.remarks[0]


async def test_touches_are_added_where_they_tell_most_until_the_frame_is_known() -> None:
    made = probing_scene(limits=FrameLimits(0.001, math.radians(0.15)))
    setup = await probe_frame(made)
    assert judge_setup(made, setup).overall_decision == "pass"
    assert len(setup.points) == 9
    assert (
        judge_setup(made, setup).remarks[0].startswith("9 touches, each where it tells most; the three faces")
    )


@pytest.mark.parametrize("weak", FACES)
def test_a_touch_whose_times_tell_little_is_made_good_by_another_of_its_face(weak: FaceName) -> None:
    good, goal = 8e-5, CornerGoal(0.0006, math.radians(0.3), 0.0, 5e-5)
    made = dict(fewest_touches(good))
    assert predict_corner(CornerRules(), goal, good, made).reached
    made[weak] = (*made[weak][:-1], 1e-3)
    outlook = predict_corner(CornerRules(), goal, good, made)
    assert outlook.reached
    assert outlook.again[0] == weak


def test_of_a_way_only_what_lies_before_the_arm_is_gone() -> None:
    way = ((0.0, 0.0), (1.0, 0.0), (1.0, 1.0))
    assert rest_of_way(way, (0.0, 0.01)) == way[1:]
    assert rest_of_way(way, (0.5, 0.01)) == way[1:]
    assert rest_of_way(way, (1.0, 0.0)) == way[2:]
    assert rest_of_way(way, (0.99, 0.6)) == way[2:]
    assert rest_of_way(way, (1.0, 1.0)) == way[2:]


async def test_what_was_foretold_is_what_is_stated() -> None:
    made = probing_scene()
    assert DEFINITION.forecast is not None
    forecast = DEFINITION.forecast(made.spec, knowledge_of(made.cell, None))
    setup = await probe_frame(made)
    figures = judge_setup(made, setup).characteristics
    assert forecast.predictions[0].expanded == pytest.approx(figures[0].expanded_uncertainty, rel=0.05)
    assert forecast.predictions[1].expanded == pytest.approx(figures[1].expanded_uncertainty, rel=0.05)
    assert f"after {len(setup.points)} touches" in forecast.predictions[0].name


async def test_the_tip_of_the_cell_file_is_not_known_better_than_it_says() -> None:
    made = probing_scene()
    assert made.cell.probe_setup is not None
    made.cell = replace(made.cell, probe_setup=replace(made.cell.probe_setup, sigma_tip_m=0.001))
    verdict = judge_setup(made, await probe_frame(made))
    assert verdict.overall_decision == "undecided"
    assert verdict.characteristics[0].expanded_uncertainty > 0.002


async def test_a_face_that_is_not_there_is_reported_and_the_arm_stands() -> None:
    made = probing_scene()
    feeler = arm_of(made).feeler
    assert feeler is not None
    feeler.faces = ("z", "y")
    feeler.corner = "inside"  # what is left is felt from above and from the side
    arm_of(made).frames[5] = Pose.from_matrix(feeler.base_frame)
    made.spec = replace(made.spec, touching=replace(made.spec.touching, corner="inside"))
    error = await expect_refusal(made, NoContactError, "touch the x face 1: no contact within")
    assert "surface" in error.remedy
    assert not made.arm.moving


async def test_a_contact_that_is_closed_before_anything_moves_is_refused() -> None:
    made = probing_scene()
    made.cell.probe.stuck_closed = True  # type: ignore[union-attr]
    await expect_refusal(made, AlreadyInContactError, "closed before the approach begins")
    assert made.arm.moves == []


async def test_something_on_the_way_stops_the_arm() -> None:
    made = probing_scene()
    feeler = arm_of(made).feeler
    assert feeler is not None
    feeler.base_frame = feeler.base_frame @ homogeneous_matrix(np.eye(3), np.array([0.0, 0.0, 0.035]))
    await expect_refusal(made, ContactError, "touched something on its way")
    assert arm_of(made).contacts == 1


async def test_a_check_touch_that_disagrees_is_not_written() -> None:
    made = probing_scene()
    feeler = arm_of(made).feeler
    assert feeler is not None
    feeler.lean = {"x": exp_rotation(np.array([0.0, 0.0, 0.03])) @ outward_in_frame("x", "outside")}
    arm_of(made).frames[5] = Pose.from_matrix(feeler.base_frame)
    error = await expect_refusal(made, RefusalError, "check touch of the x face: FAIL")
    assert error.code == "procedure.failed"


async def test_a_frame_that_looks_away_from_the_probe_is_refused_before_anything_moves() -> None:
    made = probing_scene()
    made.spec = replace(
        made.spec, nominal=Pose.from_matrix(true_frame(made) @ np.diag([1.0, -1.0, -1.0, 1.0]))
    )
    await expect_refusal(made, DegenerateDataError, "stands 1.. deg from the first face's normal")
    assert made.arm.moves == []


async def test_an_untaught_frame_is_out_of_reach_and_nothing_moves() -> None:
    made = probing_scene()
    made.arm.frames.clear()
    error = await expect_refusal(made, DegenerateDataError, "cannot be brought|deg from the first")
    assert "nominal" in error.remedy or "probe" in error.remedy
    assert made.arm.moves == []


@pytest.mark.parametrize("settings", [{"inset_m": 0.004}, {"depth_m": 0.004}])
async def test_points_too_near_an_edge_for_the_ball_are_refused(settings: dict[str, float]) -> None:
    made = probing_scene(rules=settings)
    await expect_refusal(made, DegenerateDataError, "would meet an edge or the next face")
    assert made.arm.moves == []


async def test_a_way_that_would_cross_the_workpiece_is_refused() -> None:
    made = probing_scene()
    home_at(made.arm, true_frame(made), (0.05, -0.03, -0.05))
    await expect_refusal(made, DegenerateDataError, "the tip would pass the faces at")
    assert made.arm.moves == []


async def test_a_plan_that_a_person_refuses_moves_nothing() -> None:
    made = probing_scene()
    made.technician.refuses.add("accept_plan")
    await expect_refusal(made, DeclinedError, "declined")
    assert made.arm.moves == []


def test_a_robot_that_this_software_may_not_move_lacks_what_the_procedure_needs() -> None:
    made = probing_scene()
    assert all_missing(DEFINITION, made.cell) == ()
    watching = replace(made.cell, level=MotionLevel.OBSERVE, probe=None)
    assert [words.split(" ")[1] for words in all_missing(DEFINITION, watching)] == ["robot", "touch"]


@pytest.mark.parametrize(
    ("settings", "words"),
    [({"inset_m": 0.06}, "twice inset_m"), ({"clear_m": 0.006}, "twice search_way_m")],
)
def test_rules_that_do_not_fit_each_other_are_refused(settings: dict[str, float], words: str) -> None:
    with pytest.raises(ValueError, match=words):
        probing_scene(rules=settings)
