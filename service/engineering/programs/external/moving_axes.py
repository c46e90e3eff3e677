"""External axes of a cell: tracks that carry the robot, positioners that carry the work.

All poses are in the cell frame, the robot's base with every track at its zero. An axis at its zero moves nothing.
"""

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from enum import StrEnum

import numpy as np

from cellcal.calibration.geometry import Array, homogeneous_matrix, inverse_transform
from cellcal.calibration.message import make_message
from cellcal.drivers.programs.conditions import AxisUnit, ExternalColumn
from cellcal.service.engineering.programs.named_entries import name_without_numbers

ANY_FRAME = "*"  # a positioner carries the work of all points
_SPACING = re.compile(r"[\s:,_]+")


class AxisKind(StrEnum):
    """The kinds of motion of an axis."""

    PRISMATIC = "prismatic"
    REVOLUTE = "revolute"

    @property
    def unit(self) -> str:
        """Return the unit that a file writes its values in."""
        return "mm" if self is AxisKind.PRISMATIC else "deg"

    @property
    def per_unit(self) -> float:
        """Return one such unit in metres or radians."""
        return 1e-3 if self is AxisKind.PRISMATIC else np.pi / 180.0


@dataclass(frozen=True, eq=False)
class AxisMotion:
    """The motion of an axis and of what it carries."""

    kind: AxisKind
    origin_m: Array  # (3,) a point of the axis
    direction: Array  # (3,) unit
    zero: float  # the value [m or rad] at which it moves nothing
    sign: float  # 1 or -1
    scale: float = 1.0  # travel for each unit of the value

    def displacements(self, values: Array) -> Array:
        """Return how far (N,) the axis is from its zero [m or rad]."""
        found: Array = self.sign * self.scale * (values - self.zero)
        return found

    def values_at(self, displacements: Array) -> Array:
        """Return the values (N,) at given displacements."""
        found: Array = self.zero + self.sign * displacements / self.scale
        return found

    def carried_poses(self, values: Array) -> Array:
        """Return what the axis does (N, 4, 4) to poses that it carries."""
        moved = self.displacements(values)
        if self.kind is AxisKind.PRISMATIC:
            places = moved[:, None] * self.direction
            return homogeneous_matrix(np.broadcast_to(np.eye(3), (len(moved), 3, 3)), places)
        x, y, z = self.direction
        cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
        turn = (
            np.eye(3)
            + np.sin(moved)[:, None, None] * cross
            + (1.0 - np.cos(moved))[:, None, None] * (cross @ cross)
        )
        return homogeneous_matrix(turn, self.origin_m - turn @ self.origin_m)


@dataclass(frozen=True, eq=False)
class ExternalAxis:
    """One axis of a cell."""

    name: str  # the project's own
    axis: str  # as programs name it
    carries_robot: bool  # a track; else a positioner
    coordinated: bool  # the controller computes with it
    entered: AxisMotion  # as the controller has it
    real: AxisMotion  # as it was identified; the same where it was not
    frame: Array  # (4, 4) of the axis at its zero, in the cell frame
    lower: float  # [m or rad]
    upper: float
    pulses_per_unit: float | None = None  # for each metre or radian
    frames: tuple[str, ...] = ()  # user frames whose points are at the work that it carries

    @property
    def kind(self) -> AxisKind:
        """Return how it moves."""
        return self.entered.kind

    def values_in_si(self, column: ExternalColumn, written: Array) -> Array:
        """Return values (N,) [m or rad] of a column of `Positions.all_external_axes`."""
        found: Array = written * self._per_written(column)
        return found

    def written_values(self, column: ExternalColumn, values: Array) -> Array:
        """Return values (N,) as `Positions.all_external_axes` has them."""
        found: Array = values / self._per_written(column)
        return found

    def _per_written(self, column: ExternalColumn) -> float:
        if column.unit is AxisUnit.PULSES:
            return 1.0 / (self.pulses_per_unit or np.nan)
        if column.unit is AxisUnit.UNSTATED:
            return self.kind.per_unit * 1e3
        return 1.0

    def contradiction_of(self, column: ExternalColumn) -> str:
        """Return why a file's column cannot be this axis, "" where it can."""
        other = {AxisUnit.MILLIMETRES: AxisKind.PRISMATIC, AxisUnit.DEGREES: AxisKind.REVOLUTE}.get(
            column.unit
        )
        if column.unit is AxisUnit.MIXED:
            return make_message("its program writes {axis} in several units", axis=self.axis)
        if other not in (None, self.kind):
            return make_message(
                "its program writes {axis} in {unit}, and the project says that it is {kind}",
                axis=self.axis,
                unit=column.unit,
                kind=self.kind,
            )
        if column.unit is AxisUnit.PULSES and self.pulses_per_unit is None:
            return make_message(
                "it holds {axis} in pulses, and the project gives no pulses_per_{unit} for it",
                axis=self.axis,
                unit=self.kind.unit,
            )
        return ""


