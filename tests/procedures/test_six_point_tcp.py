"""A tool taught by hand: every method, touches that are too alike or stray, and when there are enough."""

import math
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from cellcal.calibration.errors import CalibrationError, DegenerateDataError
from cellcal.calibration.geometry import Pose, exp_rotation, homogeneous_matrix
from cellcal.calibration.uncertainty import coverage_in_space
from cellcal.procedures.accuracy_limits import ToolLimits
from cellcal.procedures.forecast import Knowledge
from cellcal.procedures.motion.active_frames import is_same_pose
from cellcal.procedures.motors import PositionLostAgainError
from cellcal.procedures.run import OutOfToleranceError, RefusalError, Run
from cellcal.procedures.six_point_tcp import DEFINITION, SixPointTcp, ToolSetup, six_point_tcp
from cellcal.procedures.teaching.tcp_verdict import arm_u, axes_u
from tests.procedures.memory_ledgers import MemoryLedger
from tests.procedures.procedure_scenes import TIP, ProcedureScene, tool_pose, tool_rotation, tool_touch_scene

PIN = np.array([0.7, 0.1, 0.3])
SQUARE = np.diag([1.0, -1.0, -1.0])
SLIP = np.array([0.001, 0.0, 0.0])
LOOSE = ToolLimits(0.01, 0.01, 0.1)


async def teach_tool(made: ProcedureScene) -> tuple[ToolSetup, MemoryLedger]:
    ledger = MemoryLedger()
    return await six_point_tcp(Run(made.cell, ledger), made.spec), ledger


def hold_tip_at(made: ProcedureScene, rotation: np.ndarray, place_m: np.ndarray) -> Callable[[], None]:
    """Return hands that hold the tool's tip at a place, in an attitude of the flange."""
    pose = Pose.from_matrix(homogeneous_matrix(rotation, place_m - rotation @ np.array(TIP)))
    return lambda: setattr(made.arm, "taught", pose)


def rotation_of(x: float, y: float, z: float) -> np.ndarray:
    return SQUARE @ exp_rotation(np.radians([x, y, z]))


def step_keys(ledger: MemoryLedger) -> list[str]:
    return [finding.step for finding in ledger.past().findings]


@pytest.mark.parametrize(
    ("more", "moves"),
    [
        ({"method": "textbook"}, "xyz"),
        ({"method": "six_point_xz"}, "xz"),
        ({"method": "six_point_xz", "check_handedness": True}, "xzy"),
        ({"method": "six_point_xy"}, "xy"),
        ({"method": "three_plus_orientation"}, "xy"),
        ({"method": "three_plus_orientation", "check_handedness": True}, "xyz"),
        ({"method": "three_plus_orientation", "orientation": "world"}, ""),
        ({"method": "four_point"}, ""),
    ],
)
async def test_every_method_finds_the_tool_and_writes_it(more: dict[str, Any], moves: str) -> None:
    made = tool_touch_scene(**more)
    setup, ledger = await teach_tool(made)
    assert [step[-1] for step in step_keys(ledger) if step.startswith("move along")] == list(moves)
    expected_tool = Pose(TIP) if more["method"] == "four_point" else tool_pose()
    assert is_same_pose(setup.flange_tool, expected_tool)
    assert is_same_pose(made.arm.tools[3], expected_tool)
    assert setup.touches == sum(step.startswith("touch") for step in step_keys(ledger)) >= 4
    verdict = DEFINITION.verdict(made.spec, setup) if DEFINITION.verdict else None
    assert verdict is not None
    assert verdict.overall_decision == "pass"
    assert any(figure.name.startswith("handedness") for figure in verdict.characteristics) == (
        len(moves) == 3
    )


