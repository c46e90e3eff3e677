"""Time-out of a move whose speed may be changed at the pendant."""

_LOWEST_OVERRIDE = 0.01


class MoveTimeout:
    """The time that a move needs at full override, counted as the override lets it pass, and a real margin."""

    def __init__(self, full_override_s: float, margin_s: float, now_s: float) -> None:
        self._began_s = self._looked_s = now_s
        self._left_s, self._margin_s = full_override_s, margin_s

    def has_expired(self, now_s: float, override: float = 1.0) -> bool:
        """Return whether the time is over; ``override`` is the part of its speed that the robot went at until now."""
        passed_s, self._looked_s = now_s - self._looked_s, now_s
        if self._left_s > 0.0:
            self._left_s -= passed_s * max(_LOWEST_OVERRIDE, min(1.0, override))
        else:
            self._margin_s -= passed_s
        return self._margin_s <= 0.0

    def passed_s(self) -> float:
        """Return how long it took until the last look."""
        return self._looked_s - self._began_s
