"""Intervals hold the truth as often as they say: a slice of the campaign ``coverage``, which has thousands."""

import numpy as np
import pytest

from tests.soak.coverage import KINDS, tally_kind

_RUNS = 16
_SPREAD = 0.055  # of the share that one calibration's intervals hold: its parameters share their rows
_FAR = 4.0


def as_promised(share):
    """Tell whether a share of 95.45 % may look like this in so many calibrations: one in 16 000 does not."""
    return abs(share - 0.9545) < _FAR * _SPREAD / np.sqrt(_RUNS)


@pytest.mark.parametrize("kind", KINDS)
def test_intervals_of_a_known_deviation_hold_the_truth_as_often_as_they_say(kind):
    assert as_promised(tally_kind(kind, False, range(_RUNS)).parameters.mean())


@pytest.mark.parametrize("kind", ["length", "point", "pose", "pin"])
def test_intervals_of_a_deviation_found_from_few_rows_hold_the_truth_as_often_as_they_say(kind):
    assert as_promised(tally_kind(kind, True, range(_RUNS)).parameters.mean())


def test_intervals_that_are_too_short_by_a_third_are_noticed():
    off = np.concatenate(
        [KINDS["point"](np.random.default_rng([seed, False]), False).parameters for seed in range(_RUNS)]
    )
    assert as_promised(np.mean(np.abs(off) <= 2.0))
    assert not as_promised(np.mean(np.abs(off) <= 2.0 / 1.5))
