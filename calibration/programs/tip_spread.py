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
from cellcal.calibration.arm.kinematics import cross_product, placement_columns
from cellcal.calibration.compensation.pose_gap import TipArm
from cellcal.calibration.errors import CalibrationError
from cellcal.calibration.geometry import Array, adjoint_matrix, inverse_transform, skew_matrix
from cellcal.calibration.identification.observations import DevicePlacement
from cellcal.calibration.identification.parameters import ArmState, ParameterLayout

_BLOCK = 4096
_LEAST_VARIANCE_SHARE = 1e-14  # of the largest variance in scaled parameters
_POSTURES, _WIDE_RAD = 200, 1.6  # that stand for all the arm can do
_FEWEST = 4  # postures that tell a rigid motion


@dataclass(frozen=True, eq=False)
class TipSpread:
    """An identified arm, its tool, and the roots of its covariance."""

    state: ArmState
    layout: ParameterLayout
    covariance: Array  # (p, p) of the layout's parameters; zero where nothing is said
    of_tool: Array | None = None  # (r, 3) shifts of the tip in the flange, taken out of each root
    shared: Array | None = None  # (r, 6) rigid motions of the base, likewise

    @cached_property
    def tip_arm(self) -> TipArm:
        """The arm with its tip, sag and ripple."""
        return TipArm.of_state(self.state)

    @cached_property
    def _combined_roots(self) -> Array:
        """Roots (r, 6 (n + 1) + K): independent unit errors, as twists of placements and as terms."""
        scale = np.sqrt(np.diag(self.covariance))
        is_known = scale > 0
        unit = self.covariance[np.ix_(is_known, is_known)] / np.outer(scale[is_known], scale[is_known])
        values, vectors = np.linalg.eigh(unit)
        is_significant = values > _LEAST_VARIANCE_SHARE * max(float(values[-1]), 0.0)
        root = scale[is_known, None] * vectors[:, is_significant] * np.sqrt(values[is_significant])
        placed = replace(self.state, devices=(DevicePlacement(np.eye(4), np.zeros(3)),))
        tangent: Array = root.T @ self.layout.tangent_rows(placed, 0)[is_known]
        n, first = self.state.nominal.axis_count, inverse_transform(self.state.arm_model.placements[0])
        if self.of_tool is not None:
            tangent[:, 6 * n : 6 * n + 3] -= self.of_tool
        if self.shared is not None:
            tangent[:, :6] -= self.shared @ adjoint_matrix(first).T
        return tangent

    def tip_slopes(self, joints_rad: Array) -> Array:
        """Return what each root does to the tip, (r, 3, N) [m], in the base's axes."""
        arm, state = self.tip_arm, self.state
        rotations, origins = arm.compute_frames(joints_rad.T)
        columns = placement_columns(rotations, origins, origins[-1])
        n, count = state.nominal.axis_count, len(joints_rad)
        rows = [columns.reshape(6 * (n + 1), 3 * count)]
        if len(state.terms):
            values = term_values(state.nominal, joints_rad, state.terms)
            turns = cross_product(rotations[:-1, :, 2], origins[-1] - origins[:-1])
            at = [term.joint for term in state.terms]
            rows.append((turns[at] * values[:, None]).reshape(len(at), 3 * count))
        slopes: Array = (self._combined_roots @ np.concatenate(rows)).reshape(-1, 3, count)
        return slopes

    def with_own_tool(self) -> "TipSpread":
        """Return the spread with a tool that this arm has measured."""
        plain = replace(self, of_tool=None, shared=None)
        model = self.state.nominal
        low, high = np.maximum(model.lower_rad, -_WIDE_RAD), np.minimum(model.upper_rad, _WIDE_RAD)
        joints = np.random.default_rng(1).uniform(low, high, (_POSTURES, model.axis_count))
        rotations = self.tip_arm.compute_frames(joints.T)[0][-1].transpose(2, 0, 1)
        solved = _solve_motions(plain, joints, rotations)
        return replace(plain, of_tool=solved[:, 6:])

    def relative_to(self, joints_rad: Array) -> "TipSpread":
        """Return the spread against a frame that this arm found at these postures (M, n).

        Raises
        ------
        CalibrationError
            Fewer postures than tell a rigid motion.
        """
        if len(joints_rad) < _FEWEST:
            raise CalibrationError(f"{_FEWEST} postures or more tell where a fixture was found")
        plain = replace(self, shared=None)
        return replace(plain, shared=_solve_motions(plain, joints_rad, None))

    def tip_covariances(self, joints_rad: Array) -> Array:
        """Return the covariance of the tip's place (N, 3, 3) [m^2], in the base's axes."""
        found = np.empty((len(joints_rad), 3, 3))
        for first in range(0, len(joints_rad), _BLOCK):
            block = slice(first, first + _BLOCK)
            slopes = self.tip_slopes(joints_rad[block]).transpose(2, 1, 0)
            found[block] = slopes @ slopes.swapaxes(1, 2)
        return found


def frame_covariances(covariance: Array, points_m: Array) -> Array:
    """Return what the right twist (v, w) of a frame does to points (N, 3) in it: (N, 3, 3) [m^2], in its axes."""
    design = np.concatenate(
        [np.broadcast_to(np.eye(3), (len(points_m), 3, 3)), -skew_matrix(points_m)], axis=2
    )
    found: Array = design @ covariance @ design.swapaxes(1, 2)
    return found


def expanded_uncertainty(covariances: Array) -> Array:
    """Return U (k = 2) in the worst direction (N,) [m]."""
    largest = np.maximum(np.linalg.eigvalsh(covariances)[:, -1], 0.0)
    return np.asarray(2.0 * np.sqrt(largest), dtype=np.float64)


def _solve_motions(spread: TipSpread, joints_rad: Array, rotations: Array | None) -> Array:
    """Return the rigid motions (r, 6), and tool shifts (r, 9) where rotations are given, nearest to each root."""
    slopes = spread.tip_slopes(joints_rad)
    tips = spread.tip_arm.compute_frames(joints_rad.T)[1][-1].T
    columns = [np.broadcast_to(np.eye(3), (len(tips), 3, 3)), -skew_matrix(tips)]
    columns += [] if rotations is None else [rotations]
    design = np.concatenate(columns, axis=2).reshape(3 * len(tips), -1)
    right = slopes.transpose(2, 1, 0).reshape(3 * len(tips), -1)
    solved = np.linalg.lstsq(design, right, rcond=1e-9)[0].T
    return np.asarray(solved, dtype=np.float64)
