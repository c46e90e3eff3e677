"""What a drift check tells apart, and what it refuses."""

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import pytest

from cellcal.calibration.geometry import Pose
from cellcal.procedures.arm.drift_findings import DriftResult
from cellcal.procedures.drift_check import DEFINITION, DriftCheck, drift_check
from cellcal.procedures.forecast import Knowledge
from cellcal.procedures.run import Run
from tests.procedures.memory_ledgers import MemoryLedger
from tests.procedures.procedure_scenes import (
    LITTLE,
    ProcedureScene,
    drift_scene,
    healthy_scene,
    knocked_tool_scene,
)

FULL = replace(LITTLE, poses=6, candidates=100)


async def _check_drift(made: ProcedureScene) -> DriftResult:
    return await drift_check(Run(made.cell, MemoryLedger()), made.spec)


def _knock_hook(made: ProcedureScene) -> None:
    x, y, z = made.wire.hook_in_flange_m
    made.wire.hook_in_flange_m = (x + 0.001, y - 0.0008, z + 0.0005)


def _knock_target(made: ProcedureScene) -> None:
    device: Any = made.cell.tracker
    x, y, z = device.target_in_flange_m
    device.target_in_flange_m = (x + 0.001, y - 0.0008, z + 0.0005)


def _push_exit(made: ProcedureScene) -> None:
    x, y, z = made.wire.anchor_in_base_m
    made.wire.anchor_in_base_m = (x + 0.001, y + 0.001, z + 0.0015)


def _push_tripod(made: ProcedureScene) -> None:
    device: Any = made.cell.tracker
    x, y, z = device.base_tracker.position_m
    device.base_tracker = Pose((x + 0.001, y, z - 0.0005), device.base_tracker.quaternion)


def _lose_zero(axis: int) -> Callable[[ProcedureScene], None]:
    def shift_zero(made: ProcedureScene) -> None:
        zero = list(made.arm.true_zero)
        zero[axis] += 20_000
        made.arm.true_zero = tuple(zero)

    return shift_zero


def _warm_up(made: ProcedureScene) -> None:
    grown = made.arm.model.placements.copy()
    grown[:, :3, 3] *= 1.00012  # ten degrees

    class WarmArm:
        model = replace(made.arm.model, dh=None, placements=grown)

        @property
        def true_joints(self) -> Any:
            return made.arm.true_joints

    device: Any = made.cell.tracker
    device.arm = WarmArm()


@pytest.mark.parametrize(
    ("method", "happens", "cause"),
    [
        ("wire", _knock_hook, "tool"),
        ("wire", _push_exit, "device"),
        ("wire", _lose_zero(1), "J2"),
        ("wire", _lose_zero(2), "J3"),
        ("tracker", _knock_target, "tool"),
        ("tracker", _push_tripod, "device"),
        ("tracker", _warm_up, "warmth"),
        ("tracker", _lose_zero(0), "J1"),
        ("tracker", _lose_zero(4), "J5"),
    ],
)
async def test_what_happened_to_the_robot_is_named(
    method: Any, happens: Callable[[ProcedureScene], None], cause: str
) -> None:
    made = await drift_scene(method, rules=FULL)
    happens(made)
    result = await _check_drift(made)
    assert result.look is not None
    assert result.look.decided
    assert result.look.finding.likeliest_cause.name == cause
    assert result.look.finding.likeliest_cause.probability >= 0.9
    assert 4 <= len(result.measured) <= 6


@pytest.mark.parametrize("method", ["wire", "tracker"])
async def test_a_robot_to_which_nothing_happened_passes_after_four_poses(method: Any) -> None:
    result = await _check_drift(await drift_scene(method))
    assert result.look is not None
    assert not result.look.finding.has_changed
    assert len(result.measured) == 4
    assert result.recommended.startswith("nothing")
    assert DEFINITION.verdict is not None
    verdict = DEFINITION.verdict(DriftCheck(method), result)
    assert verdict.overall_decision == "pass"
    every = len(result.reference.poses_rad)
    assert every > 4
    assert f"4 poses; a fixed plan goes to all {every} of the reference" in verdict.remarks[-1]
    assert DEFINITION.results_to_store(DriftCheck(method), result) is None


async def test_a_cause_that_is_not_sure_gets_another_pose_and_else_is_left_open() -> None:
    made = await drift_scene(rules=FULL)
    _lose_zero(5)(made)  # the hook is near the last axis: nearly what a knocked tool does
    result = await _check_drift(made)
    assert result.look is not None
    assert len(result.measured) == 6
    assert not result.look.decided
    assert {one.name for one in result.look.finding.suspects[:3]} >= {"J6", "tool"}
    assert "J6" in result.recommended
    assert DEFINITION.verdict is not None
    verdict = DEFINITION.verdict(made.spec, result)
    assert verdict.overall_decision in ("fail", "undecided")
    assert verdict.remarks[-1] == "no saving: all 6 poses of the reference were needed"


async def test_a_knocked_tool_fails_and_says_what_to_run_next() -> None:
    made = await knocked_tool_scene()
    result = await _check_drift(made)
    assert DEFINITION.verdict is not None
    verdict = DEFINITION.verdict(made.spec, result)
    assert verdict.overall_decision == "fail"
    assert any("six_point_tcp" in words or "drift" in words or "Next" in words for words in verdict.remarks)


async def test_the_first_run_takes_the_reference_twice_and_keeps_it() -> None:
    made = healthy_scene(DriftCheck(rules=LITTLE))
    result = await _check_drift(made)
    assert result.taken_now
    assert len(result.reference.first_m) == len(result.reference.again_m) == LITTLE.poses
    stored_results = DEFINITION.results_to_store(made.spec, result)
    assert stored_results is not None
    assert stored_results.what == "drift_reference"


async def test_a_reference_that_does_not_repeat_is_refused() -> None:
    made = healthy_scene(DriftCheck(rules=LITTLE))
    made.wire.kink_m = {LITTLE.poses + 1: 0.01}
    with pytest.raises(Exception, match="two rounds differ at pose 2") as refused:
        await _check_drift(made)
    assert getattr(refused.value, "code", "") == "procedure.not_repeatable"


async def test_a_reference_of_another_mastering_is_refused_and_renewed_on_demand() -> None:
    made = await drift_scene()
    reference = replace(made.cell.drift_references[0], counts_at_zero=(1,) * 6)
    made.cell = replace(made.cell, drift_references=(reference,))
    with pytest.raises(Exception, match="another mastering") as refused:
        await _check_drift(made)
    assert getattr(refused.value, "code", "") == "procedure.reference_outdated"
    assert made.arm.moves == []
    made.spec = replace(made.spec, renew=True)
    assert (await _check_drift(made)).taken_now


def test_a_dry_run_names_poses_and_minutes() -> None:
    made = healthy_scene(DriftCheck(rules=LITTLE))
    assert DEFINITION.forecast is not None
    knowledge = Knowledge(
        made.cell.model, made.cell.gauge_setup, made.wire.capabilities, limits=made.cell.limits
    )
    forecast = DEFINITION.forecast(made.spec, knowledge)
    assert len(forecast.poses) == LITTLE.poses
    assert 0 < forecast.duration_s < 3600
    assert DEFINITION.forecast(DriftCheck("tracker"), knowledge).lacks
