"""What the procedures find in cells whose truth is known, and what they refuse."""

from dataclasses import replace

import numpy as np
import pytest

from cellcal.calibration.errors import CalibrationError
from cellcal.calibration.geometry import Pose
from cellcal.drivers.interfaces import MasteringData
from cellcal.procedures.cell import Cell
from cellcal.procedures.mastering_record import mastering_record
from cellcal.procedures.mastering_recovery import DEFINITION, MasteringRecoverySpec, mastering_recovery
from cellcal.procedures.motion.active_frames import is_same_pose
from cellcal.procedures.motors import PositionLostAgainError
from cellcal.procedures.procedure_definition import missing_needs
from cellcal.procedures.recovery.record_seal import seal_of
from cellcal.procedures.recovery.record_verdict import RecordResult
from cellcal.procedures.recovery.recovery_result import RecoveryResult
from cellcal.procedures.run import DeclinedError, OutOfToleranceError, RefusalError, Run
from cellcal.procedures.six_point_tcp import SixPointTcp, six_point_tcp
from cellcal.procedures.steps.capture import NotAtRestError, capture_still
from cellcal.procedures.steps.write import ReadBackError
from cellcal.procedures.three_point_frame import three_point_frame
from tests.procedures.ideal_devices import COUNTS, IdealArm, ScriptedTechnician
from tests.procedures.memory_ledgers import MemoryLedger
from tests.procedures.procedure_scenes import (
    FRAME,
    LOST,
    ProcedureScene,
    healthy_scene,
    record_of,
    recording_scene,
    recovery_scene,
    tool_pose,
    tool_touch_scene,
    user_frame_scene,
)


async def _run_recovery(made: ProcedureScene) -> RecoveryResult:
    return await mastering_recovery(Run(made.cell, MemoryLedger()), made.spec)


async def _refusal_of(made: ProcedureScene) -> RefusalError:
    with pytest.raises(RefusalError) as refused:
        await _run_recovery(made)
    assert made.arm.writes == 0
    return refused.value


async def test_six_points_find_the_tool_and_write_it() -> None:
    made = tool_touch_scene()
    setup = await six_point_tcp(Run(made.cell, MemoryLedger()), made.spec)
    assert is_same_pose(setup.flange_tool, tool_pose())
    assert is_same_pose(made.arm.tools[3], tool_pose())
    assert setup.tip.rms_m < 1e-12
    assert made.arm.moves == []  # the technician moves, not we


async def test_a_pin_that_moved_is_a_result_with_a_remedy_and_nothing_is_written() -> None:
    made = tool_touch_scene(max_touches=3)
    teach = made.technician.does["touch_about_y"]

    def touch_moved_pin() -> None:
        teach()
        taught = made.arm.taught
        assert taught is not None
        x, y, z = taught.position_m
        made.arm.taught = Pose((x + 0.004, y, z), taught.quaternion)

    made.technician.does["touch_about_y"] = touch_moved_pin
    with pytest.raises(OutOfToleranceError, match="disagree") as found:
        await six_point_tcp(Run(made.cell, MemoryLedger()), made.spec)
    assert found.value.found > found.value.limit == SixPointTcp(3).rms_limit_m
    assert made.arm.writes == 0


async def test_a_declined_result_is_not_written() -> None:
    made = tool_touch_scene()
    made.technician.refuses = {"accept_tool"}
    with pytest.raises(DeclinedError):
        await six_point_tcp(Run(made.cell, MemoryLedger()), made.spec)
    assert made.arm.writes == 0


async def test_three_points_find_the_frame_and_write_it() -> None:
    made = user_frame_scene()
    setup = await three_point_frame(Run(made.cell, MemoryLedger()), made.spec)
    assert is_same_pose(setup.taught.base_frame, FRAME)
    assert is_same_pose(made.arm.frames[2], FRAME)
    assert 0 < max(setup.taught.origin_sigma_m) < 0.001


async def test_points_taught_in_the_wrong_order_are_refused() -> None:
    made = user_frame_scene()
    does = made.technician.does
    does["touch_on_x"], does["touch_on_xy"] = does["touch_on_xy"], does["touch_on_x"]
    with pytest.raises(CalibrationError):
        await three_point_frame(Run(made.cell, MemoryLedger()), made.spec)


async def test_a_frame_that_reads_otherwise_than_written_is_an_error() -> None:
    made = user_frame_scene()

    class ForgetfulArm(IdealArm):
        async def write_user_frame(self, number: int, base_user: Pose) -> Pose:
            return Pose((0.0, 0.0, 0.0))

    arm = ForgetfulArm()
    made.technician.does = {k: (lambda k=k: (pointing_at(made, k), setattr(arm, "taught", made.arm.taught)))
                       for k in list(made.technician.does)}  # fmt: skip
    cell = replace(made.cell, robot=arm, user_frames=arm)
    with pytest.raises(ReadBackError):
        await three_point_frame(Run(cell, MemoryLedger()), made.spec)


