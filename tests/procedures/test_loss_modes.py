"""Every way to lose a position is told apart by the data: memory, turns, motors, everything, the wrong record."""

from dataclasses import replace

import numpy as np
import pytest

from cellcal.drivers.interfaces import MasteringData
from cellcal.procedures.mastering_recovery import MasteringRecoverySpec, mastering_recovery
from cellcal.procedures.recovery.record_seal import seal_record
from cellcal.procedures.recovery.recovery_result import RecoveryResult
from cellcal.procedures.run import DeclinedError, RefusalError, Run
from cellcal.procedures.steps.motion import CountsToJoints
from tests.procedures.ideal_devices import COUNTS, ZERO
from tests.procedures.memory_ledgers import MemoryLedger
from tests.procedures.place_technician import record_at_once
from tests.procedures.procedure_scenes import ProcedureScene, healthy_scene

HERE = np.array([0.2, 0.1, -0.3, 0.4, 0.5, -0.6])


async def _healthy_scene() -> ProcedureScene:
    record = await record_at_once(healthy_scene())
    made = healthy_scene()
    made.arm.write_program(HERE)
    made.cell = replace(made.cell, record=record)
    made.spec = MasteringRecoverySpec(last_counts=await made.arm.encoder_counts(), samples=2)
    return made


async def _run_recovery(
    made: ProcedureScene, ledger: MemoryLedger | None = None
) -> tuple[RecoveryResult, list[str]]:
    """Recover, or go on with what a run that ended early has in its ledger."""
    ledger = ledger or MemoryLedger()
    result = await mastering_recovery(Run(made.cell, ledger, ledger.past()), made.spec)
    return result, [finding.step for finding in ledger.past().findings]


def _shift_zeros(made: ProcedureScene, fractions: tuple[float, ...]) -> None:
    """Give motors new zeros without a word: what they read is off by fractions of a turn."""
    made.arm.true_zero = tuple(
        zero - round(COUNTS * part) for zero, part in zip(made.arm.true_zero, fractions, strict=True)
    )
    made.arm.write_program(HERE)


async def test_a_controller_that_forgot_gets_its_record_back_after_a_few_checks() -> None:
    made = await _healthy_scene()
    made.arm.data = MasteringData((0,) * 6, mastered=False)
    result, steps = await _run_recovery(made)
    assert (result.verdict, result.mode) == ("restored", "memory")
    assert made.arm.data == MasteringData(ZERO, mastered=True)
    assert not any(step.startswith("capture") for step in steps)
    assert 4 <= result.check_captures <= 8
    assert result.captures == 0
    assert all(check.passed for check in result.gate)


async def test_a_robot_that_forgot_and_was_moved_meanwhile_is_known_all_the_same() -> None:
    made = await _healthy_scene()
    made.arm.write_program(HERE + np.array([0.4, -0.2, 0.1, 0.9, -0.3, 1.2]))
    made.arm.data = MasteringData((0,) * 6, mastered=False)
    result, _ = await _run_recovery(made)
    assert (result.verdict, result.mode) == ("restored", "memory")


@pytest.mark.parametrize("axis", range(6))
async def test_a_backup_with_a_wrong_zero_is_put_right(axis: int) -> None:
    made = await _healthy_scene()
    wrong = tuple(zero + 200_000 * (j == axis) for j, zero in enumerate(ZERO))
    made.arm.data = MasteringData(wrong, mastered=True)
    result, _ = await _run_recovery(made)
    assert (result.mode, made.arm.data.counts_at_zero) == ("memory", ZERO)


async def test_a_new_j6_that_a_moved_hook_explains_as_well_is_not_taken_without_a_report() -> None:
    made = await _healthy_scene()
    _shift_zeros(made, (0.0, 0.0, 0.0, 0.0, 0.0, 0.3))
    made.arm.data = MasteringData((0,) * 6, mastered=False)
    with pytest.raises(RefusalError, match=r"the reference of J6 is new.*or .*the wire is not as recorded"):
        await _run_recovery(made)
    assert not made.arm.data.mastered


@pytest.mark.parametrize("axis", [0, 2])
async def test_a_fraction_of_a_turn_is_no_lost_memory(axis: int) -> None:
    made = await _healthy_scene()
    _shift_zeros(made, tuple(0.3 * (j == axis) for j in range(6)))
    made.arm.data = MasteringData((0,) * 6, mastered=False)
    result, steps = await _run_recovery(made)
    assert (result.verdict, result.mode) == ("restored", "motor")
    assert any(step.startswith("memory check") for step in steps)
    assert [joint.exact for joint in result.joints] == [j != axis for j in range(6)]
    wrong = np.array(result.counts_at_zero) - np.array(made.arm.true_zero)
    off = np.abs(np.array(made.arm.drive.radians_per_count) @ wrong)
    assert (off <= 1.5 * np.array([joint.offset_u_rad for joint in result.joints]) + 1e-9).all()


async def test_turns_lost_without_any_alarm_are_found_after_the_memory_was_ruled_out() -> None:
    made = await _healthy_scene()
    made.arm.lost_turns = (0, 1, 0, 0, 0, -1)
    made.arm.data = MasteringData(ZERO, mastered=False)
    result, _ = await _run_recovery(made)
    assert (result.verdict, result.mode) == ("restored", "turns")
    assert [joint.turns_restored for joint in result.joints] == [0, 1, 0, 0, 0, -1]


async def test_a_record_older_than_the_mastering_is_refused() -> None:
    made = await _healthy_scene()
    _shift_zeros(made, (0.0, 0.0, 0.37, 0.0, 0.0, 0.0))
    made.arm.data = MasteringData(made.arm.true_zero, mastered=True)
    with pytest.raises(RefusalError, match="controller holds, and not with the record") as refused:
        await _run_recovery(made)
    assert refused.value.code == "procedure.wrong_record"
    assert made.arm.writes == 0


async def test_an_arm_with_every_zero_elsewhere_has_its_plate_looked_at() -> None:
    made = await _healthy_scene()
    _shift_zeros(made, (0.31, 0.44, -0.37, 0.29, 0.46, -0.33))
    made.arm.data = MasteringData(ZERO, mastered=False)
    made.technician.refuses = {"compare_plate"}
    ledger = MemoryLedger()
    with pytest.raises(DeclinedError, match="another arm"):
        await _run_recovery(made, ledger)
    assert made.arm.writes == 0
    made.technician.refuses = set()
    result, _ = await _run_recovery(made, MemoryLedger(ledger.facts))
    assert result.mode == "all"


async def test_a_record_of_another_robot_and_a_clone_of_the_controller_are_refused() -> None:
    made = await _healthy_scene()
    assert made.cell.record is not None
    other = seal_record(replace(made.cell.record, robot_serial="F-2"))
    made.cell = replace(made.cell, record=other)
    with pytest.raises(RefusalError, match="record is of robot F-2") as refused:
        await _run_recovery(made)
    assert refused.value.code == "procedure.wrong_record"


async def test_counts_mean_joints_by_the_record_s_zero() -> None:
    made = await _healthy_scene()
    mapping = CountsToJoints(made.arm.drive, ZERO, (0,) * 6)
    assert np.allclose(mapping.joints_at(await made.arm.encoder_counts()), HERE, atol=1e-5)
