"""How surely an identified arm's tip is where it is computed, against a fixture and with a tool that it has found.

What all postures share, a base that is turned a little or a first joint's offset, is in the alignment as well, and
misses nothing at the fixture; what turns with the flange is in the measured tool. An identification cannot tell such
errors apart, and keeps them with large variances. So the errors that shift the tip alike in the flange, over all the
arm can do, and then those that move its postures at the fixture as one rigid body, are taken out: what remains is
what the points of a program miss.
"""

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from cellcal.calibration.arm.joint_terms import term_values
from cellcal.calibration.arm.kinematics import cross, placement_columns
from cellcal.calibration.compensation.pose_gap import Arm
from cellcal.calibration.errors import CalibrationError
from cellcal.calibration.geometry import Array, adjoint, inverse_transform, skew
from cellcal.calibration.identification.observations import Device
from cellcal.calibration.identification.parameters import ArmState, Layout

_BLOCK = 4096
_KNOWN = 1e-14  # of the largest variance in scaled parameters
_POSTURES, _WIDE_RAD = 200, 1.6  # that stand for all the arm can do
_FEWEST = 4  # postures that tell a rigid motion


@dataclass(frozen=True, eq=False)
class TipSpread:
    """An identified arm, its tool, and the roots of its covariance."""

    state: ArmState
    layout: Layout
    covariance: Array  # (p, p) of the layout's parameters; zero where nothing is said
    of_tool: Array | None = None  # (r, 3) shifts of the tip in the flange, taken out of each root
    shared: Array | None = None  # (r, 6) rigid motions of the base, likewise

    @cached_property
    def arm(self) -> Arm:
        """The arm with its tip, sag and ripple."""
        return Arm.of_state(self.state)

    @cached_property
    def _combined(self) -> Array:
        """Roots (r, 6 (n + 1) + K): independent unit errors, as twists of placements and as terms."""
        scale = np.sqrt(np.diag(self.covariance))
        known = scale > 0
        unit = self.covariance[np.ix_(known, known)] / np.outer(scale[known], scale[known])
        values, vectors = np.linalg.eigh(unit)
        kept = values > _KNOWN * max(float(values[-1]), 0.0)
        root = scale[known, None] * vectors[:, kept] * np.sqrt(values[kept])
        placed = replace(self.state, devices=(Device(np.eye(4), np.zeros(3)),))
        tangent: Array = root.T @ self.layout.tangent(placed, 0)[known]
        n, first = self.state.nominal.axes, inverse_transform(self.state.arm.placements[0])
        if self.of_tool is not None:
            tangent[:, 6 * n : 6 * n + 3] -= self.of_tool
        if self.shared is not None:
            tangent[:, :6] -= self.shared @ adjoint(first).T
        return tangent

    def slopes(self, joints_rad: Array) -> Array:
        """Return what each root does to the tip, (r, 3, N) [m], in the base's axes."""
        arm, state = self.arm, self.state
        rotations, origins = arm.frames(joints_rad.T)
        columns = placement_columns(rotations, origins, origins[-1])
        n, count = state.nominal.axes, len(joints_rad)
        rows = [columns.reshape(6 * (n + 1), 3 * count)]
        if len(state.terms):
            values = term_values(state.nominal, joints_rad, state.terms)
            turns = cross(rotations[:-1, :, 2], origins[-1] - origins[:-1])
            at = [term.joint for term in state.terms]
            rows.append((turns[at] * values[:, None]).reshape(len(at), 3 * count))
        slopes: Array = (self._combined @ np.concatenate(rows)).reshape(-1, 3, count)
        return slopes

    def with_own_tool(self) -> "TipSpread":
        """Return the spread with a tool that this arm has measured."""
        plain = replace(self, of_tool=None, shared=None)
        model = self.state.nominal
        low, high = np.maximum(model.lower_rad, -_WIDE_RAD), np.minimum(model.upper_rad, _WIDE_RAD)
        joints = np.random.default_rng(1).uniform(low, high, (_POSTURES, model.axes))
        rotations = self.arm.frames(joints.T)[0][-1].transpose(2, 0, 1)
        solved = _solved(plain, joints, rotations)
        return replace(plain, of_tool=solved[:, 6:])

    def against(self, joints_rad: Array) -> "TipSpread":
        """Return the spread against a frame that this arm found at these postures (M, n).

        Raises
        ------
        CalibrationError
            Fewer postures than tell a rigid motion.
        """
        if len(joints_rad) < _FEWEST:
            raise CalibrationError(f"{_FEWEST} postures or more tell where a fixture was found")
        plain = replace(self, shared=None)
        return replace(plain, shared=_solved(plain, joints_rad, None))

    def covariances(self, joints_rad: Array) -> Array:
        """Return the covariance of the tip's place (N, 3, 3) [m^2], in the base's axes."""
        found = np.empty((len(joints_rad), 3, 3))
        for first in range(0, len(joints_rad), _BLOCK):
            block = slice(first, first + _BLOCK)
            slopes = self.slopes(joints_rad[block]).transpose(2, 1, 0)
            found[block] = slopes @ slopes.swapaxes(1, 2)
        return found


def frame_covariances(covariance: Array, points_m: Array) -> Array:
    """Return what the right twist (v, w) of a frame does to points (N, 3) in it: (N, 3, 3) [m^2], in its axes."""
    design = np.concatenate([np.broadcast_to(np.eye(3), (len(points_m), 3, 3)), -skew(points_m)], axis=2)
    found: Array = design @ covariance @ design.swapaxes(1, 2)
    return found


def expanded(covariances: Array) -> Array:
    """Return U (k = 2) in the worst direction (N,) [m]."""
    largest = np.maximum(np.linalg.eigvalsh(covariances)[:, -1], 0.0)
    return np.asarray(2.0 * np.sqrt(largest), dtype=np.float64)


def _solved(spread: TipSpread, joints_rad: Array, rotations: Array | None) -> Array:
    """Return the rigid motions (r, 6), and tool shifts (r, 9) where rotations are given, nearest to each root."""
    slopes = spread.slopes(joints_rad)
    tips = spread.arm.frames(joints_rad.T)[1][-1].T
    columns = [np.broadcast_to(np.eye(3), (len(tips), 3, 3)), -skew(tips)]
    columns += [] if rotations is None else [rotations]
    design = np.concatenate(columns, axis=2).reshape(3 * len(tips), -1)
    right = slopes.transpose(2, 1, 0).reshape(3 * len(tips), -1)
    solved = np.linalg.lstsq(design, right, rcond=1e-9)[0].T
    return np.asarray(solved, dtype=np.float64)
