"""Turns come back without a draw-wire: touched points, a keyed seat, targets that a moved instrument sees."""

from dataclasses import replace
from typing import Literal

import numpy as np
import pytest

from cellcal.calibration.errors import CellError
from cellcal.calibration.geometry import exp_rotation
from cellcal.drivers.interfaces import MasteringData
from cellcal.procedures.mastering_record import MasteringRecordSpec, mastering_record
from cellcal.procedures.mastering_recovery import DEFINITION, MasteringRecoverySpec, mastering_recovery
from cellcal.procedures.motion.turn_uncertainty import first_uncertainty
from cellcal.procedures.procedure_definition import missing_needs
from cellcal.procedures.recovery.position_alarms import AlarmCodes, IndexTurning, clear_position_alarms
from cellcal.procedures.recovery.record_seal import seal_of, seal_record
from cellcal.procedures.recovery.recovery_kit import KitSpec, predict_kit, recorded_kit
from cellcal.procedures.recovery.recovery_result import RecoveryResult
from cellcal.procedures.run import RefusalError, Run
from tests.procedures.ideal_devices import ZERO
from tests.procedures.memory_ledgers import MemoryLedger
from tests.procedures.place_technician import TIP, PlaceTechnician, PlaceTracker, record_at_once
from tests.procedures.procedure_scenes import ProcedureScene, healthy_scene, recording_scene

LOST = (3, -2, 1, 0, 4, -1)
Kind = Literal["point", "seat", "target"]


async def lost_places(kind: Kind) -> ProcedureScene:
    """Return a cell without a draw-wire whose record has a kit, after its encoders were lost."""
    return (await _lost_scene(kind))[0]


async def _lost_scene(
    kind: Kind, lost: tuple[int, ...] = LOST, **more: int
) -> tuple[ProcedureScene, PlaceTechnician]:
    """Return the same with its technician; ``more`` are the kit's."""
    made = healthy_scene()
    tracker = PlaceTracker(made.arm) if kind == "target" else None
    technician = PlaceTechnician(made, 12, kind, tracker)
    made.cell = replace(made.cell, gauge=None, gauge_setup=None, tracker=tracker)
    record = await record_at_once(healthy_scene())
    kit = await recorded_kit(Run(made.cell, MemoryLedger()), KitSpec(kind, TIP, **more))
    made.cell = replace(made.cell, record=seal_record(replace(record, kit=kit)))
    made.arm.write_program(np.array([0.2, 0.1, -0.3, 0.4, 0.5, -0.6]))
    last = await made.arm.encoder_counts()
    made.arm.lose_encoders(lost)
    made.spec = MasteringRecoverySpec(evidence="places", last_counts=last)
    if tracker is not None:  # a tracker is not left standing for a year
        tracker.station = (exp_rotation(np.array([0.0, 0.0, 0.7])), np.array([1.2, 2.0, 0.1]))
    return made, technician


async def _run_recovery(made: ProcedureScene) -> RecoveryResult:
    return await mastering_recovery(Run(made.cell, MemoryLedger()), made.spec)


@pytest.mark.parametrize("kind", ["point", "seat", "target"])
async def test_turns_come_back_exactly(kind: Kind) -> None:
    made, _ = await _lost_scene(kind)
    assert missing_needs(DEFINITION, made.cell) == ()
    result = await _run_recovery(made)
    assert (result.verdict, result.mode) == ("restored", "turns")
    assert tuple(joint.turns_restored for joint in result.joints) == LOST
    assert made.arm.data.mastered
    assert {"verification power", "verification"} <= {check.name for check in result.gate if check.passed}
    record = result.record
    assert record is not None
    assert record.kit is not None
    assert record.sha256 == seal_of(record)
    made.arm.write_program(np.array([0.1, 0.2, 0.3, -0.4, 0.5, 0.6]))
    made.arm.lose_encoders((1, 0, -1, 2, 0, 1))  # the renewed record serves the next loss
    made.cell = replace(made.cell, record=record)
    made.spec = replace(made.spec, last_counts=None)
    again = await _run_recovery(made)
    assert (again.mode, again.verdict) == ("turns", "restored")


async def test_joints_stay_where_their_motors_passed_the_index_and_the_counts_are_known_there() -> None:
    made, _ = await _lost_scene("point")
    record, last = made.cell.record, made.spec.last_counts
    assert record is not None
    before = made.arm.true_joints
    turning = IndexTurning(
        0.035, made.spec.room, first_uncertainty(made.spec.room, len(LOST), is_measured=True)
    )
    woken = await clear_position_alarms(Run(made.cell, MemoryLedger()), record, last, AlarmCodes(), turning)
    per_turn = np.abs(np.diag(record.drive.radians_per_turn()))
    turned = np.abs(made.arm.true_joints - before) / per_turn
    assert ((turned > 1.0) & (turned < 1.2)).all()
    np.testing.assert_allclose(woken.counts, made.arm.true_counts, atol=3)
    assert woken.lost


