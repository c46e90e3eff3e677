"""Every sentence of the TouchProbe interface as a test; ``test_contracts.py`` runs them."""

import asyncio
import time
from typing import Any

import pytest

from cellcal.drivers.errors import BusyError, DeviceError, RefusedError, WrongDeviceError
from cellcal.drivers.interfaces import Readiness
from cellcal.service.configuration.cell_file import CellConfig
from cellcal.service.demo.fake_cell_client import FakeCellClient
from tests.wire.driver_cases import ProbeCase, until_open, until_ready, watch_touch


def config_of(cell: CellConfig, case: ProbeCase) -> Any:
    return next(entry.device for entry in cell.probes if entry.device.name == case.name)


class ProbeContract:
    """Mixed into a test class."""

    async def test_a_reading_is_fresh(
        self, probe: Any, probe_case: ProbeCase, fake_client: FakeCellClient
    ) -> None:
        for fault, closed in ((None, False), ("stuck_closed", True), ("stuck_open", False)):
            await probe_case.heal(fake_client)
            if fault is not None:
                await fake_client.inject_fault(fault, device=probe_case.name)
            began_s = time.monotonic()
            reading = await probe.read_contact()
            assert reading.closed is closed
            assert began_s <= reading.taken_at_s <= time.monotonic()

    @pytest.mark.parametrize("way", range(3))
    async def test_inputs_that_stand_still_give_no_reading(
        self, probe: Any, probe_case: ProbeCase, cell: CellConfig, fake_client: FakeCellClient, way: int
    ) -> None:
        fault, parameters = probe_case.stale_faults[way]
        touch = asyncio.create_task(probe.wait_for_touch())
        await asyncio.sleep(0)
        await fake_client.inject_fault(fault, device=probe_case.name, **parameters)
        async with asyncio.timeout(2 * config_of(cell, probe_case).deadline_s):
            with pytest.raises(DeviceError) as seen_while_waiting:
                await touch
            with pytest.raises(DeviceError) as seen_when_asked:
                await probe.read_contact()
        assert seen_while_waiting.value.remedy
        assert seen_when_asked.value.remedy
        condition = await probe.read_condition()
        assert condition.readiness is not Readiness.READY
        assert condition.remedy
        await probe_case.heal(fake_client)
        await until_ready(probe, Readiness.READY)

    @pytest.mark.parametrize("bounce_s", [0.0, 0.005])
    async def test_touched_returns_the_first_touch_in_bounds_that_hold_it(
        self, probe: Any, probe_case: ProbeCase, fake_client: FakeCellClient, bounce_s: float
    ) -> None:
        for _ in range(5):
            if bounce_s:
                await fake_client.inject_fault("bounce", device=probe_case.name, s=bounce_s)
            began_s = time.monotonic()
            touch = await watch_touch(probe, probe_case, fake_client)
            await fake_client.inject_fault("press", device=probe_case.name)
            edge = await touch
            touched_at_s = (await fake_client.read_truth())["probes"][probe_case.name]["touched_at_s"]
            assert began_s < touched_at_s
            assert edge.earliest_s <= touched_at_s <= edge.latest_s
            assert edge.steady
            assert edge.raw
            await probe_case.heal(fake_client)
            await until_open(probe)

    async def test_a_contact_that_does_not_settle_is_reported(
        self, probe: Any, probe_case: ProbeCase, fake_client: FakeCellClient
    ) -> None:
        steady = []
        for _ in range(6):  # a busy machine may happen to look at closed moments only
            await fake_client.inject_fault("bounce", device=probe_case.name, s=5.0, half_s=0.004)
            touch = await watch_touch(probe, probe_case, fake_client)
            await fake_client.inject_fault("press", device=probe_case.name)
            edge = await touch
            assert edge.steady or edge.bounces > 0
            steady.append(edge.steady)
            await probe_case.heal(fake_client)
            await until_open(probe)
        assert not all(steady)

    async def test_a_closed_contact_is_refused(
        self, probe: Any, probe_case: ProbeCase, fake_client: FakeCellClient
    ) -> None:
        await fake_client.inject_fault("stuck_closed", device=probe_case.name)
        with pytest.raises(RefusedError, match="closed already") as refused:
            await probe.wait_for_touch()
        assert refused.value.remedy

    async def test_a_second_wait_during_one_is_busy(
        self, probe: Any, probe_case: ProbeCase, fake_client: FakeCellClient
    ) -> None:
        touch = await watch_touch(probe, probe_case, fake_client)
        with pytest.raises(BusyError):
            await probe.wait_for_touch()
        await fake_client.inject_fault("press", device=probe_case.name)
        assert (await touch).steady

    async def test_a_cancelled_wait_leaves_the_probe_usable(
        self, probe: Any, probe_case: ProbeCase, fake_client: FakeCellClient
    ) -> None:
        for pause_s in (0.0, 0.001, 0.01):
            touch = asyncio.create_task(probe.wait_for_touch())
            await asyncio.sleep(pause_s)
            touch.cancel()
            with pytest.raises(asyncio.CancelledError):
                await touch
            assert not (await probe.read_contact()).closed

    async def test_the_serial_number_is_checked_at_connect(
        self, probe: Any, probe_case: ProbeCase, cell: CellConfig
    ) -> None:
        config = config_of(cell, probe_case)
        assert (await probe.identify()).serial == config.serial.replace(":", "").lower()
        with pytest.raises(WrongDeviceError, match=r"cell\.toml"):
            async with config.model_copy(update={"serial": probe_case.stranger}).open():
                pytest.fail("a stranger was let in")

    @pytest.mark.parametrize("way", range(4))
    async def test_a_lost_link_ends_a_wait_and_heals(
        self, probe: Any, probe_case: ProbeCase, cell: CellConfig, fake_client: FakeCellClient, way: int
    ) -> None:
        fault, parameters = probe_case.link_faults[way]
        touch = await watch_touch(probe, probe_case, fake_client)
        await fake_client.inject_fault(fault, device=probe_case.name, **parameters)
        if fault == "refuse":  # no new client is admitted; connected ones stay
            await fake_client.inject_fault("reset", device=probe_case.name, count=1)
        async with asyncio.timeout(2 * config_of(cell, probe_case).deadline_s):
            with pytest.raises(DeviceError) as failure:
                await touch
        assert failure.value.remedy
        condition = await probe.read_condition()
        assert condition.readiness is Readiness.UNREACHABLE
        await probe_case.heal(fake_client)
        await until_ready(probe, Readiness.READY)
        assert not (await probe.read_contact()).closed

    async def test_what_a_probe_can_do_makes_sense(self, probe: Any) -> None:
        can = probe.capabilities
        assert 0 < can.sigma_m < can.tip_radius_m
        assert 0 <= can.pretravel_m < can.overtravel_m
        assert can.delay_s + can.delay_tolerance_s < can.reaction_s
