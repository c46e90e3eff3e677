"""A place is either measured now, in metres, from the station that is meant, or it is an error."""

import asyncio
from collections.abc import AsyncIterator, Awaitable, Callable
from typing import Any

import numpy as np
import pytest

from cellcal.drivers.errors import (
    DeviceError,
    DeviceTimeoutError,
    RefusedError,
    UnreachableError,
    WireProtocolError,
    WrongDeviceError,
)
from cellcal.drivers.interfaces import Readiness
from cellcal.drivers.laser_tracker.tracker import LaserTracker
from cellcal.fake_devices.clock import WorldClock
from cellcal.fake_devices.laser_tracker.device import FakeLaserTracker as FakeTracker
from tests.machine_speed import stretched_s
from tests.wire.tracker_cases import SERIAL, believed_position, config_for, fake_tracker, off_in_sigmas


@pytest.fixture
async def simulated_tracker() -> AsyncIterator[FakeTracker]:
    async with fake_tracker() as device:
        yield device


@pytest.fixture
async def tracker(simulated_tracker: FakeTracker) -> AsyncIterator[LaserTracker]:
    async with config_for(simulated_tracker).open() as device:
        yield device


async def check_healed(tracker: LaserTracker, fake: FakeTracker) -> None:
    fake.clear_faults()
    async with asyncio.timeout(stretched_s(30.0)):
        while (await tracker.read_condition()).readiness is not Readiness.READY:
            await asyncio.sleep(0.01)
    assert off_in_sigmas(await tracker.measure_point(), fake) < 5.0


async def under_way(fake: FakeTracker) -> None:
    """Wait until the fake measures."""
    async with asyncio.timeout(stretched_s(30.0)):
        while not fake.controller.is_busy:
            await asyncio.sleep(0)


def slow_world(fake: FakeTracker) -> WorldClock:
    """Let a measurement last until the clock is moved."""
    clock = fake.controller._clock
    clock.time_factor = 0.0
    return clock