async def test_joints_of_a_robot_that_lost_its_position_are_not_taken() -> None:
    made = tool_touch_scene(method="four_point")
    made.arm.data = replace(made.arm.data, mastered=False)
    with pytest.raises(PositionLostAgainError, match="lost its position: not mastered"):
        await teach_tool(made)
    assert made.technician.instructions == ["pin_is_fixed"]

    made = tool_touch_scene(method="four_point")
    touch = made.technician.does["touch_2"]
    made.technician.does["touch_2"] = lambda: (touch(), made.arm.power_cycle())  # the battery was empty
    ledger = MemoryLedger()
    with pytest.raises(PositionLostAgainError, match="during this run"):
        await six_point_tcp(Run(made.cell, ledger), made.spec)
    assert sum(key.startswith("touch") for key in step_keys(ledger)) == 1


async def test_a_place_alone_leaves_the_axes_as_the_controller_has_them() -> None:
    made = tool_touch_scene(method="four_point")
    made.arm.tools[3] = Pose((0.1, 0.0, 0.0), (0.0, 1.0, 0.0, 0.0))
    setup, _ = await teach_tool(made)
    assert setup.flange_tool == Pose(setup.tip.tip_in_flange_m, (0.0, 1.0, 0.0, 0.0))
    assert setup.before == Pose((0.1, 0.0, 0.0), (0.0, 1.0, 0.0, 0.0))


async def test_attitudes_too_alike_are_taught_again_before_anything_is_computed() -> None:
    made = tool_touch_scene(limits=LOOSE)
    made.technician.does["touch_about_x"] = hold_tip_at(made, rotation_of(8, 0, 0), PIN)
    made.technician.does["touch_anew_2"] = hold_tip_at(made, rotation_of(60, 0, 0), PIN)
    setup, ledger = await teach_tool(made)
    names = step_keys(ledger)
    assert names.index("touch anew 1") == names.index("touch, turned about x") + 2
    assert is_same_pose(setup.flange_tool, tool_pose())
    (aside,) = setup.set_aside
    assert aside.step == "touch, turned about x"
    assert "turned only 8.0 degrees from touch 1" in aside.reason
    (judged,) = [f.value for f in ledger.past().findings if f.step == "judge the touches 2"]
    assert "15 degrees about +x" in judged["advice"]


async def test_three_touches_about_one_axis_are_not_enough() -> None:
    made = tool_touch_scene(limits=LOOSE)
    for key, degrees in (("touch_about_x", 40), ("touch_about_y", 80)):
        made.technician.does[key] = hold_tip_at(made, rotation_of(0, 0, degrees), PIN)
    made.technician.does["touch_anew_3"] = hold_tip_at(made, rotation_of(0, 50, 0), PIN)
    setup, _ = await teach_tool(made)
    assert is_same_pose(setup.flange_tool, tool_pose())
    assert "about nearly one axis" in setup.set_aside[0].reason


async def test_touches_without_a_turn_of_the_tool_are_refused() -> None:
    made = tool_touch_scene()
    made.technician.does["touch_about_x"] = lambda: None  # the arm stays where it is
    with pytest.raises(RefusalError, match=r"touch 2 is turned only 0\.0 degrees") as refused:
        await teach_tool(made)
    assert refused.value.remedy
    assert made.arm.writes == 0


async def test_a_stray_touch_is_named_and_taught_again() -> None:
    made = tool_touch_scene(min_touches=5)
    made.technician.does["touch_4"] = hold_tip_at(made, rotation_of(-40, -40, 0), PIN + SLIP)
    made.technician.does["touch_anew_4"] = hold_tip_at(made, rotation_of(-41, -40, 0), PIN)
    setup, _ = await teach_tool(made)
    assert is_same_pose(setup.flange_tool, tool_pose())
    (aside,) = setup.set_aside
    assert aside.step == "touch in another attitude 1"
    assert "the other touches contradict touch 4" in aside.reason


async def test_a_touch_that_stays_stray_ends_it_and_nothing_is_written() -> None:
    made = tool_touch_scene(min_touches=5)
    for key in ("touch_4", "touch_anew_4"):
        made.technician.does[key] = hold_tip_at(made, rotation_of(-40, -40, 0), PIN + SLIP)
    with pytest.raises(RefusalError, match="contradict touch 4"):
        await teach_tool(made)
    assert made.arm.writes == 0


