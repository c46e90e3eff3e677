"""How often a PIN may be guessed: five times, then once an hour, and never more than a day's share.

With six digits, 20 people and these limits a day of guessing finds one with a chance of 0.01 %. A lock concerns
PINs only: looking on and asking for a stop take none.
"""

from collections.abc import Sequence
from dataclasses import dataclass

DAY_S = 86400.0


@dataclass(frozen=True, slots=True)
class GuessLimit:
    """At most ``free`` wrong ones at once, then one every ``then_every_s``, ``per_day`` within 24 hours."""

    free: int
    then_every_s: float
    per_day: int


PERSON = GuessLimit(free=5, then_every_s=3600.0, per_day=30)
DEVICE = GuessLimit(
    free=20, then_every_s=600.0, per_day=60
)  # shared by a shift; never cleared by one person's success
STATION = GuessLimit(free=100, then_every_s=3600.0, per_day=100)


def wait_s(failed_at_s: Sequence[float], in_a_row: int, rule: GuessLimit, now_s: float) -> float:
    """Return how long the next guess has to wait; zero when it need not.

    Parameters
    ----------
    failed_at_s
        When guesses of the last 24 hours failed, oldest first.
    in_a_row
        How many of them since the last success.
    """
    waits = [0.0]
    if in_a_row >= rule.free:
        waits.append(failed_at_s[-1] + rule.then_every_s - now_s)
    if len(failed_at_s) >= rule.per_day:
        waits.append(failed_at_s[-rule.per_day] + DAY_S - now_s)
    return max(waits)
