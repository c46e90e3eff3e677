"""Turns from touched points and keyed seats of an arm with hidden errors; what is predicted before anything fails."""

from dataclasses import replace

import numpy as np
import pytest

from cellcal.calibration.errors import CalibrationError, DegenerateDataError
from cellcal.calibration.mastering.counts import PlaceCapture
from cellcal.calibration.mastering.place_evidence import PlaceProblem
from cellcal.calibration.mastering.place_recovery import (
    choose_places,
    place_covariance,
    places_to_fit,
    verify_at_places,
)
from tests.unit.helpers.place_cases import lose_places
from tests.unit.helpers.recovery_cases import DRIVE, MODEL


def robot_of(loss):
    return DRIVE, loss.record.counts_at_zero


def test_touched_points_give_whole_turns_back_and_the_others_confirm_them():
    for seed in range(2):
        loss = lose_places(seed, 9)
        found = loss.recover_turns(range(6))
        assert (found.mode, found.accepted) == ("turns", True), found.reason
        assert found.turns == tuple(loss.true_turns.astype(int))
        rest = [loss.again[k] for k in (6, 7, 8)]
        assert verify_at_places(loss.record, loss.kit, found, rest).accepted
        for axis in range(6):
            turns = tuple(t + (j == axis) for j, t in enumerate(found.offset_turns))
            assert not verify_at_places(
                loss.record, loss.kit, replace(found, offset_turns=turns), rest
            ).accepted


def test_a_keyed_seat_taken_twice_gives_whole_turns_back():
    for seed in range(2):
        loss = lose_places(seed, 1, kind="seat")
        found = loss.recover_turns([0, 0])
        assert (found.mode, found.accepted) == ("turns", True), found.reason
        assert found.turns == tuple(loss.true_turns.astype(int))


def test_one_seat_once_is_too_little_to_notice_a_mistake():
    loss = lose_places(1, 1, kind="seat")
    assert not loss.recover_turns([0]).accepted


def test_an_exchanged_motor_lies_inside_its_uncertainty():
    inside = []
    for seed in (0, 2, 5):
        loss = lose_places(seed, 8, fractions=np.eye(6)[seed] * 0.37)
        # A tip that moved looks like a new J6, so that only a report tells them apart.
        found = loss.recover_turns(range(8), replaced_axes=[5] if seed == 5 else [])
        assert (found.mode, found.replaced_axes) == ("motor", (seed,)), found.reason
        off = DRIVE.radians_per_turn() @ (np.array(found.offset_turns) - loss.true_turns)
        inside.append(abs(off[seed]) <= found.offset_u_rad[seed])
    assert sum(inside) >= 2


def test_a_bent_arm_is_no_recovery():
    for seed in range(2):
        bend = {2: np.array([0.006, 0.002, 0.003, 0.004, 0.0]), 4: np.array([0.005, 0.0, -0.003, 0.006, 0.0])}
        found = lose_places(seed, 8, crash=bend).recover_turns(range(8))
        assert not found.accepted


def sigma_turns(loss, places):
    return np.sqrt(np.diag(place_covariance(MODEL, loss.kit, robot_of(loss), places)))


def test_more_places_tell_more_and_the_best_are_chosen_first():
    loss = lose_places(2, 9)
    sigmas = [sigma_turns(loss, range(k)) for k in (3, 6, 9)]
    assert (sigmas[0] >= sigmas[1]).all()
    assert (sigmas[1] >= sigmas[2]).all()
    best = choose_places(MODEL, loss.kit, robot_of(loss), 6)
    assert len(set(best)) == 6
    spread = np.abs(np.diag(DRIVE.radians_per_turn()))
    chosen = sigma_turns(loss, best) * spread
    assert np.sum(chosen**2) <= np.sum((sigmas[1] * spread) ** 2) * 1.01
    assert chosen.max() < np.deg2rad(0.5)


def test_places_left_for_checking_are_never_fitted():
    loss = lose_places(3, 8)
    fitted = places_to_fit(replace(loss.record, kit=loss.kit))
    assert len(fitted) == 6
    with pytest.raises(CalibrationError, match="no recovery kit"):
        places_to_fit(loss.record)


def test_unrecorded_places_and_too_few_nests_are_refused():
    loss = lose_places(4, 6)
    stranger = replace(loss.again[0], place=77)
    with pytest.raises(CalibrationError, match="77"):
        PlaceProblem(MODEL, loss.kit, robot_of(loss), [stranger])
    target_capture = PlaceCapture("target", 0, loss.kit.places[0].counts, 1e-4, 0.0, (1.0, 0.0, 0.0))
    others = [
        replace(target_capture, place=k, counts=place.counts, seen_m=(float(k), float(k * k), 1.0))
        for k, place in enumerate(loss.kit.places)
    ]
    with pytest.raises((DegenerateDataError, CalibrationError)):
        PlaceProblem(MODEL, replace(loss.kit, places=tuple(others)), robot_of(loss), [target_capture])