def pointing_at(made: ProcedureScene, key: str) -> None:
    """Do what the technician of an ordinary pointing scene does."""
    ordinary = user_frame_scene()
    if key in ordinary.technician.does:
        ordinary.technician.does[key]()
        made.arm.taught = ordinary.arm.taught


async def test_a_record_is_sealed_and_promises_a_recovery() -> None:
    made = recording_scene()
    result: RecordResult = await mastering_record(Run(made.cell, MemoryLedger()), made.spec)
    assert result.record.sha256 == seal_of(result.record)
    assert result.record.sha256 != seal_of(replace(result.record, epoch=99))
    assert result.record.robot_serial == "F-1"
    assert result.prospect.success_probability > 0.9999
    anchor_error = np.subtract(result.record.wire.anchor_in_base_m, made.wire.anchor_in_base_m)
    assert np.linalg.norm(anchor_error) < 0.003
    assert {move.split()[0] for move in made.arm.moves} == {"move"}


async def test_a_record_of_a_robot_that_is_not_mastered_is_refused_before_it_moves() -> None:
    made = recording_scene()
    made.arm.data = MasteringData(made.arm.data.counts_at_zero, mastered=False)
    with pytest.raises(RefusalError):
        await mastering_record(Run(made.cell, MemoryLedger()), made.spec)
    assert made.arm.moves == []


async def test_one_wrong_length_in_a_record_is_taken_again() -> None:
    made = recording_scene()
    made.wire.kink_m = {2 * 7: 0.02, 2 * 7 + 1: 0.02}  # both samples of the eighth capture
    ledger = MemoryLedger()
    result = await mastering_record(Run(made.cell, ledger), made.spec)
    assert ledger.event_kinds("capture again 1") == ["step_entered", "finding"]
    assert result.record.captures[7].label == "pose 8, again"
    assert result.record.wire.is_consistent()


async def test_lost_turns_come_back_exactly_and_the_new_record_serves_the_next_loss() -> None:
    made = await recovery_scene()
    result = await _run_recovery(made)
    assert (result.verdict, result.mode) == ("restored", "turns")
    assert tuple(joint.turns_restored for joint in result.joints) == LOST
    assert all(joint.exact and joint.offset_u_rad == 0.0 for joint in result.joints)
    believed = (await made.arm.read_joints()).joints_rad
    assert np.allclose(believed, made.arm.true_joints, atol=1e-12)
    assert made.arm.data.mastered
    assert result.record is not None
    assert result.record.sha256 == seal_of(result.record)

    last = await made.arm.encoder_counts()
    made.arm.lose_encoders((0, 2, 0, -1, 0, 1))
    made.cell = replace(made.cell, record=result.record)
    made.spec = MasteringRecoverySpec(last_counts=last, samples=2)
    again = await _run_recovery(made)
    assert tuple(joint.turns_restored for joint in again.joints) == (0, 2, 0, -1, 0, 1)


async def test_without_the_last_counts_the_arm_is_brought_near_its_reference() -> None:
    made = await recovery_scene()
    made.technician.does["at_reference"] = lambda: made.arm.write_program(np.full(6, 0.01))
    made.spec = replace(made.spec, last_counts=None)
    result = await _run_recovery(made)
    assert tuple(joint.turns_restored for joint in result.joints) == LOST


async def test_an_exchanged_motor_is_restored_within_its_stated_uncertainty() -> None:
    made = await recovery_scene((1, -2, 0, 0, 1, -1))
    _exchange_motors(made, {2: 123_456})
    result = await _run_recovery(made)
    assert (result.verdict, result.mode) == ("restored", "motor")
    assert [joint.exact for joint in result.joints] == [True, True, False, True, True, True]
    errors = np.abs(np.subtract((await made.arm.read_joints()).joints_rad, made.arm.true_joints))
    assert errors[2] <= result.joints[2].offset_u_rad < np.deg2rad(0.1)
    assert max(errors[[0, 1, 3]]) < 1e-12


async def test_a_wire_caught_in_one_capture_is_measured_again() -> None:
    made = await recovery_scene()
    made.wire.kink_m = {8: 0.02, 9: 0.02}  # the fifth capture
    result = await _run_recovery(made)
    assert (result.verdict, result.measured_again) == ("restored", 1)
    assert tuple(joint.turns_restored for joint in result.joints) == LOST


