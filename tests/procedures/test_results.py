"""What the procedures find in cells whose truth is known, and what they refuse."""

from dataclasses import replace

import numpy as np
import pytest

from cellcal.calibration.errors import CalibrationError
from cellcal.calibration.geometry import Pose
from cellcal.drivers.interfaces import MasteringData
from cellcal.procedures.cell import Cell
from cellcal.procedures.mastering_record import RecordResult, mastering_record
from cellcal.procedures.mastering_recovery import DEFINITION, MasteringRecoverySpec, mastering_recovery
from cellcal.procedures.motion.active_frames import is_same_pose
from cellcal.procedures.motors import PositionLostAgainError
from cellcal.procedures.procedure_definition import missing_needs
from cellcal.procedures.recovery.record_seal import seal_of
from cellcal.procedures.recovery.recovery_result import RecoveryResult
from cellcal.procedures.run import DeclinedError, OutOfToleranceError, RefusalError, Run
from cellcal.procedures.six_point_tcp import SixPointTcp, six_point_tcp
from cellcal.procedures.steps.capture import NotAtRestError, capture_still
from cellcal.procedures.steps.write import ReadBackError
from cellcal.procedures.three_point_frame import three_point_frame
from tests.procedures.cells import (
    FRAME,
    LOST,
    Scene,
    pointing,
    record_of,
    recording,
    recovering,
    scene,
    tool_pose,
    touching,
)
from tests.procedures.ideal import COUNTS, Hands, IdealArm
from tests.procedures.ledgers import MemoryLedger


async def _recover(made: Scene) -> RecoveryResult:
    return await mastering_recovery(Run(made.cell, MemoryLedger()), made.spec)


async def _refusal(made: Scene) -> RefusalError:
    with pytest.raises(RefusalError) as refused:
        await _recover(made)
    assert made.arm.writes == 0
    return refused.value


async def test_six_points_find_the_tool_and_write_it() -> None:
    made = touching()
    setup = await six_point_tcp(Run(made.cell, MemoryLedger()), made.spec)
    assert is_same_pose(setup.flange_tool, tool_pose())
    assert is_same_pose(made.arm.tools[3], tool_pose())
    assert setup.tip.rms_m < 1e-12
    assert made.arm.moves == []  # the technician moves, not we


async def test_a_pin_that_moved_is_a_result_with_a_remedy_and_nothing_is_written() -> None:
    made = touching(max_touches=3)
    teach = made.hands.does["touch_about_y"]

    def moved() -> None:
        teach()
        taught = made.arm.taught
        assert taught is not None
        x, y, z = taught.position_m
        made.arm.taught = Pose((x + 0.004, y, z), taught.quaternion)

    made.hands.does["touch_about_y"] = moved
    with pytest.raises(OutOfToleranceError, match="disagree") as found:
        await six_point_tcp(Run(made.cell, MemoryLedger()), made.spec)
    assert found.value.found > found.value.limit == SixPointTcp(3).rms_limit_m
    assert made.arm.writes == 0


async def test_a_declined_result_is_not_written() -> None:
    made = touching()
    made.hands.refuses = {"accept_tool"}
    with pytest.raises(DeclinedError):
        await six_point_tcp(Run(made.cell, MemoryLedger()), made.spec)
    assert made.arm.writes == 0


async def test_three_points_find_the_frame_and_write_it() -> None:
    made = pointing()
    setup = await three_point_frame(Run(made.cell, MemoryLedger()), made.spec)
    assert is_same_pose(setup.taught.base_frame, FRAME)
    assert is_same_pose(made.arm.frames[2], FRAME)
    assert 0 < max(setup.taught.origin_sigma_m) < 0.001


async def test_points_taught_in_the_wrong_order_are_refused() -> None:
    made = pointing()
    does = made.hands.does
    does["touch_on_x"], does["touch_on_xy"] = does["touch_on_xy"], does["touch_on_x"]
    with pytest.raises(CalibrationError):
        await three_point_frame(Run(made.cell, MemoryLedger()), made.spec)


