"""The lip over which a draw-wire leaves its housing: how much longer it makes the wire, and which way it looks."""

from dataclasses import dataclass
from typing import Self

import numpy as np

from cellcal.calibration.geometry import Array


@dataclass(frozen=True, eq=False, slots=True)
class WireExit:
    """Wires of one mounting as they leave the exit: directions (N, 3), where the mouth looks (3,), angles (N,)."""

    direction: Array
    ahead: Array
    phi: Array

    @classmethod
    def from_wires(
        cls, towards: Array, lengths: Array, exit_m: Array, mouth_at_m: tuple[float, float, float] | None
    ) -> Self:
        """Describe wires from an exit; without a place where its mouth looks, that is taken to be the mean hook.

        Parameters
        ----------
        towards : (N, 3)
            From the exit to the hook, of any length.
        lengths : (N,)
            Of the wires [m].
        exit_m : (3,)
            In the base [m].
        mouth_at_m : three numbers or None
            A point straight in front of the exit, in the base [m].
        """
        direction = towards / np.linalg.norm(towards, axis=1)[:, None]
        middle = (direction * lengths[:, None]).mean(axis=0)
        ahead = middle if mouth_at_m is None else np.array(mouth_at_m) - exit_m
        ahead = ahead / np.linalg.norm(ahead)
        return cls(direction, ahead, np.arccos(np.clip(direction @ ahead, -1.0, 1.0)))

    def lip_bend(self) -> Array:
        """Return (N,) ``phi - sin phi``: how much longer the wire is for every metre of the lip's radius."""
        bend: Array = self.phi - np.sin(self.phi)
        return bend

    def bend_by_mouth_turn(self) -> Array:
        """Return (N, 2) [1/rad]: change of ``lip_bend`` when the mouth turns either way, ``-tan(phi / 2) d e``."""
        across = np.linalg.svd(self.ahead[None])[2][1:]
        by_mouth: Array = -np.tan(self.phi / 2.0)[:, None] * (self.direction @ across.T)
        return by_mouth