async def test_a_moved_anchor_is_refused_and_nothing_is_written() -> None:
    made = await recovery_scene()
    made.wire.anchor_in_base_m = (0.93, -0.69, -0.44)
    refused = await _refusal_of(made)
    assert refused.code == "procedure.geometry_changed"
    assert isinstance(refused.evidence, RecoveryResult)
    assert refused.evidence.verdict == "refused"
    assert "calibration" in refused.remedy


async def test_too_few_captures_are_refused_with_the_poses_still_needed() -> None:
    made = await recovery_scene()
    made.spec = replace(made.spec, first_captures=5, max_captures=6)
    refused = await _refusal_of(made)
    assert refused.code == "procedure.undecided"
    assert isinstance(refused.evidence, RecoveryResult)
    assert refused.evidence.poses_needed > 0


async def test_no_record_or_another_robots_record_is_refused_before_anything_moves() -> None:
    made = await recovery_scene()
    record = await record_of(made)
    for other in (None, replace(record, robot_serial="F-2")):
        made.cell = replace(made.cell, record=other)
        await _refusal_of(made)
    assert made.arm.moves == []


async def test_check_poses_that_disagree_stop_the_correction() -> None:
    made = await recovery_scene()
    made.wire.kink_m = dict.fromkeys(range(24, 26), 0.05)  # the first check after twelve captures
    refused = await _refusal_of(made)
    assert refused.code == "procedure.not_confirmed"


async def test_a_mastering_that_fails_its_last_check_is_taken_back() -> None:
    made = await recovery_scene()
    before = made.arm.data.counts_at_zero
    made.technician.does["accept_mastering"] = lambda: made.wire.kink_m.update(
        dict.fromkeys(range(made.wire.readings, made.wire.readings + 4), 0.05)
    )
    with pytest.raises(RefusalError) as refused:
        await _run_recovery(made)
    assert refused.value.code == "procedure.not_confirmed"
    assert made.arm.data == MasteringData(before, mastered=False)  # as unmastered as it was


async def test_a_second_loss_in_the_middle_ends_the_run() -> None:
    made, ledger = await recovery_scene(), MemoryLedger()
    made.technician.refuses = {"accept_mastering"}
    with pytest.raises(DeclinedError):
        await mastering_recovery(Run(made.cell, ledger), made.spec)
    made.arm.epoch += 1
    with pytest.raises(PositionLostAgainError):
        await mastering_recovery(Run(made.cell, MemoryLedger(ledger.facts), ledger.past()), made.spec)


async def test_every_joint_comes_to_rest_from_the_same_side() -> None:
    made = await recovery_scene()
    last: dict[int, float] = {}
    jog = made.arm.jog_axis

    async def jog_watched(axis: int, delta_rad: float, *, speed_rad_s: float) -> None:
        last[axis] = delta_rad
        assert speed_rad_s <= made.cell.limits.jog_speed_rad_s
        await jog(axis, delta_rad, speed_rad_s=speed_rad_s)

    sides: list[bool] = []
    distance = made.wire.read_distance

    async def read_watched() -> object:
        sides.append(all(delta > 0 for delta in last.values()) or made.arm.moves[-1] == "move")
        return await distance()

    made.arm.jog_axis, made.wire.read_distance = jog_watched, read_watched  # type: ignore[method-assign]
    await _run_recovery(made)
    assert len(sides) > 20
    assert all(sides)


async def test_a_capture_of_a_moving_arm_is_refused() -> None:
    made = healthy_scene()
    distance = made.wire.read_distance

    async def read_drifting() -> object:
        made.arm.true_counts = tuple(count + COUNTS // 100 for count in made.arm.true_counts)
        return await distance()

    made.wire.read_distance = read_drifting  # type: ignore[method-assign]
    with pytest.raises(NotAtRestError):
        await capture_still(made.cell, "pose 1", 3, 50)


def test_the_refusal_names_what_a_cell_lacks() -> None:
    assert missing_needs(DEFINITION, Cell("bare", IdealArm(), ScriptedTechnician())) == (
        "access to encoder counts and mastering",
        "a draw-wire, touch probe or tracker, or a record with touched places or a seat",
        "a kinematic model of the robot",
    )


def _exchange_motors(made: ProcedureScene, shifts: dict[int, int]) -> None:
    """Exchange motors: the new encoder counts from elsewhere, the arm stays where it is."""
    arm = made.arm
    arm.true_zero = tuple(zero + shifts.get(axis, 0) for axis, zero in enumerate(arm.true_zero))
    arm.true_counts = tuple(count + shifts.get(axis, 0) for axis, count in enumerate(arm.true_counts))
