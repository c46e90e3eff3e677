"""Battery-backed incremental pulse coders on the motors of an arm.

Imitates
    FANUC serial pulse coders: 2^19 counts per motor turn, turns counted by a battery-fed counter.
Source
    Public controller backups (counts per turn on 162 axes); B-83525EN on BZAL, "pulse not established" and
    the index that one motor turn finds; deploy/controller_setup/fanuc_hmi.md.
Modelled
    The count follows the motor through all joints' coupling; a dead battery while power is off forgets the
    turns: the count starts again at 0 and only passing the motor's index brings the fraction of the turn
    back; a new motor has its index elsewhere; the arm may move while the counter is off.
Not modelled
    Electrical noise, over-speed without battery, wrap at 2^31.
"""

import numpy as np
from numpy.typing import NDArray

from cellcal.fake_devices.arm import SimulatedArm
from cellcal.fake_devices.arm_models import COUNTS_PER_TURN
from cellcal.fake_devices.kinematics import Array

Integers = NDArray[np.int64]


class PulseCoders:
    """All pulse coders of one arm; truth and reading."""

    def __init__(self, arm: SimulatedArm, rng: np.random.Generator) -> None:
        if arm.model.gears is None:
            raise ValueError(f"the model {arm.model.name} has no pulse coders")
        self._arm = arm
        self.radians_per_count = arm.model.gears.radians_per_count()
        self._counts_per_radian = np.linalg.inv(self.radians_per_count)
        n = len(self.radians_per_count)
        self.factory_counts_at_zero: Integers = rng.integers(-40, 40, n) * COUNTS_PER_TURN + rng.integers(
            0, COUNTS_PER_TURN, n
        )
        self._index: Integers = np.zeros(n, dtype=np.int64)
        self._shift: Integers = np.zeros(n, dtype=np.int64)
        self._power_on: Integers = np.zeros(n, dtype=np.int64)
        self.lost = np.zeros(n, dtype=bool)
        self.established = np.ones(n, dtype=bool)

    # reading

    def read_counts(self) -> tuple[int, ...]:
        """Return the counts that the controller receives now."""
        self.look_for_index()
        return tuple(int(count) for count in self.true_counts() + self._shift)

    def true_counts(self) -> Integers:
        """Return what the counts would be had nothing ever been lost."""
        exact = self.factory_counts_at_zero + self._counts_per_radian @ self._arm.joints_rad
        return np.floor(exact + 1e-6).astype(np.int64)

    def true_counts_at_zero(self) -> tuple[int, ...]:
        """Return the mastering counts that would be right for the present reading."""
        self.look_for_index()
        return tuple(int(count) for count in self.factory_counts_at_zero + self._shift)

    def turns_lost(self) -> tuple[int, ...]:
        """Return true minus read count, in whole turns."""
        return tuple(int(turns) for turns in np.rint(-self._shift / COUNTS_PER_TURN))

    def offset_rad(self, counts_at_zero: tuple[int, ...]) -> Array:
        """Return true joints minus controller's joints under a mastering; constant while nothing is lost."""
        wrong = np.array(counts_at_zero, dtype=np.int64) - np.array(
            self.true_counts_at_zero(), dtype=np.int64
        )
        return np.asarray(self.radians_per_count @ wrong.astype(float))

    def joints_from_counts(self, counts_at_zero: tuple[int, ...]) -> Array:
        """Return the joints that the controller computes from the present counts."""
        counts = np.array(self.read_counts(), dtype=np.int64) - np.array(counts_at_zero, dtype=np.int64)
        return np.asarray(self.radians_per_count @ counts.astype(float))

    # what happens to them

    def lose_turns(self, axes: list[int]) -> None:
        """Forget the turns of some axes: they count from 0 where they stand."""
        now = self.true_counts()
        for axis in axes:
            self.lost[axis], self.established[axis] = True, False
            self._power_on[axis] = now[axis]
            self._shift[axis] = -now[axis]

    def replace_motor(self, axis: int, index_counts: int) -> None:
        """Fit another motor; its index lies somewhere else in the turn."""
        self._index[axis] = index_counts % COUNTS_PER_TURN

    def acknowledge_alarm(self) -> None:
        """Leave the battery alarm: from here the index can be found."""
        self.lost[:] = False

    def look_for_index(self) -> None:
        """Give the fraction of the turn back to every motor that has passed its index."""
        if self.established.all():
            return
        now = self.true_counts()
        turn = (now - self._index) // COUNTS_PER_TURN
        turn_at_power_on = (self._power_on - self._index) // COUNTS_PER_TURN
        for axis in np.flatnonzero(~self.established & ~self.lost & (turn != turn_at_power_on)):
            whole = int(np.rint((self._power_on[axis] - self._index[axis]) / COUNTS_PER_TURN))
            self._shift[axis] = -(self._index[axis] + whole * COUNTS_PER_TURN)
            self.established[axis] = True

    def drift_joints(self, turns: Array) -> Array:
        """Return the joint motion [rad] of some motor turns."""
        return np.asarray(self.radians_per_count @ (np.asarray(turns) * COUNTS_PER_TURN))
