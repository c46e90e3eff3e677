"""What an accuracy check finds, and what it calls itself."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from cellcal.calibration.accuracy import REDUCED_TITLE, AccuracyTest
from cellcal.calibration.errors import DegenerateDataError
from cellcal.calibration.line_accuracy import LineTest
from cellcal.calibration.poses.calibrated_arm import CalibratedArm, FoundParameter
from cellcal.procedures.accuracy_check import DEFINITION, AccuracyResult, accuracy_check
from cellcal.procedures.accuracy_limits import PoseLimits
from cellcal.procedures.forecast import Knowledge
from cellcal.procedures.run import Run
from tests.procedures.memory_ledgers import MemoryLedger
from tests.procedures.procedure_scenes import QUICK_ROUND, ZERO, ProcedureScene, round_trip_scene

OFFSET_RAD = 0.002


async def _check_accuracy(made: ProcedureScene) -> AccuracyResult:
    return await accuracy_check(Run(made.cell, MemoryLedger()), made.spec)


def _off_by_a_zero(made: ProcedureScene) -> CalibratedArm:
    """Turn the third joint's truth against what is shown, and return the parameters that say so."""
    change = np.linalg.solve(np.array(made.arm.drive.radians_per_count), [0, 0, OFFSET_RAD, 0, 0, 0])
    made.arm.true_zero = tuple(int(z - c) for z, c in zip(ZERO, np.rint(change), strict=True))
    coupled = made.arm.model.joint_coupling @ np.array([0, 0, OFFSET_RAD, 0, 0, 0])
    found = tuple(
        FoundParameter(f"J{k + 1} offset", "rad", float(v), 1e-5, 1e-2, "offset")
        for k, v in enumerate(coupled)
    )
    return CalibratedArm("F-1", "fanuc_m6ib", ZERO, "tracker", found, (0.08, 0.04, 0.1), ())


@pytest.mark.parametrize("method", ["tracker", "wire"])
async def test_a_perfect_robot_is_as_accurate_as_its_device_can_tell(method: Any) -> None:
    made = round_trip_scene(
        method, rules=replace(QUICK_ROUND, placing=20)
    )  # ten readings leave the device open
    result = await _check_accuracy(made)
    assert result.identified is None
    assert len(result.nominal.poses) == 5
    assert result.nominal.ap_m < 3e-4
    assert all(pose.ap_m < 3 * pose.ap_sigma_m for pose in result.nominal.poses)
    assert result.nominal.rp_m < 1e-4
    assert DEFINITION.verdict is not None
    assert DEFINITION.verdict(made.spec, result).overall_decision == "pass"


async def test_a_reduced_test_is_titled_so_and_says_what_it_departs_in() -> None:
    made = round_trip_scene()
    result = await _check_accuracy(made)
    assert isinstance(result.nominal, AccuracyTest)
    assert result.title == REDUCED_TITLE
    assert DEFINITION.verdict is not None
    not_verified = " ".join(DEFINITION.verdict(made.spec, result).not_verified)
    assert "2 cycles instead of 30" in not_verified
    assert "rated load" in not_verified


async def test_a_wire_tells_one_direction_and_the_title_admits_it() -> None:
    result = await _check_accuracy(round_trip_scene("wire"))
    assert isinstance(result.nominal, LineTest)
    assert "one direction only" in result.title
    assert "not a test to ISO 9283" in result.title


async def test_the_identified_model_is_judged_from_the_same_readings() -> None:
    made = round_trip_scene(limits=PoseLimits(0.0005, 0.0003))
    made.cell = replace(made.cell, calibrated=_off_by_a_zero(made))
    result = await _check_accuracy(made)
    assert result.identified is not None
    assert result.nominal.ap_m > 3 * result.identified.ap_m
    assert DEFINITION.verdict is not None
    verdict = DEFINITION.verdict(made.spec, result)
    assert verdict.overall_decision == "pass"
    assert verdict.changes[0].before == result.nominal.ap_m
    made.cell = replace(made.cell, calibrated=None)
    assert DEFINITION.verdict(made.spec, await _check_accuracy(made)).overall_decision != "pass"


async def test_parameters_of_another_mastering_are_not_used() -> None:
    made = round_trip_scene()
    arm = replace(_off_by_a_zero(made), counts_at_zero=(0,) * 6)
    made.cell = replace(made.cell, calibrated=arm)
    assert (await _check_accuracy(made)).identified is None


async def test_a_cube_out_of_reach_is_refused_before_anything_moves() -> None:
    made = round_trip_scene(rules=replace(QUICK_ROUND, centre_m=(4.0, 0.0, 0.5)))
    with pytest.raises(DegenerateDataError, match="no cube about"):
        await _check_accuracy(made)
    assert made.arm.moves == []


def test_a_dry_run_knows_the_five_poses() -> None:
    made = round_trip_scene("wire")
    assert DEFINITION.forecast is not None
    knowledge = Knowledge(
        made.cell.model, made.cell.gauge_setup, made.wire.capabilities, limits=made.cell.limits
    )
    assert [pose.label for pose in DEFINITION.forecast(made.spec, knowledge).poses] == [
        "P1",
        "P2",
        "P3",
        "P4",
        "P5",
    ]
    assert DEFINITION.forecast(made.spec, Knowledge()).lacks