class TestTheLink:
    @pytest.mark.parametrize(
        ("fault", "parameters", "error"),
        [
            ("silent", {}, DeviceTimeoutError),
            ("slow", {"delay_s": 1.5}, DeviceTimeoutError),
            ("lost_result", {}, DeviceTimeoutError),
            ("truncated", {"count": 1}, DeviceTimeoutError),
            ("truncated", {"bytes": 3}, DeviceTimeoutError),
            ("wrong_size", {"count": 1}, WireProtocolError),
            ("wrong_size", {"by": -4}, WireProtocolError),
            ("wrong_size", {"by": 2_000_000_000}, WireProtocolError),
            ("wrong_type", {}, WireProtocolError),
            ("garbage", {}, WireProtocolError),
            ("duplicate", {}, WireProtocolError),
            ("foreign_answer", {}, WireProtocolError),
            ("refuse", {}, UnreachableError),
        ],
    )
    async def test_that_fails_is_an_error_with_a_remedy_and_heals(
        self,
        tracker: LaserTracker,
        simulated_tracker: FakeTracker,
        fault: str,
        parameters: Any,
        error: type[DeviceError],
    ) -> None:
        await tracker.measure_point()
        await simulated_tracker.inject_fault(
            fault, {k: stretched_s(v) if k == "delay_s" else v for k, v in parameters.items()}
        )
        with pytest.raises(error) as failure:
            await tracker.measure_point()
        assert str(failure.value).startswith("at: ")
        assert failure.value.remedy
        await check_healed(tracker, simulated_tracker)

    async def test_lost_at_any_moment_is_an_error_and_heals(
        self, tracker: LaserTracker, simulated_tracker: FakeTracker
    ) -> None:
        for turns in range(0, 60, 4):
            measuring = asyncio.create_task(tracker.measure_point())
            for _ in range(turns):
                await asyncio.sleep(0)
            simulated_tracker.server.cut_connections()
            found = (await asyncio.gather(measuring, return_exceptions=True))[0]
            if isinstance(found, BaseException):
                assert isinstance(found, DeviceError)
            else:
                assert off_in_sigmas(found, simulated_tracker) < 5.0
            await check_healed(tracker, simulated_tracker)

    async def test_with_events_and_half_packets_in_between_is_the_same(
        self, tracker: LaserTracker, simulated_tracker: FakeTracker
    ) -> None:
        await simulated_tracker.inject_fault("events", {"count_each": 4})
        await simulated_tracker.inject_fault("half_packets", {"delay_s": 0.001})
        for _ in range(3):
            assert off_in_sigmas(await tracker.measure_point(), simulated_tracker) < 5.0

    async def test_with_the_result_of_an_earlier_measurement_gives_this_one(
        self, tracker: LaserTracker, simulated_tracker: FakeTracker
    ) -> None:
        await tracker.measure_point()
        await simulated_tracker.inject_fault("tripod_pushed", {"m": 0.1, "silently": True})
        await simulated_tracker.inject_fault("foreign_result", {})
        assert off_in_sigmas(await tracker.measure_point(), simulated_tracker) < 5.0

    async def test_late_by_more_than_the_deadline_never_answers_the_next_question(
        self, tracker: LaserTracker, simulated_tracker: FakeTracker
    ) -> None:
        await tracker.measure_point()
        await simulated_tracker.inject_fault("slow", {"delay_s": stretched_s(1.2), "count": 1})
        with pytest.raises(DeviceTimeoutError):
            await tracker.measure_point()
        await simulated_tracker.inject_fault("tripod_pushed", {"m": 0.1, "silently": True})
        assert off_in_sigmas(await tracker.measure_point(), simulated_tracker) < 5.0

    async def test_that_does_not_answer_is_reported_with_its_address(
        self, simulated_tracker: FakeTracker
    ) -> None:
        config = config_for(simulated_tracker)
        await simulated_tracker.stop()
        with pytest.raises(UnreachableError, match=r"127\.0\.0\.1"):
            async with config.open():
                pytest.fail("there is no operator")

    async def test_leaves_nothing_behind(self, simulated_tracker: FakeTracker) -> None:
        before = asyncio.all_tasks()
        for _ in range(3):
            async with config_for(simulated_tracker).open() as tracker:
                await tracker.measure_point()
        async with asyncio.timeout(stretched_s(30.0)):
            while asyncio.all_tasks() - before or simulated_tracker.server.client_count:
                await asyncio.sleep(0.001)


class TestTheBeam:
    async def test_broken_before_is_refused_with_the_trackers_name_for_it(
        self, tracker: LaserTracker, simulated_tracker: FakeTracker
    ) -> None:
        await tracker.measure_point()
        await simulated_tracker.inject_fault("beam_break", {})
        with pytest.raises(RefusedError, match="MeasurementStatusNotReady") as failure:
            await tracker.measure_point()
        assert failure.value.vendor_code == 10004
        assert (await tracker.read_condition()).readiness is Readiness.NOT_READY
        await simulated_tracker.inject_fault("beam_return", {})
        await check_healed(tracker, simulated_tracker)

    async def test_broken_during_a_measurement_gives_no_point(
        self, tracker: LaserTracker, simulated_tracker: FakeTracker
    ) -> None:
        await tracker.measure_point()
        clock = slow_world(simulated_tracker)
        measuring = asyncio.create_task(tracker.measure_point())
        await under_way(simulated_tracker)
        await simulated_tracker.inject_fault("beam_break", {})
        with pytest.raises(RefusedError, match=r"NoStationaryResult|NotReady") as failure:
            await measuring
        assert "line of sight" in failure.value.remedy
        clock.time_factor = 300.0
        await simulated_tracker.inject_fault("beam_return", {})
        await check_healed(tracker, simulated_tracker)

    async def test_is_searched_where_the_cell_file_allows_it(self, simulated_tracker: FakeTracker) -> None:
        async with config_for(simulated_tracker, search_distance_m=3.0).open() as tracker:
            await simulated_tracker.inject_fault("beam_break", {})
            assert off_in_sigmas(await tracker.measure_point(), simulated_tracker) < 5.0
            await simulated_tracker.inject_fault("beam_break", {"findable": False})
            with pytest.raises(RefusedError, match="MeasurementStatusNotReady"):
                await tracker.measure_point()

    async def test_without_a_probe_in_it_gives_no_pose(
        self, tracker: LaserTracker, simulated_tracker: FakeTracker
    ) -> None:
        await simulated_tracker.inject_fault("refuse_command", {"command": 49, "status": 75})
        with pytest.raises(RefusedError, match="NoMeasurementProbe"):
            await tracker.measure_pose()