def same_axis(one: str, other: str) -> bool:
    """Return whether two names mean one axis: case, blanks and colons do not count."""
    return axis_key(one) == axis_key(other)


def axis_key(name: str) -> str:
    """Return an axis' name as it is compared."""
    return _SPACING.sub("", name).upper()


@dataclass(frozen=True, eq=False)
class CellAxes:
    """All external axes of a cell, in the order of the project: an axis carries those behind it."""

    axes: tuple[ExternalAxis, ...] = ()
    fixture_at: Mapping[str, float] = field(
        default_factory=dict
    )  # by name, [m or rad], while it was measured

    def __len__(self) -> int:
        """Return how many there are."""
        return len(self.axes)

    def carriers_of(self, frame: str | None, *, caseless: bool) -> tuple[int, ...]:
        """Return the positioners that carry the work of a user frame's points."""
        return tuple(
            number
            for number, axis in enumerate(self.axes)
            if not axis.carries_robot and _lists_frame(axis.frames, frame, caseless=caseless)
        )

    def base_poses(self, values: Array, *, real: bool) -> Array:
        """Return where the robot's base stands (N, 4, 4) at values (N, A)."""
        return self._product(values, [n for n, axis in enumerate(self.axes) if axis.carries_robot], real=real)

    def work_poses(self, values: Array, carriers: Sequence[int], *, real: bool) -> Array:
        """Return what positioners do (N, 4, 4) to the work."""
        return self._product(values, carriers, real=real)

    def entered_frame_poses(self, values: Array, carriers: Sequence[int], *, fixed_to_robot: bool) -> Array:
        """Return what carries a user frame (N, 4, 4) in the robot's base, as its controller computes it."""
        tracks = [
            number
            for number, axis in enumerate(self.axes)
            if axis.carries_robot and axis.coordinated and not fixed_to_robot
        ]
        tables = [number for number in carriers if self.axes[number].coordinated]
        found: Array = inverse_transform(self._product(values, tracks, real=False)) @ self._product(
            values, tables, real=False
        )
        return found

    def cell_fixture_motion(self) -> Array:
        """Return what brings places that the robot saw at the fixture to the cell frame (4, 4)."""
        at = np.array([[self.fixture_at.get(axis.name, axis.entered.zero) for axis in self.axes]])
        tables = [
            number
            for number, axis in enumerate(self.axes)
            if not axis.carries_robot and axis.name in self.fixture_at
        ]
        found: Array = inverse_transform(self.work_poses(at, tables, real=True)) @ self.base_poses(
            at, real=True
        )
        return np.asarray(found[0], dtype=np.float64)

    def _product(self, values: Array, which: Sequence[int], *, real: bool) -> Array:
        found = np.broadcast_to(np.eye(4), (len(values), 4, 4))
        for number in which:
            axis = self.axes[number]
            found = found @ (axis.real if real else axis.entered).carried_poses(values[:, number])
        return found


def _lists_frame(frames: Sequence[str], frame: str | None, *, caseless: bool) -> bool:
    if ANY_FRAME in frames:
        return True
    if frame is None:
        return False
    frame = name_without_numbers(frame)
    if caseless:
        return frame.lower() in {each.lower() for each in frames}
    return frame in frames


NO_AXES = CellAxes()
