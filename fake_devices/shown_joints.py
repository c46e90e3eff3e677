"""Joints that a controller shows beside the true ones, for controllers whose encoders no wire reads.

Imitates
    A turn counter beside a single-turn resolver or encoder on each motor, and a zero that can be set anew.
Source
    Practice of revolution counters: an update at the mark keeps the fraction of the turn. The gear ratios of a cell
    file, or 100 each where it tells none.
Modelled
    Counters lost by some turns, updated by where the axis stands, and a zero set where the axis stands.
Not modelled
    Wrist coupling; resolvers of several pole pairs.
"""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from cellcal.fake_devices.arm import SimulatedArm
from cellcal.fake_devices.kinematics import Array

_USUAL_RATIO = 100.0
_GAUGE_REACH_RAD = 0.02  # how far from the notch a gauge head still finds it


def ratios_of(table: Mapping[str, Any], axes: int) -> tuple[float, ...]:
    """Return the motor turns of a joint turn that a cell file names."""
    return tuple(float(v) for v in table.get("motor_turns_per_joint_turn") or [_USUAL_RATIO] * axes)


class ShownJoints:
    """Joints shown by a controller less the true ones, axis by axis [rad]; the marks of all axes are at zero."""

    def __init__(self, arm: SimulatedArm, ratios: Sequence[float], rng: np.random.Generator) -> None:
        self._arm, self._rng = arm, rng
        self.turn_rad: Array = np.abs(2.0 * np.pi / np.array(ratios, dtype=float))
        self.error_rad: Array = np.zeros(len(self.turn_rad))

    def to_shown_joints(self, joints_rad: Array) -> Array:
        """Return what is shown for true joints."""
        return np.asarray(joints_rad + self.error_rad)

    def to_true_joints(self, joints_rad: Array) -> Array:
        """Return the true joints of shown ones."""
        return np.asarray(joints_rad - self.error_rad)

    def lose_turns(self, axes: Sequence[int]) -> None:
        """Let some axes come back a few motor turns off."""
        for axis in axes:
            turns = int(self._rng.integers(1, 4)) * int(self._rng.choice([-1, 1]))
            self.error_rad[axis] += turns * self.turn_rad[axis]

    def update_counter(self, axis: int) -> None:
        """Take the axis as standing at its mark: the whole turns are set, the fraction of a turn is kept."""
        true = float(self._arm.joints_rad[axis])
        fraction = (self.error_rad[axis] / self.turn_rad[axis]) % 1.0  # of a zero that was set anew before
        fraction = fraction - round(fraction)
        beside = round((true + fraction * self.turn_rad[axis]) / self.turn_rad[axis])
        self.error_rad[axis] = (fraction - beside) * self.turn_rad[axis]

    def set_zero(self, axis: int) -> None:
        """Take where the axis stands as its zero."""
        self.error_rad[axis] = -float(self._arm.joints_rad[axis])

    def find_notch(self, axis: int) -> bool:
        """Let a gauge head find the notch at joint zero; return whether it was within its reach."""
        if abs(float(self._arm.joints_rad[axis])) > _GAUGE_REACH_RAD:
            return False
        found = self._arm.joints_rad
        found[axis] = float(self._rng.normal(0.0, 5e-5))  # the gauge head itself
        self._arm.put_joints(found)
        self.set_zero(axis)
        return True

    def mend(self) -> None:
        """Set everything right."""
        self.error_rad[:] = 0.0
