"""What the pictures of an identification show, computed once: residuals with their signs, places, predictions."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from cellcal.calibration.arm.joint_kinds import shown_units
from cellcal.calibration.arm.joint_terms import term_values
from cellcal.calibration.arm.shown_names import shown_name
from cellcal.calibration.geometry import Array
from cellcal.calibration.identification.estimator import FitProblem, whitened_residuals
from cellcal.calibration.identification.observations import (
    LengthObservations,
    Observations,
    PoseObservations,
    Rows,
)
from cellcal.calibration.identification.parameters import ArmState
from cellcal.calibration.mastering.pose_design import candidate_joints
from cellcal.calibration.motion.motion_check import MotionLimits
from cellcal.calibration.poses.measurement_prediction import MeasurementPrediction, TestPoses
from cellcal.service.engineering.identification.identify import IdentifyReport

_REACHABLE = 4000  # postures: enough for a few in every cell of the map
_BATCH = 500
_MOST_DOTS = 20_000


@dataclass(frozen=True, eq=False)
class PredictedReach:
    """Postures all over the arm's reach, and how well the tool point will be known there."""

    places_m: Array  # (M, 3) in the base frame
    sigma_m: Array  # (M,) of the distance, k = 1


@dataclass(frozen=True, eq=False)
class IdentificationEvidence:
    """One identification, as its pictures want it."""

    report: IdentifyReport

    @property
    def identified_state(self) -> ArmState:
        """The identified arm."""
        return self.report.identification.state

    @cached_property
    def fitted_observations(self) -> Observations:
        """The rows that took part in the fit, the rejected ones included."""
        return self.report.identification.robust.problem.observations

    @cached_property
    def fitted_rows(self) -> Rows:
        """The rows of the file that those are."""
        return self.report.fitted_rows

    @property
    def figure_title(self) -> str:
        """Whose pictures these are."""
        return shown_name(self.report.robot)

    @property
    def model_level(self) -> int:
        """Of the model."""
        return self.report.level

    @property
    def joints_rad(self) -> Array:
        """Of the fitted rows (N, n)."""
        return self.fitted_observations.joints_rad

    @property
    def joint_units(self) -> tuple[Array, tuple[str, ...]]:
        """The factors with which joints are shown (n,), and the units."""
        return shown_units(self.identified_state.nominal)

    @property
    def held_out_rows(self) -> Rows:
        """Rows of the file that were held out (H,)."""
        return self.report.held_out_rows

    @property
    def held_out_m(self) -> Array:
        """Their errors (H,)."""
        return self.report.held_out_m

    @property
    def before_m(self) -> Array:
        """Their errors with base and tool fitted to the nominal arm (H,)."""
        return self.report.before_m

    @property
    def rejected_rows(self) -> list[int]:
        """Rows of the file that were not fitted."""
        return [item.row for item in self.report.rejected]

    @property
    def mounting_breaks(self) -> tuple[int, ...]:
        """Rows of the file before which the device was moved."""
        return self.report.breaks

    @property
    def rejected_positions(self) -> Rows:
        """Positions among the fitted rows."""
        return self.report.identification.rejected

    @cached_property
    def fit_residuals(self) -> Array:
        """Measured minus fitted (channels, N) [m, rad]."""
        return _signed_residuals(self.identified_state, self.fitted_observations)

    @cached_property
    def residuals_before(self) -> Array:
        """The same with base and tool fitted to the nominal arm."""
        return _signed_residuals(self.report.identification.frames, self.fitted_observations)

    @cached_property
    def held_out_joints_rad(self) -> Array:
        """Joints of the held-out rows."""
        measurements = self.report.measurements
        at = np.searchsorted(measurements.rows, self.report.held_out_rows)
        joints: Array = measurements.observations.joints_rad[at]
        return joints

    @cached_property
    def held_out_places_m(self) -> Array:
        """Where the target was at the held-out rows (N, 3), seen from the base."""
        return places_of(self.identified_state, self.held_out_joints_rad)

    @cached_property
    def predicted_reach(self) -> PredictedReach:
        """The arm's reach with the tool point's predicted uncertainty."""
        joints = candidate_joints(self.identified_state.nominal, MotionLimits(), _REACHABLE)
        return PredictedReach(places_of(self.identified_state, joints), self.sigma_m(joints))

    def sigma_m(self, joints_rad: Array) -> Array:
        """Return the standard uncertainty of the target's place (N,) that the fit's covariance predicts."""
        fit = self.report.identification.robust.fit
        size = len(fit.layout)
        prediction = MeasurementPrediction(
            fit.layout, fit.state, self._not_measured, np.ones(size), np.eye(size)
        )
        # In one piece: lengths lose a rigid motion of all postures together.
        rows = TestPoses(joints_rad).tool_point_rows(prediction).reshape(size, -1)
        variance = np.empty(rows.shape[1])
        for at in range(0, rows.shape[1], _BATCH):
            part = rows[:, at : at + _BATCH]
            variance[at : at + _BATCH] = np.einsum("pn,pn->n", part, fit.covariance @ part)
        sigma: Array = np.sqrt(np.maximum(variance.reshape(3, -1).sum(axis=0), 0.0))
        return sigma

    def _not_measured(self, joints_rad: Array) -> Observations:
        return self.fitted_observations.select_rows(np.arange(0))

    @cached_property
    def signed_mm(self) -> dict[str, tuple[Array, Array]]:
        """Residuals before and after [mm] in directions that a technician can recognize at the robot.

        Outwards, sideways and upwards from the first axis for positions; along the wire for lengths.
        """
        if isinstance(self.fitted_observations, LengthObservations):
            return {"along the wire": (self.residuals_before[0] * 1e3, self.fit_residuals[0] * 1e3)}
        pair = [
            self._around_first_axis(state, residuals)
            for state, residuals in (
                (self.report.identification.frames, self.residuals_before),
                (self.identified_state, self.fit_residuals),
            )
        ]
        names = ("outwards", "sideways", "upwards")
        return {name: (pair[0][i] * 1e3, pair[1][i] * 1e3) for i, name in enumerate(names)}

    def _around_first_axis(self, state: ArmState, residuals: Array) -> Array:
        turns = np.array([device.device_base[:3, :3] for device in state.devices])[
            self.fitted_observations.mounting
        ]
        in_base = np.einsum("nji,jn->in", turns, residuals[:3])
        places = places_of(state, self.fitted_observations.joints_rad)
        angle = np.arctan2(places[:, 1], places[:, 0])
        cos, sin = np.cos(angle), np.sin(angle)
        outwards, sideways = cos * in_base[0] + sin * in_base[1], cos * in_base[1] - sin * in_base[0]
        return np.stack([outwards, sideways, in_base[2]])

    @property
    def channel_names(self) -> tuple[str, ...]:
        """The names of the residuals' channels, in the device's frame."""
        if isinstance(self.fitted_observations, LengthObservations):
            return ("length",)
        turns = (
            ("turn x", "turn y", "turn z") if isinstance(self.fitted_observations, PoseObservations) else ()
        )
        return ("x", "y", "z", *turns)


def places_of(state: ArmState, joints_rad: Array) -> Array:
    """Return where the target is (N, 3) in the base frame, sag and ripple included [m]."""
    moved = state.moved_joints(joints_rad, term_values(state.nominal, joints_rad, state.terms))
    return state.arm_model.tip_positions(moved, state.flange_tool[:3, 3])


def thin_rows(errors: Array) -> Rows:
    """Return which rows to draw: all of them, or of very many an even share and the largest."""
    count = len(errors)
    if count <= _MOST_DOTS:
        return np.arange(count)
    even = np.linspace(0, count - 1, _MOST_DOTS).astype(np.intp)
    worst = np.argpartition(errors, -_MOST_DOTS // 20)[-_MOST_DOTS // 20 :]
    return np.union1d(even, worst)


def _signed_residuals(state: ArmState, observations: Observations) -> Array:
    white = whitened_residuals(state, FitProblem.from_observations(state, observations))
    found: Array = white / np.broadcast_to(observations.inverse_sigmas(slice(None)), white.shape)
    return found
