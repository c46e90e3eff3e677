"""A controller that forgot its mastering: a few lengths say whether the encoders forgot anything, all together."""

from dataclasses import replace

import numpy as np
import pytest

from cellcal.calibration.mastering.turn_verification import verification_power
from cellcal.procedures.recovery.recovery_result import (
    ALONE_CHECK,
    MEMORY_POWER,
    SHARP_CHECK,
    confirm_memory,
    nothing_lost_recovery,
)
from tests.unit.helpers.recovery_cases import MODEL, healthy_record, lose_turns, record_poses
from tests.unit.helpers.walked_recovery import walk_planner
from tests.unit.helpers.wire_world import WireWorld

STARTS = 2


def record_and_captures(number: int, fractions: np.ndarray):  # type: ignore[no-untyped-def]
    """Return a record and four captures, chosen to be quick, of a robot whose motors are off by these turns."""
    record = healthy_record(WireWorld(number))
    here, candidates = record_poses()[number], record_poses()
    power = verification_power(MODEL, record, candidates) / MEMORY_POWER
    nothing = np.zeros(power.shape[1])
    chosen = walk_planner(record).quick_checks(here, candidates, power, nothing, 4, together=True)
    loss = lose_turns(number, poses=candidates[chosen], fractions=fractions)
    return loss.record, tuple(
        replace(c, counts=tuple(int(v) for v in np.add(c.counts, loss_counts(loss)))) for c in loss.captures
    )


def loss_counts(loss):  # type: ignore[no-untyped-def]
    """Return the counts of the whole turns that were lost: only a fraction of a turn stays wrong."""
    return np.rint(np.floor(loss.true_turns + 0.5)).astype(int) * np.array(loss.record.drive.counts_per_turn)


@pytest.mark.parametrize("number", range(STARTS))
def test_four_lengths_are_sharp_enough_from_wherever_the_robot_stands(number: int) -> None:
    record, checks = record_and_captures(number, np.zeros(6))
    found = confirm_memory(record, nothing_lost_recovery(record), checks)
    gate = {check.name: check for check in found.gate}
    assert gate[SHARP_CHECK].passed, gate[SHARP_CHECK].sentence
    assert found.accepted, [check.sentence for check in found.gate if not check.passed]
    assert max(found.blind_turns) <= 0.15


@pytest.mark.parametrize("axis", [0, 2, 5])
def test_a_third_of_a_turn_of_any_motor_is_never_taken_for_lost_memory(axis: int) -> None:
    record, checks = record_and_captures(axis % STARTS, np.eye(6)[axis] * 0.33)
    found = confirm_memory(record, nothing_lost_recovery(record), checks)
    assert not found.accepted
    assert not next(check for check in found.gate if check.name == ALONE_CHECK).passed