async def test_a_frame_that_reads_otherwise_than_written_is_an_error() -> None:
    made = pointing()

    class Forgetful(IdealArm):
        async def write_user_frame(self, number: int, base_user: Pose) -> Pose:
            return Pose((0.0, 0.0, 0.0))

    arm = Forgetful()
    made.hands.does = {k: (lambda k=k: (pointing_at(made, k), setattr(arm, "taught", made.arm.taught)))
                       for k in list(made.hands.does)}  # fmt: skip
    cell = replace(made.cell, robot=arm, user_frames=arm)
    with pytest.raises(ReadBackError):
        await three_point_frame(Run(cell, MemoryLedger()), made.spec)


def pointing_at(made: Scene, key: str) -> None:
    """Do what the technician of an ordinary pointing scene does."""
    ordinary = pointing()
    if key in ordinary.hands.does:
        ordinary.hands.does[key]()
        made.arm.taught = ordinary.arm.taught


async def test_a_record_is_sealed_and_promises_a_recovery() -> None:
    made = recording()
    result: RecordResult = await mastering_record(Run(made.cell, MemoryLedger()), made.spec)
    assert result.record.sha256 == seal_of(result.record)
    assert result.record.sha256 != seal_of(replace(result.record, epoch=99))
    assert result.record.robot_serial == "F-1"
    assert result.prospect.success_probability > 0.9999
    anchor_error = np.subtract(result.record.wire.anchor_in_base_m, made.wire.anchor_in_base_m)
    assert np.linalg.norm(anchor_error) < 0.003
    assert {move.split()[0] for move in made.arm.moves} == {"move"}


async def test_a_record_of_a_robot_that_is_not_mastered_is_refused_before_it_moves() -> None:
    made = recording()
    made.arm.data = MasteringData(made.arm.data.counts_at_zero, mastered=False)
    with pytest.raises(RefusalError):
        await mastering_record(Run(made.cell, MemoryLedger()), made.spec)
    assert made.arm.moves == []


async def test_one_wrong_length_in_a_record_is_taken_again() -> None:
    made = recording()
    made.wire.kink_m = {2 * 7: 0.02, 2 * 7 + 1: 0.02}  # both samples of the eighth capture
    ledger = MemoryLedger()
    result = await mastering_record(Run(made.cell, ledger), made.spec)
    assert ledger.kinds("capture again 1") == ["step_entered", "finding"]
    assert result.record.captures[7].label == "pose 8, again"
    assert result.record.wire.is_consistent()


async def test_lost_turns_come_back_exactly_and_the_new_record_serves_the_next_loss() -> None:
    made = await recovering()
    result = await _recover(made)
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
    again = await _recover(made)
    assert tuple(joint.turns_restored for joint in again.joints) == (0, 2, 0, -1, 0, 1)


async def test_without_the_last_counts_the_arm_is_brought_near_its_reference() -> None:
    made = await recovering()
    made.hands.does["at_reference"] = lambda: made.arm.write_program(np.full(6, 0.01))
    made.spec = replace(made.spec, last_counts=None)
    result = await _recover(made)
    assert tuple(joint.turns_restored for joint in result.joints) == LOST


async def test_an_exchanged_motor_is_restored_within_its_stated_uncertainty() -> None:
    made = await recovering((1, -2, 0, 0, 1, -1))
    _exchange(made, {2: 123_456})
    result = await _recover(made)
    assert (result.verdict, result.mode) == ("restored", "motor")
    assert [joint.exact for joint in result.joints] == [True, True, False, True, True, True]
    errors = np.abs(np.subtract((await made.arm.read_joints()).joints_rad, made.arm.true_joints))
    assert errors[2] <= result.joints[2].offset_u_rad < np.deg2rad(0.1)
    assert max(errors[[0, 1, 3]]) < 1e-12


async def test_a_wire_caught_in_one_capture_is_measured_again() -> None:
    made = await recovering()
    made.wire.kink_m = {8: 0.02, 9: 0.02}  # the fifth capture
    result = await _recover(made)
    assert (result.verdict, result.measured_again) == ("restored", 1)
    assert tuple(joint.turns_restored for joint in result.joints) == LOST


async def test_a_moved_anchor_is_refused_and_nothing_is_written() -> None:
    made = await recovering()
    made.wire.anchor_in_base_m = (0.93, -0.69, -0.44)
    refused = await _refusal(made)
    assert refused.code == "procedure.geometry_changed"
    assert isinstance(refused.evidence, RecoveryResult)
    assert refused.evidence.verdict == "refused"
    assert "calibration" in refused.remedy


