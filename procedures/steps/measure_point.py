"""Steps that measure where a target is while everything stands still."""

import asyncio
import math
from collections.abc import Iterable
from dataclasses import dataclass
from typing import cast

import numpy as np

from cellcal.calibration.geometry import Array, Pose
from cellcal.calibration.message import make_message
from cellcal.drivers.interfaces import (
    Air,
    JointReading,
    Joints,
    MeasuresPoses,
    PointReading,
    PoseReading,
    Tracker,
)
from cellcal.procedures.cell import Cell
from cellcal.procedures.motion.active_frames import check_same_frames
from cellcal.procedures.procedure_definition import NEEDS
from cellcal.procedures.run import NeedsUnmetError, ProcedureError
from cellcal.procedures.steps.capture import SPREAD_SIGMAS, TRIES, NotAtRestError

STILL_RAD = (
    1e-4  # how far a standing robot's joints may differ before and after: the resolution of what they show
)
SAME_SIGMAS = 4.0

Triple = tuple[float, float, float]


class StationMovedError(ProcedureError):
    """The tracker stands elsewhere than it did."""

    code = "procedure.station_moved"


@dataclass(frozen=True, slots=True)
class PointCapture:
    """One place of a target with the joints it belongs to, and every single reading, to be evaluated again."""

    label: str
    joints_rad: Joints  # as the controller believes them
    position_m: Triple  # mean of the readings, in the frame of ``station``
    covariance_m2: tuple[Triple, Triple, Triple]
    station: int
    readings: tuple[PointReading, ...]
    air: Air | None = None  # with the last reading
    target: int = (
        0  # which of the end-effector's points it is, counted from 1; 0: the target's place on the flange
    )


@dataclass(frozen=True, slots=True)
class PoseCapture:
    """One pose of a probe with the joints it belongs to."""

    label: str
    joints_rad: Joints
    station_probe: Pose
    sigma_m: Triple
    sigma_rad: Triple
    station: int
    reading: PoseReading


def tracker_of(cell: Cell) -> Tracker:
    """Return the cell's tracker, or say what is missing."""
    if cell.tracker is None:
        lacks = NEEDS["tracker"][0]
        raise NeedsUnmetError(
            make_message("this step needs {lacks}", lacks=lacks),
            missing=(lacks,),
            remedy="Add a [[tracker]] to cell.toml.",
        )
    return cell.tracker


async def measure_point(
    cell: Cell, label: str, samples: int = 1, *, station: int | None = None
) -> PointCapture:
    """Let the arm settle, measure its target, and hold that neither arm nor target moved meanwhile.

    Parameters
    ----------
    samples : int
        How many readings are averaged. What a tracker gets wrong every time does not average: the uncertainty
        is at least that of one reading.
    station : int, optional
        The station that earlier captures were taken from; another one is refused.

    Raises
    ------
    NotAtRestError
        The joints or the target moved during every try.
    StationMovedError
        The readings are of another station than asked for, or of two.
    """
    device = tracker_of(cell)
    for _ in range(TRIES):
        await asyncio.sleep(cell.limits.settle_s)
        before = await cell.robot.read_joints()
        readings = tuple([await device.measure_point() for _ in range(samples)])
        after = await cell.robot.read_joints()
        check_one_station((reading.station for reading in readings), station)
        if _is_standing(before, after) and _readings_agree(readings):
            await check_same_frames(cell)
            return _point_capture(label, after.joints_rad, readings)
    raise _not_at_rest_error(label)


async def measure_pose(cell: Cell, label: str, *, station: int | None = None) -> PoseCapture:
    """As ``measure_point``, for one pose of a probe."""
    device = cast(MeasuresPoses, tracker_of(cell))
    if not tracker_of(cell).capabilities.measures_poses:
        lacks = NEEDS["measures_poses"][0]
        raise NeedsUnmetError(
            make_message("this step needs {lacks}", lacks=lacks),
            missing=(lacks,),
            remedy="Measure points instead.",
        )
    for _ in range(TRIES):
        await asyncio.sleep(cell.limits.settle_s)
        before = await cell.robot.read_joints()
        reading = await device.measure_pose()
        after = await cell.robot.read_joints()
        check_one_station((reading.station,), station)
        if _is_standing(before, after):
            await check_same_frames(cell)
            return PoseCapture(
                label,
                after.joints_rad,
                reading.station_probe,
                reading.sigma_m,
                reading.sigma_rad,
                reading.station,
                reading,
            )
    raise _not_at_rest_error(label)


