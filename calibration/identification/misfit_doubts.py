"""What columns look like that no fit explains: sorted by themselves, standing still, or without their minus signs."""

from collections.abc import Iterator

import numpy as np

from cellcal.calibration.arm.joint_kinds import shown_units
from cellcal.calibration.arm.kinematics import RobotModel
from cellcal.calibration.geometry import Array
from cellcal.calibration.identification.misfit_fit import motion_of
from cellcal.calibration.identification.observations import MeasuredRows, PointObservations
from cellcal.calibration.message import join_messages, make_message

_FEWEST_ROWS = 16
_TIMES_ITS_RANGE = 1.5  # a joint that moves further than that is another column
_UNLIKE = 5.0  # times as far as the flange does no target move
_BOTH_WAYS_RAD = 0.5  # a joint that turns as far either way is seldom measured on one side only


def column_doubts(model: RobotModel, rows: MeasuredRows) -> str:
    """Return what to look at in columns of rows that do not fit, as sentences; empty where nothing strikes."""
    if len(rows) < _FEWEST_ROWS:
        return ""
    found = [
        *_unlike_motion(model, rows),
        *_sorted_place(rows),
        *_sorted_joints(model, rows),
        *_joints_too_far(model, rows),
        *_still_joints(model, rows),
        *_joints_without_minus(model, rows),
    ]
    return join_messages(" ", found) if found else ""


def _unlike_motion(model: RobotModel, rows: MeasuredRows) -> Iterator[str]:
    if not isinstance(rows, PointObservations):
        return
    away = rows.positions_m - np.median(rows.positions_m, axis=0)
    seen_m, moved_m = float(np.sqrt((away**2).sum(axis=1).mean())), motion_of(model, rows)
    if not 1.0 / _UNLIKE < seen_m / max(moved_m, 1e-9) < _UNLIKE:
        yield make_message(
            "The measured places move by {seen_mm:.0f} mm, and the joints move the flange by {moved_mm:.0f} mm: see "
            "the units of both (`--units joints=deg` or `rad`, `--units position=mm` or `m`).",
            seen_mm=seen_m * 1e3,
            moved_mm=moved_m * 1e3,
        )


def _sorted_place(rows: MeasuredRows) -> Iterator[str]:
    if not isinstance(rows, PointObservations):
        return
    for axis, of in zip("XYZ", rows.positions_m.T, strict=True):
        if _is_sorted(of):
            yield make_message(
                "The measured {axis} only rises or falls from row to row: see whether the measured values were "
                "sorted apart from the joints, and put them back in the order in which they were measured.",
                axis=axis,
            )


def _sorted_joints(model: RobotModel, rows: MeasuredRows) -> Iterator[str]:
    for name, of in zip(model.joint_names, rows.joints_rad.T, strict=True):
        if np.ptp(of) > 0.0 and _is_sorted(of):
            yield make_message(
                "{joint} only rises or falls from row to row: see whether it, or all joints, were sorted apart from "
                "the measured values, and put them back in the order in which they were measured.",
                joint=name,
            )


def _is_sorted(values: Array) -> bool:
    steps = np.diff(values)
    return bool((steps >= 0).all() or (steps <= 0).all())


def _still_joints(model: RobotModel, rows: MeasuredRows) -> Iterator[str]:
    for name, of in zip(model.joint_names, rows.joints_rad.T, strict=True):
        if np.ptp(of) == 0.0:
            yield make_message("{joint} is the same in all rows: see whether it stood still.", joint=name)


def _joints_too_far(model: RobotModel, rows: MeasuredRows) -> Iterator[str]:
    factors, units = shown_units(model)
    ranges = model.upper_rad - model.lower_rad
    for name, factor, unit, width, of in zip(
        model.joint_names, factors, units, ranges, rows.joints_rad.T, strict=True
    ):
        if np.ptp(of) > _TIMES_ITS_RANGE * width > 0.0:
            yield make_message(
                "{joint} moves through {moved:.0f} {unit}, and its range is {width:.0f} {unit}: see whether its "
                "column is that of another joint, or of a track.",
                joint=name,
                moved=np.ptp(of) * factor,
                unit=unit,
                width=width * factor,
            )


def _joints_without_minus(model: RobotModel, rows: MeasuredRows) -> Iterator[str]:
    turns_both_ways = np.minimum(-model.lower_rad, model.upper_rad) > _BOTH_WAYS_RAD
    for name, both, of in zip(model.joint_names, turns_both_ways, rows.joints_rad.T, strict=True):
        if both and np.ptp(of) > 0.0 and (of >= 0.0).all():
            yield make_message(
                "{joint} is never negative: see whether its minus signs were lost.", joint=name
            )
