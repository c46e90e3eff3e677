"""The usable numbers of a table as observations: units, resolution, and the convention of attitudes."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from cellcal.calibration.arm.kinematics import RobotModel
from cellcal.calibration.errors import CalibrationError
from cellcal.calibration.geometry import Array
from cellcal.calibration.identification.misfit_units import unit_of_lengths, unit_of_points
from cellcal.calibration.identification.observations import (
    LengthObservations,
    Observations,
    PointObservations,
    PoseObservations,
    pose_from_points,
)
from cellcal.calibration.identification.unrounding import find_resolution
from cellcal.calibration.message import make_message
from cellcal.service.engineering.measured.attitude_fit import FittingWay, expected_attitudes, fitting_way
from cellcal.service.engineering.measured.attitudes import attitude_ways, formula_of
from cellcal.service.engineering.measured.columns import TableLayout
from cellcal.service.engineering.measured.inverted_poses import invert_poses, is_inverse_pose
from cellcal.service.engineering.measured.unit_choice import UnitChoice
from cellcal.service.engineering.measured.units import ANGLE_UNITS

_LEAST_SIGMA_M = 3e-4  # what an arm adds to any instrument: direction of approach, temperature
_SIGMA_RAD = 2e-3
_ENOUGH_ROWS = 20_000  # to tell a unit by
_ANGLES = 3  # numbers of an attitude
_TURN_OF_QUATERNION = 2.0  # rad for a unit of its numbers; those of a matrix change by less


@dataclass(frozen=True, eq=False)
class TableNumbers:
    """The usable numbers of a file with what is known about them."""

    layout: TableLayout
    numbers: Mapping[str, Array]
    model: RobotModel
    convention: str  # of attitudes, as typed; empty where it is to be found
    units: UnitChoice
    joints_rad: Array

    def stack_columns(self, names: Sequence[str]) -> Array:
        """Return some columns side by side (N, k)."""
        return np.column_stack([self.numbers[name] for name in names])

    def spread_m(self) -> float:
        """Return how far the nominal flange moved about its mean (RMS) [m]."""
        some = self.joints_rad[:: 1 + len(self.joints_rad) // _ENOUGH_ROWS]
        reach = self.model.tip_positions(some, np.zeros(3))
        return float(np.sqrt(((reach - reach.mean(axis=0)) ** 2).sum(axis=1).mean()))

    def controller_positions(self) -> tuple[Array | None, float]:
        """Return the controller's own positions and their resolution [m]."""
        if not self.layout.controller:
            return None, 0.0
        raw = self.stack_columns(self.layout.controller)
        if not np.isfinite(raw).all():
            return None, 0.0
        unit = self.units.length_factor("controller", self.layout.controller, raw, self.spread_m())
        return raw * unit, max(find_resolution(column) for column in raw.T) * unit

    def observations(self) -> tuple[Observations, float]:
        """Return what the device read, and its resolution [m]."""
        layout, count = self.layout, len(self.joints_rad)
        once = np.zeros(count, dtype=np.intp)
        if layout.length:
            raw = self.numbers[layout.length]
            unit = self.units.length_factor(
                "length",
                (layout.length,),
                raw[:, None],
                0.0,
                lambda units: unit_of_lengths(self.model, self.joints_rad, raw, units),
            )
            sigma = self._row_sigmas(unit)
            return LengthObservations(self.joints_rad, raw * unit, sigma, once), find_resolution(raw) * unit
        raw = self.stack_columns(layout.position)
        unit = self.units.length_factor(
            "position",
            layout.position,
            raw,
            self.spread_m(),
            lambda units: unit_of_points(self.model, self.joints_rad, raw, units),
        )
        points = PointObservations(self.joints_rad, raw * unit, self._row_sigmas(unit), once)
        step = max(find_resolution(column) for column in raw.T) * unit
        if not layout.turn or self.convention == "none":
            return points, step
        return self._with_attitudes(points), step

    def attitude_step_rad(self) -> float:
        """Return to what attitudes are rounded [rad], 0 without any."""
        if not self.layout.turn:
            return 0.0
        step = max(find_resolution(column) for column in self.stack_columns(self.layout.turn).T)
        if len(self.layout.turn) == _ANGLES:
            return step * ANGLE_UNITS[self.units.used.get("rotation", "rad")]
        return _TURN_OF_QUATERNION * step

    def _row_sigmas(self, unit: float) -> Array:
        """Return one sigma a row [m]: the instrument's own, and what any arm adds to it."""
        count = len(self.joints_rad)
        names = self.layout.spread
        own = np.nan_to_num(self.stack_columns(names)) ** 2 if names else np.zeros((count, 1))
        sigma: Array = np.sqrt(_LEAST_SIGMA_M**2 + own.mean(axis=1) * unit**2)
        return sigma

    def _with_attitudes(self, points: PointObservations) -> Observations:
        """Add attitudes if one convention makes the tool sit still in the flange; else leave them out."""
        written = ", ".join(self.layout.turn)
        turns = self.stack_columns(self.layout.turn)
        if len(self.layout.turn) == _ANGLES:
            turns = turns * self.units.angle_factor("rotation", self.layout.turn, turns)
        if is_inverse_pose(self.convention):
            return self._with_inverted_poses(points, turns) or self._leave_out(points, written)
        try:
            expected = expected_attitudes(self.model, points)
            best = fitting_way(expected, attitude_ways(turns, self.layout.turn_fields, self.convention))
            other = best
            if self.convention and not best.fits:
                other = fitting_way(expected, attitude_ways(turns, self.layout.turn_fields, ""))
        except CalibrationError as error:
            self.units.guesses.append(
                make_message("attitudes ({names}) left out: {reason}", names=written, reason=error.message)
            )
            return points
        if best.fits:
            self.units.used["convention"] = best.name
            self.units.guesses.append(
                make_message(
                    "attitude ({names}) read as {convention}: {formula}",
                    names=written,
                    convention=best.name,
                    formula=formula_of(best.name),
                )
            )
            return pose_from_points(points, best.rotations, np.full(len(points), _SIGMA_RAD))
        inverted = None if self.convention else self._with_inverted_poses(points, turns)
        if inverted is not None:
            return inverted
        self.units.guesses.append(_unfit_note(written, best, other))
        return points

    def _with_inverted_poses(self, points: PointObservations, turns: Array) -> PoseObservations | None:
        """Return the target seen from the device, if each row has the device seen from the target."""
        found = invert_poses(self.model, points, turns, self.layout.turn_fields, self.convention)
        if found is None:
            return None
        self.units.used["convention"] = found.convention
        self.units.guesses.append(
            make_message(
                "pose ({written}) read as {convention}: the device seen from the target, as by a camera on the "
                "flange, and inverted",
                written=", ".join((*self.layout.position, *self.layout.turn)),
                convention=found.convention,
            )
        )
        return pose_from_points(found.points, found.rotations, np.full(len(points), _SIGMA_RAD))

    def _leave_out(self, points: PointObservations, written: str) -> PointObservations:
        self.units.guesses.append(
            make_message(
                "{written} do not fit as {convention}: attitudes left out",
                written=written,
                convention=self.convention,
            )
        )
        return points


def _unfit_note(written: str, best: FittingWay, other: FittingWay) -> str:
    angle = np.rad2deg(best.wobble_rad)
    if other.fits:
        return make_message(
            "{written} do not fit as {stated} (the tool turns by {angle:.2f} deg in the flange): attitudes left out; "
            "`--convention {fitting}` fits",
            written=written,
            stated=best.name,
            angle=angle,
            fitting=other.name,
        )
    return make_message(
        "no orientation convention fits {written} (best {best}, {angle:.2f} deg): attitudes left out; see whether "
        "the columns are called right (`--columns rotation=…`)",
        written=written,
        best=best.name,
        angle=angle,
    )
