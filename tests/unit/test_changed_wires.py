"""A wire that is not as recorded is no new motor, and whole turns that are plain to see come back in spite of it."""

import numpy as np
import pytest

from tests.soak.changed_wires import CHANGES, is_wrong, recover_changed
from tests.unit.helpers.recovery_cases import MODEL, lose_turns, record_poses


@pytest.mark.parametrize("seed", [3, pytest.param(5, marks=pytest.mark.soak)])
@pytest.mark.parametrize("change", list(CHANGES))
def test_nothing_false_is_accepted_after_a_change_of_the_wire(change: str, seed: int) -> None:
    done = recover_changed(change, seed)
    assert not is_wrong(done), done.recovery.reason


def test_an_anchor_that_moved_around_j1_is_not_a_new_motor() -> None:
    done = recover_changed("anchor around J1", 7)
    assert not done.recovery.accepted
    assert "the reference of J1 is new" in done.recovery.reason
    assert "the wire is not as recorded" in done.recovery.reason


@pytest.mark.parametrize(("zero_m", "scale"), [(0.002, 0.0), (-0.002, 0.0), (0.0, 0.001)])
def test_another_zero_or_scale_of_the_wire_does_not_keep_whole_turns_from_coming_back(
    zero_m: float, scale: float
) -> None:
    loss = lose_turns(2, poses=record_poses()[:28])
    loss.world.zero += zero_m
    loss.world.scale *= 1.0 + scale
    loss.captures = loss.capture_poses(record_poses()[:28])
    found = loss.recover_turns()
    assert found.accepted, found.reason
    assert found.mode == "turns"
    assert found.turns == tuple(int(turns) for turns in loss.true_turns)
    assert found.changed_part == "the wire"
    assert "the wire is not as recorded" in found.reason
    assert len(found.equipment_change) == 8


def test_an_unannounced_new_reference_near_a_whole_turn_is_undecided() -> None:
    for axis in range(MODEL.axis_count):
        loss = lose_turns(4, 24, fractions=np.eye(6)[axis] * 0.04)
        found = loss.recover_turns()
        assert not (found.accepted and found.mode == "motor"), found.reason