class TestOtherPrograms:
    @pytest.mark.parametrize("silently", [False, True])
    @pytest.mark.parametrize(
        ("fault", "value"),
        [
            ("units", [2, 2, 1, 2, 0]),
            ("units", [5, 0, 0, 0, 0]),
            ("axes", 3),
            ("axes", 6),
            ("settings", None),
        ],
    )
    async def test_that_change_settings_between_measurements_are_set_right(
        self, tracker: LaserTracker, simulated_tracker: FakeTracker, fault: str, value: Any, silently: bool
    ) -> None:
        await tracker.measure_point()
        fault_parameters = {} if value is None else {fault: value}
        await simulated_tracker.inject_fault(fault, {**fault_parameters, "silently": silently})
        assert off_in_sigmas(await tracker.measure_point(), simulated_tracker) < 5.0

    @pytest.mark.parametrize(
        ("fault", "value"), [("units", [1, 0, 0, 0, 0]), ("axes", 2), ("settings", None)]
    )
    async def test_that_change_settings_during_a_measurement_cost_the_reading(
        self, tracker: LaserTracker, simulated_tracker: FakeTracker, fault: str, value: Any
    ) -> None:
        await tracker.measure_point()
        clock = slow_world(simulated_tracker)
        measuring = asyncio.create_task(tracker.measure_point())
        await under_way(simulated_tracker)
        await simulated_tracker.inject_fault(
            fault, {**({} if value is None else {fault: value}), "silently": True}
        )
        clock.time_factor = 300.0
        clock.advance(0.0)
        with pytest.raises(RefusedError, match=r"another program|try mode"):
            await measuring
        await check_healed(tracker, simulated_tracker)

    async def test_that_choose_another_reflector_are_not_followed(
        self, tracker: LaserTracker, simulated_tracker: FakeTracker
    ) -> None:
        await tracker.measure_point()
        await simulated_tracker.inject_fault("reflector", {"id": 5})
        with pytest.raises(RefusedError, match="offsets differ"):
            await tracker.measure_point()
        async with config_for(simulated_tracker, reflector=2).open() as other:
            with pytest.raises(RefusedError, match="reflector 5"):
                await other.measure_point()

    async def test_that_measure_are_waited_for(
        self, tracker: LaserTracker, simulated_tracker: FakeTracker
    ) -> None:
        async with config_for(simulated_tracker).open() as other:
            for _ in range(4):
                found = await asyncio.gather(tracker.measure_point(), other.measure_point())
                assert max(off_in_sigmas(reading, simulated_tracker) for reading in found) < 5.0


