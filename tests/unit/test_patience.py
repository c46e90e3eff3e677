"""How long a move may take: by the override that it ran at, and a margin."""

import math

import pytest

from cellcal.drivers.wire.move_timeout import MoveTimeout


def patience_end_s(overrides, step_s: float = 0.1) -> float:
    """Return when patience ends that looks at one override after the other, and at the last one for ever."""
    patience, now_s, number = MoveTimeout(2.0, 1.0, 100.0), 100.0, 0
    while not patience.has_expired(now_s, overrides[min(number, len(overrides) - 1)]):
        now_s, number = now_s + step_s, number + 1
        assert number < 10_000
    assert patience.passed_s() == pytest.approx(now_s - 100.0)
    return now_s - 100.0


@pytest.mark.parametrize(
    ("overrides", "seconds"),
    [
        ([1.0], 3.0),
        ([0.5], 5.0),
        ([1.0] * 11 + [0.1], 1.0 + 10.0 + 1.0),  # slowed down on the way
        ([0.1] * 11 + [1.0], 1.0 + 1.9 + 1.0),  # and let go
        ([0.0], 200.0 + 1.0),  # a robot at standstill is told by others; this ends, too
        ([math.nan], 3.0),
        ([7.0], 3.0),
    ],
)
def test_the_time_of_a_move_is_counted_as_the_override_lets_it_pass(overrides, seconds):
    assert patience_end_s(overrides) == pytest.approx(seconds, abs=0.25)