async def test_too_few_captures_are_refused_with_the_poses_still_needed() -> None:
    made = await recovering()
    made.spec = replace(made.spec, first_captures=5, max_captures=6)
    refused = await _refusal(made)
    assert refused.code == "procedure.undecided"
    assert isinstance(refused.evidence, RecoveryResult)
    assert refused.evidence.poses_needed > 0


async def test_no_record_or_another_robots_record_is_refused_before_anything_moves() -> None:
    made = await recovering()
    record = await record_of(made)
    for other in (None, replace(record, robot_serial="F-2")):
        made.cell = replace(made.cell, record=other)
        await _refusal(made)
    assert made.arm.moves == []


async def test_check_poses_that_disagree_stop_the_correction() -> None:
    made = await recovering()
    made.wire.kink_m = dict.fromkeys(range(24, 26), 0.05)  # the first check after twelve captures
    refused = await _refusal(made)
    assert refused.code == "procedure.not_confirmed"


async def test_a_mastering_that_fails_its_last_check_is_taken_back() -> None:
    made = await recovering()
    before = made.arm.data.counts_at_zero
    made.hands.does["accept_mastering"] = lambda: made.wire.kink_m.update(
        dict.fromkeys(range(made.wire.readings, made.wire.readings + 4), 0.05)
    )
    with pytest.raises(RefusalError) as refused:
        await _recover(made)
    assert refused.value.code == "procedure.not_confirmed"
    assert made.arm.data == MasteringData(before, mastered=False)  # as unmastered as it was


async def test_a_second_loss_in_the_middle_ends_the_run() -> None:
    made, ledger = await recovering(), MemoryLedger()
    made.hands.refuses = {"accept_mastering"}
    with pytest.raises(DeclinedError):
        await mastering_recovery(Run(made.cell, ledger), made.spec)
    made.arm.epoch += 1
    with pytest.raises(PositionLostAgainError):
        await mastering_recovery(Run(made.cell, MemoryLedger(ledger.facts), ledger.past()), made.spec)


async def test_every_joint_comes_to_rest_from_the_same_side() -> None:
    made = await recovering()
    last: dict[int, float] = {}
    jog = made.arm.jog_axis

    async def watched(axis: int, delta_rad: float, *, speed_rad_s: float) -> None:
        last[axis] = delta_rad
        assert speed_rad_s <= made.cell.limits.jog_speed_rad_s
        await jog(axis, delta_rad, speed_rad_s=speed_rad_s)

    sides: list[bool] = []
    distance = made.wire.read_distance

    async def looked() -> object:
        sides.append(all(delta > 0 for delta in last.values()) or made.arm.moves[-1] == "move")
        return await distance()

    made.arm.jog_axis, made.wire.read_distance = watched, looked  # type: ignore[method-assign]
    await _recover(made)
    assert len(sides) > 20
    assert all(sides)


async def test_a_capture_of_a_moving_arm_is_refused() -> None:
    made = scene()
    distance = made.wire.read_distance

    async def drifting() -> object:
        made.arm.true_counts = tuple(count + COUNTS // 100 for count in made.arm.true_counts)
        return await distance()

    made.wire.read_distance = drifting  # type: ignore[method-assign]
    with pytest.raises(NotAtRestError):
        await capture_still(made.cell, "pose 1", 3, 50)


def test_a_cell_that_lacks_something_is_told_what() -> None:
    assert missing_needs(DEFINITION, Cell("bare", IdealArm(), Hands())) == (
        *("a robot that jogs single axes", "access to encoder counts and mastering"),
        "a draw-wire, touch probe or tracker, or a record with touched places or a seat",
        "a kinematic model of the robot",
    )


def _exchange(made: Scene, shifts: dict[int, int]) -> None:
    """Exchange motors: the new encoder counts from elsewhere, the arm stays where it is."""
    arm = made.arm
    arm.true_zero = tuple(zero + shifts.get(axis, 0) for axis, zero in enumerate(arm.true_zero))
    arm.true_counts = tuple(count + shifts.get(axis, 0) for axis, count in enumerate(arm.true_counts))