async def test_an_exchanged_motor_is_found_by_touching() -> None:
    made, _ = await _lost_scene("point")
    part = round(0.37 * 2**19)
    zero = tuple(z - part * (j == 2) for j, z in enumerate(made.arm.true_zero))
    joints = made.arm.true_joints
    made.arm.true_zero = zero
    made.arm.write_program(joints)
    result = await _run_recovery(made)
    assert result.mode == "motor"
    assert [joint.exact for joint in result.joints] == [True, True, False, True, True, True]
    wrong = np.array(made.arm.data.counts_at_zero) - np.array(zero)
    lost = np.array(LOST) * 2**19
    off = np.abs(np.array(made.arm.drive.radians_per_count) @ (wrong + lost))
    assert off[2] <= result.joints[2].offset_u_rad


async def test_one_point_touched_beside_is_named_and_touched_again() -> None:
    made, technician = await _lost_scene("point")
    good, slips = technician.visit_place, [True]

    def visit_beside(what: str, number: int) -> None:
        technician.tip = np.array(TIP) + (0.012 if number == 3 and slips and slips.pop() else 0.0)
        good(what, number)

    technician.visit_place = visit_beside  # type: ignore[method-assign]
    result = await _run_recovery(made)
    assert (result.mode, result.measured_again) == ("turns", 1)
    assert len(result.set_aside) == 1


async def test_a_bent_tip_writes_nothing() -> None:
    made, technician = await _lost_scene("point")
    technician.tip = np.array(TIP) + np.array([0.008, -0.006, 0.005])
    with pytest.raises(RefusalError):
        await _run_recovery(made)
    assert made.arm.writes == 0


async def test_a_record_without_places_is_reported() -> None:
    made, _ = await _lost_scene("point")
    assert made.cell.record is not None
    made.cell = replace(made.cell, record=seal_record(replace(made.cell.record, kit=None)))
    assert missing_needs(DEFINITION, made.cell) == (
        "a draw-wire, touch probe or tracker, or a record with touched places or a seat",
    )
    with pytest.raises(RefusalError, match="no recovery kit") as refused:
        await _run_recovery(made)
    assert refused.value.code == "procedure.no_kit"


async def test_a_kit_that_would_not_tell_all_motors_is_refused_while_the_robot_is_healthy() -> None:
    made, _ = await _lost_scene("point", places=3)
    assert made.cell.record is not None
    with pytest.raises(RefusalError, match="would leave the motor of") as refused:
        predict_kit(made.cell.record)
    assert "wrist bent" in refused.value.remedy


async def test_a_mastering_that_does_not_take_is_rolled_back() -> None:
    made, _ = await _lost_scene("point")
    before = made.arm.data.counts_at_zero
    arm = made.arm
    real = arm.read_joints

    async def ignore_write():  # type: ignore[no-untyped-def]
        reading = await real()
        off = 0.01 if arm.data.mastered else 0.0
        return replace(reading, joints_rad=tuple(q + off for q in reading.joints_rad))

    arm.read_joints = ignore_write  # type: ignore[method-assign]
    with pytest.raises(RefusalError, match="put back"):
        await _run_recovery(made)
    assert arm.data == MasteringData(before, mastered=False)


async def test_the_record_takes_places_and_says_what_they_promise() -> None:
    made = recording_scene()
    PlaceTechnician(made, 12, "point")
    made.spec = MasteringRecordSpec(poses=20, samples=1, kit=KitSpec("point", TIP))
    result = await mastering_record(Run(made.cell, MemoryLedger()), made.spec)
    assert result.kit is not None
    assert result.kit.success_probability > 0.9999
    assert result.record.kit is not None
    assert len(result.record.kit.places) == 9
    assert result.record.sha256 == seal_of(result.record)


async def test_a_record_older_than_kits_keeps_its_seal() -> None:
    record = await record_at_once(healthy_scene())
    assert record.kit is None
    assert record.counts_at_zero == ZERO
    assert seal_of(record) == record.sha256
    assert seal_of(replace(record, kit=None)) == record.sha256


def test_a_place_needs_what_its_kind_says() -> None:
    from cellcal.calibration.mastering.counts import PlaceCapture

    for wrong in (
        {"kind": "ball"},
        {"sigma_m": 0.0},
        {"sigma_m": float("nan")},
        {"kind": "seat"},
        {"kind": "target"},
        {"seen_m": (0.0, 0.0, 0.0)},
    ):
        with pytest.raises(CellError):
            PlaceCapture(**({"kind": "point", "place": 0, "counts": ZERO, "sigma_m": 1e-4} | wrong))
