"""A target is measured while nothing moves, and captures of two stations never become one."""

from dataclasses import dataclass, field, replace
from typing import Any, cast

import numpy as np
import pytest
from pydantic import TypeAdapter

from cellcal.calibration.geometry import Pose
from cellcal.drivers.interfaces import (
    Air,
    Identity,
    JointReading,
    Operator,
    PointReading,
    PoseReading,
    Robot,
    Tracker,
    TrackerCapabilities,
)
from cellcal.procedures.cell import Cell, MotionCaps, read_fingerprint
from cellcal.procedures.run import NeedsUnmetError
from cellcal.procedures.steps.capture import TRIES, NotAtRestError
from cellcal.procedures.steps.measure_point import (
    PointCapture,
    StationMovedError,
    check_one_station,
    check_station,
    measure_point,
    measure_pose,
)

SIGMA_M = 3e-5


@dataclass
class StillRobot:
    """Stands, unless told to creep."""

    creep_rad: float = 0.0
    moving: bool = False
    q: float = 0.3

    async def read_joints(self) -> JointReading:
        self.q += self.creep_rad
        return JointReading((0.1, self.q), self.moving, 0.0)

    async def identify(self) -> Identity:
        return Identity("ours", "arm", "R1", "1")


@dataclass
class ScriptedTracker:
    """Gives these places one after the other, then the last one for ever."""

    places_m: list[tuple[float, float, float]]
    station: int = 1
    taken: int = 0
    capabilities: TrackerCapabilities = field(
        default_factory=lambda: TrackerCapabilities(True, 40.0, SIGMA_M)
    )

    async def measure_point(self) -> PointReading:
        place = self.places_m[min(self.taken, len(self.places_m) - 1)]
        self.taken += 1
        sigma = (SIGMA_M, SIGMA_M, 2 * SIGMA_M)
        return PointReading(place, sigma, 0.0, self.station, Air(20.0, 1e5, 40.0), (1e-10, 0.0, 0.0), "00")

    async def measure_pose(self) -> PoseReading:
        return PoseReading(Pose((1.0, 2.0, 3.0)), (SIGMA_M,) * 3, (5e-5,) * 3, 0.0, self.station)

    async def identify(self) -> Identity:
        return Identity("ours", "tracker", "T1", "1")


def cell_with_tracker(robot: StillRobot, tracker: ScriptedTracker | None) -> Cell:
    return Cell(
        name="c",
        robot=cast(Robot, robot),
        operator=cast(Operator, None),
        tracker=cast(Tracker, tracker),
        limits=MotionCaps(settle_s=0.0),
    )


HERE = (1.0, 2.0, 0.5)


async def test_readings_are_averaged_and_kept_with_the_joints_they_belong_to() -> None:
    instrument = ScriptedTracker([(1.0, 2.0, 0.5), (1.00006, 2.0, 0.5)])
    found = await measure_point(cell_with_tracker(StillRobot(), instrument), "pose 1", 2)
    assert found.position_m == pytest.approx((1.00003, 2.0, 0.5))
    assert found.joints_rad == (0.1, 0.3)
    assert [reading.position_m[0] for reading in found.readings] == [1.0, 1.00006]
    covariance = np.array(found.covariance_m2)
    assert covariance[0, 1] == covariance[1, 0] == 1e-10
    assert covariance[0, 0] == pytest.approx(
        SIGMA_M**2 + 1.8e-9 / 2
    )  # averaging does not shrink what is systematic
    assert covariance[2, 2] == pytest.approx(4 * SIGMA_M**2)
    assert found.air == Air(20.0, 1e5, 40.0)


async def test_a_capture_survives_the_journal() -> None:
    found = await measure_point(cell_with_tracker(StillRobot(), ScriptedTracker([HERE])), "pose 1")
    codec = TypeAdapter(PointCapture)
    assert codec.validate_json(codec.dump_json(found)) == found


@pytest.mark.parametrize("robot", [StillRobot(creep_rad=2e-4), StillRobot(moving=True)])
async def test_an_arm_that_moves_is_not_measured(robot: StillRobot) -> None:
    instrument = ScriptedTracker([HERE])
    with pytest.raises(NotAtRestError, match="pose 1") as failure:
        await measure_point(cell_with_tracker(robot, instrument), "pose 1")
    assert instrument.taken == TRIES
    assert failure.value.remedy
    with pytest.raises(NotAtRestError):
        await measure_pose(cell_with_tracker(robot, instrument), "pose 1")


async def test_a_target_that_swings_is_measured_again_until_it_rests() -> None:
    instrument = ScriptedTracker([HERE, (1.0, 2.001, 0.5), HERE])
    found = await measure_point(cell_with_tracker(StillRobot(), instrument), "pose 1", 2)
    assert instrument.taken == 4
    assert found.position_m == HERE
    swinging = ScriptedTracker([(1.0 + 0.001 * (k % 2), 2.0, 0.5) for k in range(50)])
    with pytest.raises(NotAtRestError):
        await measure_point(cell_with_tracker(StillRobot(), swinging), "pose 1", 2)


async def test_another_station_is_refused() -> None:
    moved = cell_with_tracker(StillRobot(), ScriptedTracker([HERE], station=2))
    assert (await measure_point(moved, "pose 1", station=2)).station == 2
    with pytest.raises(StationMovedError, match="1, 2"):
        await measure_point(moved, "pose 1", station=1)
    with pytest.raises(StationMovedError):
        await measure_pose(moved, "pose 1", station=1)
    check_one_station([4, 4, 4], 4)
    with pytest.raises(StationMovedError):
        check_one_station([4, 5])


async def test_a_tripod_that_was_pushed_shows_at_the_first_pose_measured_again() -> None:
    first = await measure_point(cell_with_tracker(StillRobot(), ScriptedTracker([HERE])), "pose 1")
    again = replace(first, label="pose 1 again", position_m=(1.0, 2.00006, 0.5))
    assert check_station(first, again, arm_sigma_m=2e-5) == pytest.approx(6e-5)
    with pytest.raises(StationMovedError, match=r"0\.400 mm"):
        check_station(first, replace(again, position_m=(1.0, 2.0004, 0.5)), arm_sigma_m=2e-5)
    with pytest.raises(StationMovedError):
        check_station(first, replace(again, station=2), arm_sigma_m=2e-5)


async def test_a_pose_is_measured_where_the_instrument_can() -> None:
    found = await measure_pose(cell_with_tracker(StillRobot(), ScriptedTracker([HERE])), "pose 1")
    assert found.station_probe == Pose((1.0, 2.0, 3.0))
    points_only = ScriptedTracker([HERE], capabilities=TrackerCapabilities(False, 40.0, SIGMA_M))
    with pytest.raises(NeedsUnmetError, match="measures poses"):
        await measure_pose(cell_with_tracker(StillRobot(), points_only), "pose 1")


async def test_a_cell_without_a_tracker_says_what_it_lacks() -> None:
    measurements: Any = (measure_point, measure_pose)
    for measure in measurements:
        with pytest.raises(NeedsUnmetError, match="measures points"):
            await measure(cell_with_tracker(StillRobot(), None), "pose 1")


async def test_the_tracker_is_part_of_what_must_be_the_same_on_resume() -> None:
    found = await read_fingerprint(cell_with_tracker(StillRobot(), ScriptedTracker([HERE])))
    assert [(mark.role, mark.identity.serial) for mark in found.devices] == [
        ("robot", "R1"),
        ("tracker", "T1"),
    ]
