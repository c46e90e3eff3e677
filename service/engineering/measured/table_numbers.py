"""The usable numbers of a table as observations: units, resolution, and the convention of attitudes."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from cellcal.calibration.arm.kinematics import RobotModel
from cellcal.calibration.errors import CalibrationError
from cellcal.calibration.geometry import Array, log_rotation, mean_rotation
from cellcal.calibration.identification.first_guess import first_guess
from cellcal.calibration.identification.misfit_units import unit_of_lengths, unit_of_points
from cellcal.calibration.identification.observations import (
    LengthObservations,
    Observations,
    PointObservations,
    pose_from_points,
)
from cellcal.calibration.identification.unrounding import find_resolution
from cellcal.calibration.message import make_message
from cellcal.service.engineering.measured.attitudes import attitude_ways, formula_of
from cellcal.service.engineering.measured.columns import TableLayout
from cellcal.service.engineering.measured.unit_choice import UnitChoice
from cellcal.service.engineering.measured.units import ANGLE_UNITS

_LEAST_SIGMA_M = 3e-4  # what an arm adds to any instrument: direction of approach, temperature
_SIGMA_RAD = 2e-3
_CONSISTENT_RAD = float(np.deg2rad(2.0))
_ENOUGH_ROWS = 20_000  # to tell a unit by
_EQUAL = 1.001
_ANGLES = 3  # numbers of an attitude
_TURN_OF_QUATERNION = 2.0  # rad for a unit of its numbers; those of a matrix change by less
_DISTINCT = 0.5  # the best orientation convention must be twice as consistent as the next


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
        try:
            expected = _expected_attitudes(self.model, points)
            best = _fitting_way(expected, attitude_ways(turns, self.layout.turn_fields, self.convention))
            other = best
            if self.convention and not best.fits:
                other = _fitting_way(expected, attitude_ways(turns, self.layout.turn_fields, ""))
        except CalibrationError as error:
            self.units.guesses.append(f"attitudes ({written}) left out: {error.message}")
            return points
        if best.fits:
            self.units.used["convention"] = best.name
            self.units.guesses.append(f"attitude ({written}) read as {best.name}: {formula_of(best.name)}")
            return pose_from_points(points, best.rotations, np.full(len(points), _SIGMA_RAD))
        self.units.guesses.append(_unfit_note(written, best, other))
        return points


@dataclass(frozen=True, eq=False)
class _Way:
    """A way to read attitudes, and how much the tool then turns in the flange."""

    name: str
    rotations: Array  # (N, 3, 3)
    wobble_rad: float
    fits: bool  # and no other way does nearly as well


def _fitting_way(expected: Array, ways: Mapping[str, Array]) -> _Way:
    wobble = {name: _wobble_rad(expected, rotations) for name, rotations in ways.items()}
    best = min(wobble, key=lambda name: wobble[name])
    rivals = [value for value in wobble.values() if value > wobble[best] * _EQUAL]
    fits = wobble[best] <= _CONSISTENT_RAD and not (rivals and wobble[best] > _DISTINCT * min(rivals))
    return _Way(best, ways[best], wobble[best], fits)


def _unfit_note(written: str, best: _Way, other: _Way) -> str:
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


def _expected_attitudes(model: RobotModel, points: PointObservations) -> Array:
    start = first_guess(model, points)[0]
    expected: Array = start.devices[0].device_base[:3, :3] @ model.base_flange(points.joints_rad)[:, :3, :3]
    return expected


def _wobble_rad(expected: Array, measured: Array) -> float:
    """Return how much the tool turns in the flange, median over the rows [rad]."""
    relative = np.swapaxes(expected, 1, 2) @ measured
    try:
        mean = mean_rotation(relative)
    except CalibrationError:
        return float(np.pi)
    return float(np.median(np.linalg.norm(log_rotation(mean.T @ relative), axis=1)))