def scatter_touches(made: ProcedureScene, sigma_m: float, seed: int) -> None:
    """Let the technician miss the pin by chance at every touch."""
    random = np.random.default_rng(seed)
    for key in [key for key in made.technician.does if key.startswith("touch")]:
        made.technician.does[key] = _touch_missing(
            made, made.technician.does[key], random.normal(scale=sigma_m, size=3)
        )


def _touch_missing(made: ProcedureScene, teach: Callable[[], object], by_m: np.ndarray) -> Callable[[], None]:
    def touch_beside() -> None:
        teach()
        assert made.arm.taught is not None
        x, y, z = np.array(made.arm.taught.position_m) + by_m
        made.arm.taught = Pose((float(x), float(y), float(z)), made.arm.taught.quaternion)

    return touch_beside


async def test_it_goes_on_until_the_class_holds_and_says_how_well_the_tip_is_known_meanwhile() -> None:
    coarse, fine = tool_touch_scene(accuracy_class="C"), tool_touch_scene(accuracy_class="B")
    for made in (coarse, fine):
        scatter_touches(made, 5e-5, seed=2)
    few, many = (await teach_tool(coarse))[0], (await teach_tool(fine))[0]
    assert few.touches < many.touches <= 8
    for setup, limit_m in ((few, 0.001), (many, 0.0004)):
        assert setup.tip.tip_u_in_space_m <= limit_m
        assert setup.fixed_plan_touches is not None
        assert setup.fixed_plan_touches > setup.touches
    verdict = DEFINITION.verdict(fine.spec, many) if DEFINITION.verdict else None
    assert verdict is not None
    assert f"{many.touches} touches" in verdict.remarks[0]


async def test_instructions_state_the_uncertainty_so_far_and_where_to_turn() -> None:
    made, instruction_texts = tool_touch_scene(), []
    confirm = made.technician.confirm

    async def note_instruction(instruction: Any) -> Any:
        instruction_texts.append(instruction.text)
        return await confirm(instruction)

    made.technician.confirm = note_instruction  # type: ignore[method-assign]
    await teach_tool(made)
    (fourth,) = [text for text in instruction_texts if "turn the tool 60 degrees about" in text]
    assert "mm by the attitudes and 0.00 mm by the touches' scatter (95 %)" in fourth


async def test_touches_that_never_agree_end_at_the_most() -> None:
    made = tool_touch_scene(max_touches=5, rms_limit_m=0.0002)
    scatter_touches(made, 1e-3, seed=4)
    with pytest.raises(OutOfToleranceError, match="disagree"):
        await teach_tool(made)
    assert made.arm.writes == 0


@pytest.mark.parametrize("method", ["six_point_xz", "six_point_xy", "three_plus_orientation"])
async def test_a_third_move_catches_one_that_went_backwards(method: Any) -> None:
    made = tool_touch_scene(method=method, check_handedness=True, limits=LOOSE)
    tool = tool_rotation()
    made.technician.does["along_x"] = hold_tip_at(made, SQUARE, PIN - SQUARE @ tool[:, 0] * 0.31)
    with pytest.raises(CalibrationError, match="left-handed"):
        await teach_tool(made)
    assert made.arm.writes == 0


async def test_the_plane_of_two_points_may_be_taught_at_a_slant() -> None:
    made = tool_touch_scene(method="three_plus_orientation", limits=LOOSE)
    tool = tool_rotation()
    slant = tool[:, 1] * 0.25 + tool[:, 0] * 0.2
    made.technician.does["along_y"] = hold_tip_at(made, SQUARE, PIN + SQUARE @ slant)
    setup, _ = await teach_tool(made)
    assert is_same_pose(setup.flange_tool, tool_pose())
    made = tool_touch_scene(method="three_plus_orientation", limits=LOOSE)
    made.technician.does["along_y"] = hold_tip_at(
        made, SQUARE, PIN + SQUARE @ (tool[:, 0] * 0.3 + tool[:, 1] * 0.03)
    )
    with pytest.raises(DegenerateDataError, match=r"open only 5\.7 degrees"):
        await teach_tool(made)


