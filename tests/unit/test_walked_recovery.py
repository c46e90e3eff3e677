"""A slice of the campaigns of `make soak`: recoveries as the procedure walks them; nothing wrong is accepted."""

import numpy as np

from tests.soak import losses
from tests.unit.helpers.walked_recovery import loss_of, recover_walking


def test_lost_turns_come_back_from_a_walk_also_past_wrong_lengths():
    assert losses.many(5).reached


def test_a_small_box_is_refused():
    assert losses.poor(4).reached


def test_a_new_motor_near_a_whole_turn_is_told_apart_or_lies_in_the_stated_blind_zone():
    for seed, part in ((1, 0.12), (2, -0.1), (3, 0.3), (4, 0.06)):
        loss, at = loss_of(seed, fractions=np.eye(6)[seed % 6] * part)
        done = recover_walking(loss, at)
        assert not done.wrong()
        if done.recovery.mode == "turns" and done.recovery.accepted:
            assert done.recovery.blind_turns[seed % 6] > abs(part)


def test_whole_turns_say_what_would_look_like_them():
    loss, _ = loss_of(5)
    found = loss.recover()
    assert found.accepted
    assert 0 <= found.doubt_sigmas < 5
    assert all(0 < turns < 0.15 for turns in found.blind_turns)
