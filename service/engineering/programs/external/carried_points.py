"""What external axes mean for points that share tool and frame: frames, arms and changes, row by row.

With B where the robot's base stands and P what positioners do to the work, both in the cell frame, a change E of the
work at its zero is ``B'^-1 P' E P^-1 B`` for the arms, and a user frame u is ``C u`` in the robot's base, with C of
the axes that the controller computes with. At both ends the displacement of every axis is the same.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from cellcal.calibration.geometry import Array, inverse_transform
from cellcal.calibration.message import make_message
from cellcal.service.engineering.programs.external.moving_axes import CellAxes, ExternalAxis, same_axis

_SAME = 1e-12
ROBOT_FRAME = {"yaskawa": "ROBOT"}  # the frame that goes with the robot on its track


def rows_of_poses(poses: Array, rows: NDArray[np.intp] | slice | NDArray[np.bool_]) -> Array:
    """Return some of (K, 4, 4); one pose (4, 4) counts for all."""
    return poses if poses.ndim == 2 else poses[rows]


@dataclass(frozen=True, eq=False)
class CarriedPoints:
    """Of K points; a pose (4, 4) counts for all of them."""

    source_frame: Array | None  # user frame in the source's base, as entered
    target_frame: Array | None
    source_carrier: Array  # from the source arm's base to the work at its zero, in the source's cell frame
    target_carrier: Array
    target_values: Array  # (K, A) of the target's axes

    def change_of(self, work_change: Array) -> Array:
        """Return the change for the arms."""
        if self.source_carrier.ndim == 2 and self.target_carrier.ndim == 2:
            return work_change
        found: Array = inverse_transform(self.target_carrier) @ work_change @ self.source_carrier
        return found

    def of_rows(self, rows: NDArray[np.intp] | NDArray[np.bool_] | slice) -> "CarriedPoints":
        """Return those of some of the points."""
        return CarriedPoints(
            None if self.source_frame is None else rows_of_poses(self.source_frame, rows),
            None if self.target_frame is None else rows_of_poses(self.target_frame, rows),
            rows_of_poses(self.source_carrier, rows),
            rows_of_poses(self.target_carrier, rows),
            self.target_values[rows],
        )


@dataclass(frozen=True, eq=False)
class CarriedChanges:
    """Of N points in a cell with external axes: the change in each one's user frame, NaN where a point is left."""

    in_frame: Array  # (N, 4, 4)
    in_base: Array  # (N, 4, 4)
    frame: Array  # (N, 4, 4) in the source's base

    @classmethod
    def make_empty(cls, count: int) -> "CarriedChanges":
        """Return columns of NaN."""
        return cls(*(np.full((count, 4, 4), np.nan) for _ in range(3)))

    def store_changes(self, rows: NDArray[np.intp], carried: CarriedPoints, change: Array) -> None:
        """Keep the change of some points for the arms."""
        before = np.eye(4) if carried.source_frame is None else carried.source_frame
        after = np.eye(4) if carried.target_frame is None else carried.target_frame
        self.in_frame[rows] = inverse_transform(after) @ change @ before
        self.in_base[rows], self.frame[rows] = change, before


@dataclass(frozen=True, eq=False)
class AxisEnd:
    """The axes at one end of a transfer."""

    axes: CellAxes
    real: bool  # the arm there is the real one
    frame: Array | None  # user frame as entered, at the axes' zeros
    frame_name: str | None
    brand: str
    held: bool  # the gripper holds the work

    def carriers(self) -> tuple[int, ...]:
        """Return the positioners that carry the work."""
        if self.held:
            return ()
        return self.axes.carriers_of(self.frame_name, caseless=self.brand in ("abb", "kuka"))

    def entered_frames(self, values: Array) -> Array | None:
        """Return the user frame in the robot's base (K, 4, 4)."""
        if self.frame is None:
            return None
        fixed = self.frame_name is not None and ROBOT_FRAME.get(self.brand) == self.frame_name
        found: Array = (
            self.axes.entered_frame_poses(values, self.carriers(), fixed_to_robot=fixed) @ self.frame
        )
        return found

    def carrier_poses(self, values: Array) -> Array:
        """Return what brings places in the arm's base to the work at its zero (K, 4, 4)."""
        work = self.axes.work_poses(values, self.carriers(), real=self.real)
        found: Array = inverse_transform(work) @ self.axes.base_poses(values, real=self.real)
        return found

    def needed_axes(self) -> tuple[int, ...]:
        """Return the axes whose values a point must state."""
        tracks = [number for number, axis in enumerate(self.axes.axes) if axis.carries_robot]
        return (*tracks, *self.carriers())


def carry_points(source: AxisEnd, target: AxisEnd, values: Array) -> CarriedPoints:
    """Return the frames and carriers of points whose axes stand at values (K, A) of the source's axes."""
    if not len(source.axes) and not len(target.axes):
        eye = np.eye(4)
        return CarriedPoints(source.frame, target.frame, eye, eye, np.zeros((len(values), 0)))
    there = values_in(source.axes, target.axes, values)
    return CarriedPoints(
        source.entered_frames(_usable(source, values)),
        target.entered_frames(_usable(target, there)),
        source.carrier_poses(_usable(source, values)),
        target.carrier_poses(_usable(target, there)),
        there,
    )


def _usable(end: AxisEnd, values: Array) -> Array:
    """Return values with zeros for axes that the points do not need."""
    zeros = np.array([axis.entered.zero for axis in end.axes.axes])
    needed = np.isin(np.arange(len(zeros)), end.needed_axes())
    return np.where(needed, values, zeros)


def values_in(source: CellAxes, target: CellAxes, values: Array) -> Array:
    """Return where the target's axes stand (K, A') when each is as far from its zero as the source's."""
    if source is target:
        return values
    found = np.full((len(values), len(target)), np.nan)
    for number, axis in enumerate(target.axes):
        at = _axis_like(source, axis)
        if at >= 0:
            found[:, number] = axis.entered.values_at(source.axes[at].entered.displacements(values[:, at]))
    return found


def _axis_like(axes: CellAxes, like: ExternalAxis) -> int:
    return next((number for number, axis in enumerate(axes.axes) if same_axis(axis.axis, like.axis)), -1)


def unlike_axis(source: CellAxes, target: CellAxes) -> str:
    """Return why programs cannot go from one cell's axes to the other's, "" where they can."""
    for one, other in ((source, target), (target, source)):
        for axis in one.axes:
            at = _axis_like(other, axis)
            if at < 0:
                return make_message("{axis} is an external axis in one of the cells only", axis=axis.axis)
            like = other.axes[at]
            if (axis.kind, axis.carries_robot, axis.coordinated) != (
                like.kind,
                like.carries_robot,
                like.coordinated,
            ):
                return make_message(
                    "{axis} is another sort of external axis in the other cell", axis=axis.axis
                )
    return ""
