"""Whether an arm stands, told from its positions alone: this link shows no motion of others."""

from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass

SAME = 2e-4  # rad, or m: what a standing axis may vary
_KEEP_S = 10.0


@dataclass(frozen=True, slots=True)
class _Sample:
    at_s: float
    joints: tuple[float, ...]


class StandstillWatch:
    """Remembers readings. An arm stands where no reading of the last ``still_s`` differs from the newest."""

    def __init__(self, still_s: float) -> None:
        self._still_s = still_s
        self._samples: deque[_Sample] = deque()

    def add_reading(self, at_s: float, joints: Sequence[float]) -> None:
        """Take a reading, the newest of all."""
        self._samples.append(_Sample(at_s, tuple(joints)))
        while self._samples[0].at_s < at_s - _KEEP_S:
            self._samples.popleft()

    def forget(self) -> None:
        """Begin anew, as after a lost link."""
        self._samples.clear()

    def is_moving(self) -> bool | None:
        """Return whether the arm moves; None while the readings do not reach back far enough."""
        if not self._samples:
            return None
        newest = self._samples[-1]
        reaches_back = False
        for sample in reversed(self._samples):
            if any(abs(a - b) > SAME for a, b in zip(sample.joints, newest.joints, strict=True)):
                return True
            if sample.at_s <= newest.at_s - self._still_s:
                reaches_back = True
                break
        return False if reaches_back else None