class TestTheStation:
    @pytest.mark.parametrize(
        ("fault", "why"),
        [
            (("tripod_pushed", {}), "touched"),
            (("station", {}), "another station"),
            (("compensation", {}), "compensation"),
            (("event", {"code": 851}), "unplugged"),
            (("event", {"code": 151}), "initialised again"),
            (("event", {"code": 999}), "started again"),
        ],
    )
    async def test_that_has_changed_gives_no_reading_under_its_old_number(
        self, tracker: LaserTracker, simulated_tracker: FakeTracker, fault: tuple[str, Any], why: str
    ) -> None:
        await tracker.measure_point()
        await simulated_tracker.inject_fault(*fault)
        for _ in range(2):
            with pytest.raises(RefusedError, match=why) as failure:
                await tracker.measure_point()
            assert "Raise `station`" in failure.value.remedy
        assert (await tracker.read_condition()).readiness is Readiness.NOT_READY
        async with config_for(simulated_tracker, station=4).open() as again:
            reading = await again.measure_point()
        assert reading.station == 4
        assert off_in_sigmas(reading, simulated_tracker) < 5.0

    async def test_that_changes_during_a_measurement_costs_the_reading(
        self, tracker: LaserTracker, simulated_tracker: FakeTracker
    ) -> None:
        await tracker.measure_point()
        clock = slow_world(simulated_tracker)
        measuring = asyncio.create_task(tracker.measure_point())
        await under_way(simulated_tracker)
        await simulated_tracker.inject_fault("tripod_pushed", {})
        clock.time_factor = 300.0
        clock.advance(0.0)
        with pytest.raises(RefusedError, match="station 3"):
            await measuring

    @pytest.mark.parametrize("fault", ["station", "compensation"])
    async def test_that_changed_without_a_connection_is_noticed(
        self, tracker: LaserTracker, simulated_tracker: FakeTracker, fault: str
    ) -> None:
        await tracker.measure_point()
        simulated_tracker.server.cut_connections()
        await simulated_tracker.inject_fault(fault, {"silently": True})
        with pytest.raises(DeviceError):
            await tracker.measure_point()
        with pytest.raises(RefusedError, match="no longer stands in station 3"):
            await tracker.measure_point()

    async def test_begins_with_its_first_reading(
        self, tracker: LaserTracker, simulated_tracker: FakeTracker
    ) -> None:
        await simulated_tracker.inject_fault("tripod_pushed", {})
        await simulated_tracker.inject_fault("station", {})
        assert off_in_sigmas(await tracker.measure_point(), simulated_tracker) < 5.0

    async def test_does_not_survive_a_power_cycle(
        self, tracker: LaserTracker, simulated_tracker: FakeTracker
    ) -> None:
        await tracker.measure_point()
        await simulated_tracker.inject_fault("power_cycle", {})
        with pytest.raises(DeviceError):
            await tracker.measure_point()
        with pytest.raises(RefusedError, match="it was off"):
            await tracker.measure_point()


class TestInitialising:
    async def test_is_done_by_the_first_reading_and_not_by_looking(
        self, simulated_tracker: FakeTracker
    ) -> None:
        await simulated_tracker.inject_fault("power_cycle", {})
        async with config_for(simulated_tracker).open() as tracker:
            condition = await tracker.read_condition()
            assert condition.readiness is Readiness.READY
            assert "head turns" in condition.message
            assert not simulated_tracker.controller.initialised
            assert off_in_sigmas(await tracker.measure_point(), simulated_tracker) < 5.0
            assert off_in_sigmas(await tracker.measure_point(), simulated_tracker) < 5.0

    async def test_is_left_alone_where_the_cell_file_says_so(self, simulated_tracker: FakeTracker) -> None:
        await simulated_tracker.inject_fault("not_initialised", {})
        async with config_for(simulated_tracker, initialise=False).open() as tracker:
            assert (await tracker.read_condition()).readiness is Readiness.NOT_READY
            with pytest.raises(RefusedError, match="TrackerNotInitialized"):
                await tracker.measure_point()
        assert not simulated_tracker.controller.initialised


