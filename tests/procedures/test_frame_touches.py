"""A user frame is touched until it is known; no further point is asked for where the limits are out of reach."""

from dataclasses import replace

import numpy as np
import pytest

from cellcal.calibration.geometry import Pose
from cellcal.calibration.points.frames import PointsDisagreeError
from cellcal.procedures.motion.active_frames import is_same_pose
from cellcal.procedures.run import Run
from cellcal.procedures.three_point_frame import DEFINITION, FrameSetup, ThreePointFrame, three_point_frame
from cellcal.procedures.verdict import UNDECIDED
from tests.procedures.memory_ledgers import MemoryLedger
from tests.procedures.procedure_scenes import FRAME, ProcedureScene, user_frame_scene


async def _teach_frame(made: ProcedureScene) -> tuple[FrameSetup, list[str]]:
    ledger = MemoryLedger()
    setup = await three_point_frame(Run(made.cell, ledger), made.spec)
    return setup, [finding.step for finding in ledger.past().findings if finding.step.startswith("touch")]


async def test_touches_go_on_until_the_frame_is_known_within_its_limits() -> None:
    made = user_frame_scene(accuracy_class="C", sigma_m=0.0007)
    setup, steps = await _teach_frame(made)
    assert is_same_pose(setup.taught.base_frame, FRAME)
    assert "touch the origin again 1" in steps
    assert setup.effort is not None
    assert setup.effort.touches == len(steps) - 1 < setup.effort.in_turn  # one was the point above
    assert 2.0 * max(setup.taught.origin_sigma_m) <= 0.001
    verdict = DEFINITION.verdict(made.spec, setup)  # type: ignore[misc]
    assert verdict.overall_decision.value == "pass"
    assert verdict.remarks == (setup.effort.saving_text,)
    assert f"would take {setup.effort.in_turn}" in verdict.remarks[0]


async def test_one_is_to_spare_where_three_are_enough_and_none_where_the_limits_are_out_of_reach() -> None:
    for made, says, count in (
        (user_frame_scene(sigma_m=0.0001), "no saving: 4 touches", 5),
        (
            user_frame_scene(accuracy_class="A"),
            "further ones were not asked for: 12 would leave the origin within 0.45 mm",
            4,
        ),
    ):
        setup, steps = await _teach_frame(replace(made, spec=replace(made.spec, write_anyway="a test")))
        assert len(steps) == count
        assert setup.effort is not None
        assert says in setup.effort.saving_text


async def test_three_touches_alone_never_pass_whatever_sigma_is_stated() -> None:
    made = user_frame_scene(sigma_m=1e-6, max_touches=3)
    made.spec = replace(made.spec, write_anyway="a test")
    setup, steps = await _teach_frame(made)
    assert len(steps) == 4
    verdict = DEFINITION.verdict(made.spec, setup)  # type: ignore[misc]
    assert verdict.overall_decision is UNDECIDED
    assert [one.name for one in verdict.characteristics if one.decision is UNDECIDED] == [
        "coordinates beyond those that fix the frame"
    ]


async def test_touches_that_scatter_more_than_stated_are_detected() -> None:
    """Class A for hands of a millimetre: the touch to spare contradicts the others, twice."""
    made = user_frame_scene(sigma_m=1e-6)
    good, rng = made.technician.does["touch_origin_again"], np.random.default_rng(7)

    def touch_with_scatter() -> None:
        good()
        taught = made.arm.taught
        assert taught is not None
        off = rng.normal(0.0, 1e-3, 3)
        x, y, z = np.add(taught.position_m, off).tolist()
        made.arm.taught = Pose((x, y, z), taught.quaternion)

    made.technician.does["touch_origin_again"] = touch_with_scatter
    with pytest.raises(PointsDisagreeError):
        await _teach_frame(made)


async def test_further_touches_are_taken_only_where_their_number_reaches_the_limits() -> None:
    few, many = (
        user_frame_scene(sigma_m=0.0002, max_touches=10),
        user_frame_scene(sigma_m=0.0002, max_touches=11),
    )
    few.spec = replace(few.spec, write_anyway="a test")
    assert len((await _teach_frame(few))[1]) == 4
    setup, steps = await _teach_frame(many)
    assert len(steps) > 9
    assert 2.0 * max(setup.taught.origin_sigma_m) <= 0.0003


async def test_a_contradicted_touch_is_made_anew_and_what_contradicts_again_is_refused() -> None:
    made = user_frame_scene(accuracy_class="C", sigma_m=0.0007)
    good = made.technician.does["touch_origin_again"]

    def touch_beside(times: list[int]) -> None:
        good()
        if times:
            times.pop()
            taught = made.arm.taught
            assert taught is not None
            made.arm.taught = Pose((taught.position_m[0] + 0.05, *taught.position_m[1:]), taught.quaternion)

    once = [1]
    made.technician.does["touch_origin_again"] = lambda: touch_beside(once)
    setup, steps = await _teach_frame(made)
    assert is_same_pose(setup.taught.base_frame, FRAME)
    assert "touch anew 1" in steps
    assert [one.step for one in setup.set_aside] == ["touch the origin again 1"]

    twice = [1, 1]
    made.technician.does["touch_origin_again"] = lambda: touch_beside(twice)
    made.arm.frames.clear()
    with pytest.raises(PointsDisagreeError):
        await _teach_frame(made)
    assert made.arm.frames == {}


def test_the_dry_run_states_how_many_touches_are_needed() -> None:
    spec = ThreePointFrame(
        frame_number=1, tip_in_flange_m=(0.0, 0.0, 0.1), accuracy_class="C", sigma_m=0.0007
    )
    forecast = DEFINITION.forecast(spec, None)  # type: ignore[misc,arg-type]
    steps = [
        step for phase in DEFINITION.outline(spec) for step in phase.step_names if step.startswith("touch")
    ]
    assert forecast.assumed[0].startswith(f"{len(steps)} points")
    assert len(steps) > 3
    assert all(np.isfinite(one.expanded) for one in forecast.predictions)
    named = {one.name: one.expanded for one in forecast.predictions}
    assert named[f"origin of the frame, after {len(steps)} touches"] <= 0.001  # the run ends there
    assert "origin of the frame, after 12 touches at most" in named


async def test_the_dry_run_foretells_what_the_run_states_also_where_the_limits_are_out_of_reach() -> None:
    made = user_frame_scene(accuracy_class="A", write_anyway="a test")
    setup, _ = await _teach_frame(made)
    forecast = DEFINITION.forecast(made.spec, None)  # type: ignore[misc,arg-type]
    origin = next(one for one in forecast.predictions if one.name == "origin of the frame, after 3 touches")
    assert origin.expanded == pytest.approx(2.0 * max(setup.taught.origin_sigma_m), rel=0.05)
