"""What the motors' counts show while a person turns one axis: how far, from which side, and which other turned."""

import math
from dataclasses import dataclass, field

import numpy as np

from cellcal.calibration.geometry import Array
from cellcal.calibration.mastering.counts import DriveTrain
from cellcal.drivers.interfaces import Counts

OTHER_AXIS_RAD = math.radians(0.1)  # an axis that turned further was jogged; a held one stands to some counts
FROM_BELOW_RAD = math.radians(0.2)  # upwards by so much, the gears lie on the tooth flank of the record
REVERSAL_RAD = math.radians(0.02)


@dataclass
class AxisWatch:
    """The turns of all joints since the counts ``before``, and the lowest place each came from."""

    drive: DriveTrain
    before: Counts
    turned_rad: Array = field(init=False)
    accepted_rad: Array = field(init=False)  # where each joint may stand
    _low_rad: Array = field(init=False)
    _high_rad: Array = field(init=False)

    def __post_init__(self) -> None:
        self.turned_rad = np.zeros(len(self.before))
        self.accepted_rad, self._low_rad, self._high_rad = (self.turned_rad.copy() for _ in range(3))

    def take_counts(self, counts: Counts) -> None:
        """Take a reading. A joint that turned back down begins to be followed from its new lowest place."""
        turned = np.asarray(self.drive.to_joints(np.array(counts), np.array(self.before)), dtype=float)
        self.turned_rad = turned
        has_turned_back = (turned < self._low_rad) | (turned < self._high_rad - REVERSAL_RAD)
        self._low_rad = np.where(has_turned_back, turned, self._low_rad)
        self._high_rad = np.where(has_turned_back, turned, np.maximum(self._high_rad, turned))

    def is_from_below(self, axis: int) -> bool:
        """Return whether the joint turned upwards last, far enough to change the tooth flank."""
        return bool(self.turned_rad[axis] - self._low_rad[axis] >= FROM_BELOW_RAD)

    def accept_axis(self, axis: int) -> None:
        """Let a joint stand where it is now."""
        self.accepted_rad[axis] = self.turned_rad[axis]

    def other_axis(self, axis: int, allowed_rad: Array) -> int | None:
        """Return the other joint that turned furthest beyond what is allowed (n,); None where all stood."""
        beyond = np.abs(self.turned_rad - self.accepted_rad) - OTHER_AXIS_RAD - allowed_rad
        beyond[axis] = -np.inf
        worst = int(np.argmax(beyond))
        return worst if beyond[worst] > 0.0 else None