def check_one_station(stations: Iterable[int], expected: int | None = None) -> None:
    """Raise StationMovedError unless all readings are of one station, the wanted one where it is given."""
    found = sorted(set(stations) | ({expected} if expected is not None else set()))
    if len(found) > 1:
        raise StationMovedError(
            make_message(
                "readings of the stations {map} are of different frames and cannot be mixed",
                map=", ".join(map(str, found)),
            ),
            remedy="Measure all poses of one fit from one station, or give each station a frame of its own.",
        )


def check_station(first: PointCapture, again: PointCapture, arm_sigma_m: float) -> float:
    """Compare two captures of one pose, taken at the beginning and later; return their distance [m].

    A tripod that was knocked does not always report it. The first pose, measured again, does.

    Parameters
    ----------
    arm_sigma_m : float
        How well the arm returns to a pose: standard deviation of one coordinate [m].

    Raises
    ------
    StationMovedError
        They lie further apart than four standard deviations.
    """
    check_one_station((first.station, again.station))
    way = np.subtract(again.position_m, first.position_m)
    covariance = np.array(first.covariance_m2) + np.array(again.covariance_m2) + np.eye(3) * arm_sigma_m**2
    distance = float(np.linalg.norm(way))
    if float(way @ np.linalg.solve(covariance, way)) > SAME_SIGMAS**2:
        raise StationMovedError(
            make_message(
                "{again_label}: the target is {distance:.3f} mm from where it was in {first_label}",
                again_label=again.label,
                distance=distance * 1000.0,
                first_label=first.label,
            ),
            remedy="Tripod, target or robot base has moved, or the hall's temperature. Begin the series anew.",
        )
    return distance


def _point_capture(label: str, joints_rad: Joints, readings: tuple[PointReading, ...]) -> PointCapture:
    places = np.array([reading.position_m for reading in readings])
    worst = max(readings, key=lambda reading: math.hypot(*reading.sigma_m))
    covariance = _covariance_of(worst)
    if len(readings) > 1:
        covariance = covariance + np.diag(places.var(axis=0, ddof=1)) / len(readings)
    x, y, z = (float(v) for v in places.mean(axis=0))
    rows = [tuple(float(v) for v in row) for row in covariance]
    return PointCapture(
        label,
        joints_rad,
        (x, y, z),
        cast(tuple[Triple, Triple, Triple], tuple(rows)),
        readings[-1].station,
        readings,
        readings[-1].air,
    )


def _covariance_of(reading: PointReading) -> Array:
    xy, xz, yz = reading.covariance_m2
    x, y, z = (sigma**2 for sigma in reading.sigma_m)
    return np.array([[x, xy, xz], [xy, y, yz], [xz, yz, z]])


def _is_standing(before: JointReading, after: JointReading) -> bool:
    ways = (abs(a - b) for a, b in zip(before.joints_rad, after.joints_rad, strict=True))
    return not before.moving and not after.moving and max(ways) <= STILL_RAD


def _readings_agree(readings: tuple[PointReading, ...]) -> bool:
    places = np.array([reading.position_m for reading in readings])
    sigma_m = max(max(reading.sigma_m) for reading in readings)
    return bool((np.ptp(places, axis=0) <= SPREAD_SIGMAS * sigma_m).all())


def _not_at_rest_error(label: str) -> NotAtRestError:
    return NotAtRestError(
        make_message(
            "{label}: the arm or its target moved while it was measured, {tries} times",
            label=label,
            tries=TRIES,
        ),
        remedy="Let the arm come to rest, see that the target sits firmly, then resume.",
    )
