"""What a draw-wire can be moved to: alignment points on a fixture, target points on an end-effector.

Imitates
    A machined fixture with seats for the gauge's base adaptor, and an end-effector with holes for its hook.
Source
    F. S. Cheng, Calibration of Robot Reference Frames, 2008, sections 3.2 and 3.3, Fig. 7; a precise base adaptor
    seats within a few hundredths of a millimetre.
Modelled
    Tables [fake.fixture] and [fake.end_effector]: the drawing's points, where the thing roughly stands, and a
    hidden displacement from there; every seat a little off its drawing; a fixture seen from several robots.
Not modelled
    Fixtures that bend or grow warm; two gauges on one seat.

``own_base`` and ``own_flange`` say what "the base" and "the flange" of an arm with link errors are: frames that its
first axis with its zero, and its last one, define. No measurement can tell more.
"""

from collections.abc import Mapping
from typing import Any

import numpy as np

from cellcal.fake_devices.arm import SimulatedArm, make_generator
from cellcal.fake_devices.kinematics import Array, invert_pose, matrix_from_xyzwpr, transform_point

SEAT_SIGMA_M = 2e-5
_AXES = 6


class FakeFixture:
    """A fixture, in the eyes of the fakes."""

    def __init__(self, seed: int, hidden: bool, table: Mapping[str, Any]) -> None:
        self._seed, self._amount = seed, 1.0 if hidden else 0.0
        self.points_m = np.array(table["points_mm"], dtype=float) * 1e-3
        rng = make_generator(seed, "fixture", "seats")
        self._seats_m = self.points_m + self._amount * rng.normal(size=self.points_m.shape) * SEAT_SIGMA_M
        self._rough = {name: matrix_from_xyzwpr(pose) for name, pose in table["seen_from"].items()}
        self._shift_m = float(table.get("sigma_mm", 10.0)) * 1e-3
        self._turn_rad = np.radians(float(table.get("sigma_deg", 0.5)))

    def in_base(self, robot: str) -> Array:
        """Return where the fixture really is, seen from the frame of the robot's drawing, (4, 4)."""
        return self._rough[robot] @ _draw_displacement(
            make_generator(self._seed, "fixture", robot), self._shift_m, self._turn_rad, self._amount
        )

    def seat_in_base(self, robot: str, point: int) -> Array:
        """Return where the wire leaves when its base adaptor sits on one point; points count from 1."""
        if not 1 <= point <= len(self._seats_m):
            raise ValueError(f"the fixture has points 1 to {len(self._seats_m)}")
        return transform_point(self.in_base(robot), self._seats_m[point - 1])


class FakeEndEffector:
    """A tool with target points for the wire's hook."""

    def __init__(self, seed: int, hidden: bool, table: Mapping[str, Any]) -> None:
        amount = 1.0 if hidden else 0.0
        self.targets_m = (
            np.array(table["targets_mm"], dtype=float) * 1e-3
        )  # from the tip, along the tool's axes
        rng = make_generator(seed, "end effector")
        self.flange_tool = matrix_from_xyzwpr(table["flange_tool"]) @ _draw_displacement(
            rng,
            float(table.get("sigma_mm", 2.0)) * 1e-3,
            np.radians(float(table.get("sigma_deg", 0.5))),
            amount,
        )
        self._holes_m = self.targets_m + amount * rng.normal(size=self.targets_m.shape) * SEAT_SIGMA_M

    def hole_in_flange(self, target: int) -> Array:
        """Return where the hook hangs; targets count from 1."""
        if not 1 <= target <= len(self._holes_m):
            raise ValueError(f"the end-effector has targets 1 to {len(self._holes_m)}")
        return transform_point(self.flange_tool, self._holes_m[target - 1])


def own_base(arm: SimulatedArm) -> Array:
    """Return the base that the arm's first axis and its zero define, seen from its drawing's base, (4, 4).

    The joint side rests half the backlash short of the motor side when it comes from below.
    """
    error = arm.true_dh[0] - arm.nominal_dh[0]
    turn = error[0] - _resting_short(arm, 0)
    return _screw_matrix(turn, error[1])


def own_flange(arm: SimulatedArm) -> Array:
    """Return the drawing's flange seen from the flange that the arm's last axis and its zero define, (4, 4)."""
    drawn, real = arm.nominal_dh[-1], arm.true_dh[-1]
    short = _screw_matrix(-_resting_short(arm, _AXES - 1), 0.0)
    return invert_pose(_dh_row_matrix(drawn)) @ short @ _dh_row_matrix(real)


def _resting_short(arm: SimulatedArm, axis: int) -> float:
    return float(arm.hidden.backlash_rad[axis]) / 2.0


def _dh_row_matrix(row: Array) -> Array:
    theta, d, a, alpha, _ = (float(value) for value in row)
    tilt = np.eye(4)
    tilt[1:3, 1:3] = [[np.cos(alpha), -np.sin(alpha)], [np.sin(alpha), np.cos(alpha)]]
    tilt[0, 3] = a
    return _screw_matrix(theta, d) @ tilt


def _screw_matrix(turn_rad: float, rise_m: float) -> Array:
    pose = np.eye(4)
    pose[:2, :2] = [[np.cos(turn_rad), -np.sin(turn_rad)], [np.sin(turn_rad), np.cos(turn_rad)]]
    pose[2, 3] = rise_m
    return pose


def _draw_displacement(rng: np.random.Generator, shift_m: float, turn_rad: float, amount: float) -> Array:
    shift, turn = (np.clip(rng.normal(size=3), -2.0, 2.0) * size * amount for size in (shift_m, turn_rad))
    return matrix_from_xyzwpr([*(shift * 1e3), *np.degrees(turn)])
