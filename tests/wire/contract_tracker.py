"""Every sentence of the Tracker interface as a test; ``test_trackers.py`` runs them."""

import asyncio
import math
import time
from typing import Any

import numpy as np
import pytest

from cellcal.drivers.errors import BusyError, RefusedError
from cellcal.drivers.interfaces import Readiness
from cellcal.fake_devices.laser_tracker.device import FakeLaserTracker as FakeTracker
from tests.wire.tracker_cases import SERIAL, believed_position, off_in_sigmas


class TrackerContract:
    """Mixed into a test class; ``tracker`` is connected, ``fake`` holds the truth."""

    async def test_a_reading_is_where_the_target_is_within_its_uncertainty(
        self, tracker: Any, simulated_tracker: FakeTracker
    ) -> None:
        for _ in range(20):
            assert off_in_sigmas(await tracker.measure_point(), simulated_tracker) < 5.0

    async def test_a_reading_is_finite_with_an_uncertainty_the_device_can_hold(self, tracker: Any) -> None:
        reading, can = await tracker.measure_point(), tracker.capabilities
        assert all(map(math.isfinite, (*reading.position_m, *reading.sigma_m, *reading.covariance_m2)))
        assert min(reading.sigma_m) >= 0.99 * can.sigma_m > 0
        assert 0 < math.hypot(*reading.position_m) <= can.range_m
        assert reading.raw

    async def test_a_reading_is_taken_after_the_call_began(self, tracker: Any) -> None:
        for _ in range(3):
            began_s = time.monotonic()
            assert began_s <= (await tracker.measure_point()).taken_at_s <= time.monotonic()

    async def test_a_reading_is_as_new_as_the_target(
        self, tracker: Any, simulated_tracker: FakeTracker
    ) -> None:
        before = np.array((await tracker.measure_point()).position_m)
        where = believed_position(simulated_tracker)
        await simulated_tracker.inject_fault("tripod_pushed", {"m": 0.05, "silently": True})
        after = await tracker.measure_point()
        assert np.linalg.norm(believed_position(simulated_tracker) - where) > 0.02
        assert np.array(after.position_m) - before == pytest.approx(
            believed_position(simulated_tracker) - where, abs=5e-4
        )

    async def test_every_reading_names_its_station(self, tracker: Any) -> None:
        assert [(await tracker.measure_point()).station for _ in range(2)] == [3, 3]

    async def test_a_second_measurement_during_one_raises_busy_at_once(
        self, tracker: Any, simulated_tracker: FakeTracker
    ) -> None:
        first = asyncio.create_task(tracker.measure_point())
        await asyncio.sleep(0)
        with pytest.raises(BusyError):
            await tracker.measure_point()
        assert off_in_sigmas(await first, simulated_tracker) < 5.0

    async def test_a_cancelled_measurement_leaves_the_device_usable(
        self, tracker: Any, simulated_tracker: FakeTracker
    ) -> None:
        await tracker.measure_point()
        for turns in (0, 1, 3, 8, 20, 40):
            measuring = asyncio.create_task(tracker.measure_point())
            for _ in range(turns):
                await asyncio.sleep(0)
            measuring.cancel()
            await asyncio.wait({measuring})
            assert off_in_sigmas(await tracker.measure_point(), simulated_tracker) < 5.0

    async def test_the_flag_and_the_method_for_poses_agree(
        self, tracker: Any, simulated_tracker: FakeTracker
    ) -> None:
        if not tracker.capabilities.measures_poses:
            with pytest.raises(RefusedError, match=r"cell\.toml"):
                await tracker.measure_pose()
            return
        reading = await tracker.measure_pose()
        truth = np.array(simulated_tracker.true_state()["tracker_probe"])
        off = reading.station_probe.to_matrix() - truth
        assert np.abs(off[:3, 3] / reading.sigma_m).max() < 5.0
        assert np.abs(off[:3, :3]).max() < 6.0 * max(reading.sigma_rad)
        assert reading.station == 3

    async def test_a_healthy_device_is_ready_and_identifies_itself(self, tracker: Any) -> None:
        assert (await tracker.read_condition()).readiness is Readiness.READY
        assert (await tracker.identify()).serial == str(SERIAL)
        assert tracker.name == "at"

    async def test_the_condition_may_be_asked_while_it_measures(
        self, tracker: Any, simulated_tracker: FakeTracker
    ) -> None:
        measuring = asyncio.create_task(tracker.measure_point())
        await asyncio.sleep(0)
        assert (await tracker.read_condition()).readiness is Readiness.READY
        assert off_in_sigmas(await measuring, simulated_tracker) < 5.0