async def test_axes_are_judged_by_what_is_measured_and_what_the_technician_says_of_squareness() -> None:
    made = tool_touch_scene(method="six_point_xz")
    setup, _ = await teach_tool(made)
    assert DEFINITION.verdict is not None
    sure = DEFINITION.verdict(made.spec, setup).characteristics[1]
    unsure = DEFINITION.verdict(
        replace(made.spec, square_sigma_rad=math.radians(0.2)), setup
    ).characteristics[1]
    assert (sure.decision, unsure.decision) == ("pass", "undecided")
    assert unsure.expanded_uncertainty == pytest.approx(
        math.radians(0.2) * math.sqrt(7.8147), rel=1e-3
    )  # chi square, 3, 95 %


@pytest.mark.parametrize("method", ["textbook", "six_point_xz", "six_point_xy", "three_plus_orientation"])
async def test_the_turn_foretold_is_that_of_moves_as_long_as_asked_for(method: Any) -> None:
    made = tool_touch_scene(method=method, limits=LOOSE)
    setup, _ = await teach_tool(made)
    assert setup.axes is not None
    way = replace(made.spec.teaching_method, min_move_m=0.31)  # as the scene's technician moves
    gain = np.array(setup.axes.turn_gain_per_m2) * 2e-4**2
    k = coverage_in_space(np.linalg.eigvalsh(gain).tolist())
    assert axes_u(way, 2e-4, 0.0) == pytest.approx(k * math.sqrt(float(np.trace(gain))), rel=1e-6)


@pytest.mark.parametrize("method", ["textbook", "four_point", "three_plus_orientation", "six_point_xz"])
def test_more_touches_are_foretold_to_tell_more(method: Any) -> None:
    assert DEFINITION.forecast is not None
    few, many = (
        DEFINITION.forecast(SixPointTcp(1, method, max_touches=most, arm_sigma_m=0.0), Knowledge())
        .predictions[0]
        .expanded
        for most in (4, 12)
    )
    assert many < 0.5 * few


async def test_what_the_arm_itself_gets_wrong_stays_in_the_uncertainty_however_often_the_pin_is_touched() -> (
    None
):
    made = tool_touch_scene(min_touches=8, arm_sigma_m=0.0003)
    setup, _ = await teach_tool(made)
    assert setup.tip.rms_m < 1e-9  # the touches agree wholly
    assert setup.tip.tip_u_in_space_m == pytest.approx(arm_u(0.0003))
    assert arm_u(0.0003) == pytest.approx(0.0003 * math.sqrt(7.8147), rel=1e-4)  # chi square, 3, 95 %
    assert DEFINITION.verdict is not None
    verdict = DEFINITION.verdict(made.spec, setup)
    assert verdict.overall_decision == "undecided"
    (tip, *_) = verdict.characteristics
    assert "the arm's own errors alone (arm_sigma_m) leave 0.84 mm" in tip.rule
    assert sum(part.standard_uncertainty**2 for part in tip.budget) == pytest.approx(
        tip.standard_uncertainty**2
    )


async def test_touches_go_on_until_the_limit_also_covers_the_arm_error() -> None:
    ideal, drawn = (
        tool_touch_scene(accuracy_class="C"),
        tool_touch_scene(accuracy_class="C", arm_sigma_m=0.00034),
    )
    for made in (ideal, drawn):
        scatter_touches(made, 1e-4, seed=6)
    few, many = (await teach_tool(ideal))[0], (await teach_tool(drawn))[0]
    assert few.touches < many.touches
    assert arm_u(0.00034) < many.tip.tip_u_in_space_m <= 0.001
    assert DEFINITION.verdict is not None
    assert DEFINITION.verdict(drawn.spec, many).characteristics[0].decision == "pass"
