"""Coming from the other side: the play of gears is found as large as it is, and what is loose or warm is told."""

from dataclasses import replace

import numpy as np
import pytest

from cellcal.calibration.errors import CalibrationError
from cellcal.calibration.mastering.counts import WireCapture
from cellcal.calibration.mastering.flank_check import OTHER_SIDE, compare_flanks
from cellcal.calibration.wires.model import WirePoses
from cellcal.calibration.wires.reference import WirePredictor
from tests.unit.helpers.recovery_cases import DRIVE, MODEL, lose_turns

LOSS = lose_turns(3)
FOUND = replace(LOSS.recover_turns(), offset_turns=tuple(float(t) for t in LOSS.true_turns))
POSES = np.array(
    [[0.3, 0.2, -0.2, 0.9, -0.8, 0.4], [-0.4, 0.4, 0.1, -0.7, -1.1, 1.0], [0.1, 0.1, 0.2, 1.4, -0.6, -0.5]]
)
NOISE_M = 5e-5


def capture_flank(
    poses: np.ndarray, side: str = "record", *, play_rad: float = 0.0, off_m: float = 0.0, seed: int = 0
):  # type: ignore[no-untyped-def]
    """Return captures whose joints lie ``play_rad`` beyond what the motors say where no weight holds them."""
    rng = np.random.default_rng([seed, len(side)])
    predictor = WirePredictor(MODEL, *LOSS.record.wire_lengths())
    real = poses + play_rad * np.array([1.0, 0.0, 0.0, 1.0, 0.0, 1.0])
    lengths = (
        predictor.wire_terms(WirePoses.from_record_side(real, 1e-4)).lengths
        + off_m
        + NOISE_M * rng.normal(size=len(poses))
    )
    zero = np.array(LOSS.record.counts_at_zero)
    counts = DRIVE.to_counts(poses, zero) - np.array(DRIVE.counts_per_turn) * LOSS.true_turns
    return [
        WireCapture(tuple(int(c) for c in row), float(length), NOISE_M, side)
        for row, length in zip(counts, lengths, strict=True)
    ]


def compare_sides(again):  # type: ignore[no-untyped-def]
    return compare_flanks(MODEL, LOSS.record, FOUND, capture_flank(POSES), again)


def test_the_play_is_found_inside_its_uncertainty() -> None:
    inside = 0
    for seed in range(20):
        again = [
            *capture_flank(POSES[:1], seed=seed),
            *capture_flank(POSES[1:], OTHER_SIDE, play_rad=3e-4, seed=seed),
        ]
        found = compare_sides(again)
        assert found.backlash_rad is not None
        assert found.joints == ("J1", "J4", "J6")
        assert found.pairs == 3
        assert found.nothing_moved
        assert found.nothing_loose
        inside += abs(found.backlash_rad - 3e-4) <= found.backlash_u_rad
    assert inside >= 17


def test_what_moved_between_two_looks_from_the_same_side_is_reported() -> None:
    assert compare_sides(capture_flank(POSES)).nothing_moved
    warm = compare_sides(capture_flank(POSES, off_m=6e-4))
    assert not warm.nothing_moved
    assert warm.moved_m == pytest.approx(6e-4, abs=3e-4)
    assert warm.backlash_rad is None  # it was not approached from the other side


def test_a_loose_hook_is_more_than_any_gear_has() -> None:
    assert compare_sides(capture_flank(POSES, OTHER_SIDE, play_rad=2.4e-4)).nothing_loose
    found = compare_sides(capture_flank(POSES, OTHER_SIDE, off_m=5e-3))
    assert not found.nothing_loose
    assert found.lost_motion_m == pytest.approx(5e-3, rel=0.2)


def test_other_postures_are_not_compared_and_nothing_is_refused() -> None:
    assert compare_sides(capture_flank(POSES + 0.1, OTHER_SIDE)).pairs == 0
    with pytest.raises(CalibrationError, match="two captures"):
        compare_sides([])
