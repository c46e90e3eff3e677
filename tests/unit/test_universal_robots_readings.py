"""Readings of a Universal Robots controller that are finite, and that none of its arms can have."""

import math
from types import SimpleNamespace
from typing import Any

import pytest

from cellcal.drivers.errors import RefusedError, WireProtocolError
from cellcal.drivers.interfaces import Readiness
from cellcal.drivers.universal_robots.health import arm_condition_of
from cellcal.drivers.universal_robots.motion import MotionTolerances
from cellcal.drivers.universal_robots.reading_robot import (
    LOOK_FIRST,
    ReadingUniversalRobot,
    UrMotionOptions,
    with_look_first,
)
from cellcal.drivers.universal_robots.state import StateSample

_ZEROS = (0.0,) * 6
_OPTIONS = UrMotionOptions(60.0, 0.5, 1.0, 2.0, MotionTolerances(1e-3, 1e-3, 0.3))


def sample(**fields: Any) -> StateSample:
    usual: dict[str, Any] = {
        "timestamp_s": 1.0, "joints_rad": _ZEROS, "joint_speeds_rad_s": _ZEROS, "tcp_pose": _ZEROS,
        "tcp_offset": _ZEROS, "speed_scaling": 1.0, "speed_fraction": 1.0, "robot_mode": 7, "runtime_state": 1,
        "robot_status_bits": 3, "safety_status_bits": 1, "payload_kg": 0.0, "received_at_s": 0.0, "raw": b"",
    }  # fmt: skip
    return StateSample(**{**usual, **fields})


def robot(**fields: Any) -> ReadingUniversalRobot:
    async def read_sample() -> StateSample:
        return sample(**fields)

    contact: Any = SimpleNamespace(device="ur", read_sample=read_sample)
    return ReadingUniversalRobot(contact, "127.0.0.1", _OPTIONS)


@pytest.mark.parametrize("tcp", [(400.0, 0, 0, 0, 0, 0), (1e300,) * 6, (0, 0, 0, 0, 1e9, 0), (math.nan,) * 6])
async def test_a_pose_out_of_reach_is_refused(tcp: tuple[float, ...]) -> None:
    with pytest.raises(RefusedError):
        await robot(tcp_pose=tcp).flange_pose()
    with pytest.raises(RefusedError):
        await robot(tcp_offset=tcp).active_frames()


async def test_a_payload_below_nothing_is_none() -> None:
    with pytest.raises(RefusedError):
        await robot(payload_kg=-5.0).active_frames()


@pytest.mark.parametrize(
    ("bits", "ready"), [(0b1, True), (0b10, True), (0b11, True), (0, False), (1 << 20, False)]
)
def test_a_safety_system_that_does_not_say_normal_is_not_ready(bits: int, ready: bool) -> None:
    found = arm_condition_of(sample(safety_status_bits=bits)).readiness
    assert (found is Readiness.READY) is ready


def test_a_stop_that_was_answered_with_nonsense_says_to_look_at_the_robot() -> None:
    error = with_look_first(WireProtocolError("ur", "a line that is too long.", remedy="Report this."))
    assert error.remedy.startswith(LOOK_FIRST)