class TestResults:
    @pytest.mark.parametrize("value", [0, 1, 2, 3, 13, 17, 20, 21, 22])
    @pytest.mark.parametrize("to", [float("nan"), float("inf"), -1e300])
    async def test_with_a_number_that_cannot_be_are_not_used(
        self, tracker: LaserTracker, simulated_tracker: FakeTracker, value: int, to: float
    ) -> None:
        await simulated_tracker.inject_fault("spoil", {"value": value, "to": to})
        with pytest.raises((RefusedError, WireProtocolError)) as failure:
            await tracker.measure_point()
        assert failure.value.remedy
        await check_healed(tracker, simulated_tracker)

    async def test_of_a_moving_target_are_refused(
        self, tracker: LaserTracker, simulated_tracker: FakeTracker
    ) -> None:
        await simulated_tracker.inject_fault("spoil", {"value": 4, "to": 0.002})
        with pytest.raises(RefusedError, match=r"moved by 2\.00 mm"):
            await tracker.measure_point()

    async def test_reckoned_with_impossible_air_are_refused(
        self, tracker: LaserTracker, simulated_tracker: FakeTracker
    ) -> None:
        await simulated_tracker.inject_fault(
            "air", {"temperature_c": 24.0, "pressure_hpa": 990.0, "humidity_percent": 30.0}
        )
        air = (await tracker.measure_point()).air
        assert air is not None
        assert (air.temperature_c, air.pressure_pa, air.humidity_percent) == pytest.approx(
            (24.0, 99000.0, 30.0)
        )
        await simulated_tracker.inject_fault("air", {"pressure_hpa": 0.0})
        with pytest.raises(RefusedError, match="impossible air"):
            await tracker.measure_point()

    async def test_carry_the_covariance_of_the_beam(
        self, tracker: LaserTracker, simulated_tracker: FakeTracker
    ) -> None:
        reading = await tracker.measure_point()
        truth = np.array(simulated_tracker.true_state()["covariance_m2"])
        assert reading.covariance_m2 == pytest.approx(truth[[0, 0, 1], [1, 2, 2]], rel=1e-3)
        assert reading.sigma_m == pytest.approx(np.sqrt(np.diag(truth)), rel=0.05)

    async def test_without_covariance_are_read_too(self, simulated_tracker: FakeTracker) -> None:
        await simulated_tracker.inject_fault("refuse_command", {"command": 80, "status": 2})
        async with config_for(simulated_tracker).open() as tracker:
            reading = await tracker.measure_point()
        assert reading.covariance_m2 == (0.0, 0.0, 0.0)
        assert off_in_sigmas(reading, simulated_tracker) < 5.0

    @pytest.mark.parametrize("value", [0, 17, 20, 24, 31])
    async def test_of_probes_are_checked_too(
        self, tracker: LaserTracker, simulated_tracker: FakeTracker, value: int
    ) -> None:
        await simulated_tracker.inject_fault("spoil", {"value": value})
        with pytest.raises(WireProtocolError):
            await tracker.measure_pose()

    async def test_of_probes_need_a_quaternion(
        self, tracker: LaserTracker, simulated_tracker: FakeTracker
    ) -> None:
        await simulated_tracker.inject_fault("spoil", {"value": 17, "to": 3.0})
        with pytest.raises(WireProtocolError, match="quaternion"):
            await tracker.measure_pose()

    async def test_change_between_points_and_poses(
        self, tracker: LaserTracker, simulated_tracker: FakeTracker
    ) -> None:
        for _ in range(2):
            point, pose = await tracker.measure_point(), await tracker.measure_pose()
            assert np.array(pose.station_probe.position_m) == pytest.approx(
                np.array(point.position_m), abs=3e-4
            )


class TestWhoAnswers:
    async def test_must_have_the_serial_number_of_the_cell_file(self, simulated_tracker: FakeTracker) -> None:
        with pytest.raises(WrongDeviceError, match=r"cell\.toml"):
            async with config_for(simulated_tracker, serial=SERIAL + 1).open():
                pytest.fail("a stranger was let in")

    async def test_that_measures_no_poses_says_so(self) -> None:
        async with fake_tracker(measures_poses=False) as fake, config_for(fake).open() as tracker:
            with pytest.raises(RefusedError, match="6DModeNotAllowed"):
                await tracker.measure_pose()
            assert off_in_sigmas(await tracker.measure_point(), fake) < 5.0


async def test_a_wrong_temperature_makes_lengths_wrong_by_a_part_in_a_million_each_kelvin() -> None:
    async with fake_tracker() as fake, config_for(fake).open() as tracker:
        measure: Callable[[], Awaitable[Any]] = tracker.measure_point
        await fake.inject_fault("air", {"temperature_c": 120.0 - 60.0})
        await fake.inject_fault("entered_temperature", {"temperature_c": -20.0})
        lengths = [np.linalg.norm((await measure()).position_m) for _ in range(60)]
        distance = float(np.linalg.norm(believed_position(fake)))
        assert np.mean(lengths) / distance - 1.0 == pytest.approx(-76e-6, abs=3e-6)
