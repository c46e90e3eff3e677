"""Marks and a keyed seat in the cell, and a technician who brings the tool to them again.

Imitates
    Punch marks and cones on plates that stay, a keyed seat on a bracket; a person at the pendant who creeps to them.
Source
    Practice of reference points: a ball in a cone, or a keyed seat, is met again within hundredths of a millimetre.
Modelled
    A mark is made where the true tip is when a person comes to it first; afterwards it stays there. A person comes
    from a slightly different posture each time, and leaves the arm on whatever tooth flank the way left it. In a
    seat the tool's attitude is held, too. The contact of a probe closes at a mark.
Not modelled
    Worn marks, bent brackets, forces in the seat.
"""

from typing import TYPE_CHECKING

import numpy as np

from cellcal.fake_devices.arm import SimulatedArm
from cellcal.fake_devices.artefact import Artefact
from cellcal.fake_devices.kinematics import Array

if TYPE_CHECKING:
    from cellcal.fake_devices.world import World

MET_M, HELD_RAD = 5e-5, 1e-4  # standard deviations of coming to a mark or a seat
_AWAY_RAD = 0.03  # how differently a person holds the arm the next time
_STEP_RAD, _STEPS, _CLOSE = 1e-6, 25, 2e-6
_BALL_MM = 0.2


class PlaceMarks:
    """All marks of one world, by robot and number."""

    def __init__(self, world: "World") -> None:
        self._world = world
        self._made: dict[
            tuple[str, int], tuple[Array, Array]
        ] = {}  # home joints, true frame of the tip there
        self._rng = world.make_rng("hands")

    def bring_tool(self, arm: SimulatedArm, number: int, near_rad: Array, *, seated: bool) -> None:
        """Bring the tool to a mark or a seat; the first visit makes it where the tool then is.

        ``near_rad`` (n,) are true joints; later visits ignore them.
        """
        key = (arm.name, number)
        if key not in self._made:
            arm.put_joints(np.clip(near_rad, arm.lower_rad, arm.upper_rad))
            self._made[key] = (near_rad, self._true_tip(arm))
            self._put_up(arm, number)
            return
        home, frame = self._made[key]
        met = frame.copy()
        met[:3, 3] += self._rng.normal(size=3) * MET_M
        met[:3, :3] = _rotation_matrix(self._rng.normal(size=3) * HELD_RAD) @ met[:3, :3]
        arm.put_joints(home + self._rng.uniform(-_AWAY_RAD, _AWAY_RAD, len(home)))
        self._creep_to(arm, met, rows=6 if seated else 3)

    def _creep_to(self, arm: SimulatedArm, goal: Array, rows: int) -> None:
        """Creep until the true tip is there, backlash and sag included; stop where a person would."""
        for _ in range(_STEPS):
            gap = _gap_between(goal, self._true_tip(arm))[:rows]
            if np.abs(gap).max() < _CLOSE:
                return
            joints = arm.joints_rad
            by_joint = np.array(
                [self._joints_along(arm, joints, axis)[:rows] for axis in np.eye(len(joints))]
            ).T
            arm.put_joints(joints + np.linalg.lstsq(by_joint, gap, rcond=None)[0])

    def _joints_along(self, arm: SimulatedArm, joints: Array, axis: Array) -> Array:
        ends = arm.flange_at([joints + _STEP_RAD * axis, joints - _STEP_RAD * axis])
        return _gap_between(self._tip_at(arm, ends[0]), self._tip_at(arm, ends[1])) / (2.0 * _STEP_RAD)

    def _true_tip(self, arm: SimulatedArm) -> Array:
        return self._tip_at(arm, arm.base_flange())

    def _tip_at(self, arm: SimulatedArm, base_flange: Array) -> Array:
        tip = np.eye(4)
        tip[:3, 3] = self._world.tips_in_flange_m.get(arm.name, np.array([0.045, 0.02, 0.15]))
        return np.asarray(base_flange @ tip)

    def _put_up(self, arm: SimulatedArm, number: int) -> None:
        """Put something there that a probe's contact feels."""
        place_mm = 1e3 * self._made[arm.name, number][1][:3, 3]
        table = {
            "name": f"mark {number}",
            "kind": "sphere",
            "robot": arm.name,
            "radius_mm": _BALL_MM,
            "place_in_base_mm": place_mm.tolist(),
        }
        self._world.artefacts.append(Artefact(table, self._rng, 0.0))


def _gap_between(there: Array, here: Array) -> Array:
    """Return the way [m] and the rotation vector [rad] (6,) between two frames that are near each other."""
    turn = there[:3, :3] @ here[:3, :3].T
    skew = turn - turn.T
    return np.array([*(there[:3, 3] - here[:3, 3]), *(0.5 * np.array([skew[2, 1], skew[0, 2], skew[1, 0]]))])


def _rotation_matrix(vector: Array) -> Array:
    x, y, z = vector
    small: Array = np.eye(3) + np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    return small
