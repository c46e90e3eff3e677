"""A pose of a Universal Robots arm that is no number is refused by the device's name."""

import math
from typing import Any

import pytest

from cellcal.drivers.errors import RefusedError
from cellcal.drivers.universal_robots.reading_robot import ReadingUniversalRobot
from cellcal.drivers.universal_robots.state import StateSample

POSE = (0.1, 0.2, 0.3, 0.0, 0.0, 0.1)


class _Contact:
    device = "ur"

    def __init__(self, sample: Any) -> None:
        self.read_sample = _returning(sample)


def _returning(sample: Any) -> Any:
    async def read_sample() -> Any:
        return sample

    return read_sample


class _Options:
    deadline_s = 60.0


@pytest.mark.parametrize("field", ["tcp_pose", "tcp_offset"])
@pytest.mark.parametrize("place", [0, 4])
async def test_a_pose_that_is_no_number_is_refused(field: str, place: int) -> None:
    broken = (*POSE[:place], math.nan, *POSE[place + 1 :])
    values = dict.fromkeys(StateSample.__slots__, 0.0) | {"tcp_pose": POSE, "tcp_offset": POSE}
    robot = ReadingUniversalRobot(_Contact(StateSample(**values | {field: broken})), "", _Options())  # type: ignore[arg-type]
    with pytest.raises(RefusedError, match="ur: the controller tells a pose or tool"):
        await robot.flange_pose()
