"""Every sentence of the DistanceGauge interface as a test; ``test_contracts.py`` runs them."""

import asyncio
import time
from typing import Any

import pytest

from cellcal.drivers.errors import DeviceError, WrongDeviceError
from cellcal.drivers.interfaces import Readiness
from cellcal.service.configuration.cell_file import CellConfig
from cellcal.service.demo.fake_cell_client import FakeCellClient
from tests.wire.driver_cases import GaugeCase, until_ready


async def truth_of(fake_client: FakeCellClient, case: GaugeCase) -> dict[str, Any]:
    return dict((await fake_client.read_truth())[case.shelf][case.name])


def config_of(cell: CellConfig, case: GaugeCase) -> Any:
    entries = (*cell.gauges, *cell.probes)
    return next(entry.device for entry in entries if entry.device.name == case.name)


class GaugeContract:
    """Mixed into a test class."""

    async def test_a_reading_is_the_length_within_its_uncertainty(
        self, gauge: Any, gauge_case: GaugeCase, fake_client: FakeCellClient
    ) -> None:
        for _ in range(20):
            reading = await gauge.read_distance()
            expected = gauge_case.true_length_m(await truth_of(fake_client, gauge_case))
            assert reading.value_m == pytest.approx(expected, abs=5 * reading.sigma_m)
            assert reading.sigma_m == gauge.capabilities.sigma_m
            assert abs(reading.raw * gauge.capabilities.resolution_m - reading.value_m) < 1e-9

    async def test_a_reading_is_taken_after_the_call_began(self, gauge: Any) -> None:
        for _ in range(5):
            began_s = time.monotonic()
            assert began_s <= (await gauge.read_distance()).taken_at_s <= time.monotonic()

    async def test_a_reading_is_as_new_as_the_wire(
        self, gauge: Any, gauge_case: GaugeCase, fake_client: FakeCellClient
    ) -> None:
        before = (await gauge.read_distance()).value_m
        shift_m = gauge_case.shift_m
        await fake_client.inject_fault("wire_offset", device=gauge_case.name, m=shift_m)
        assert (await gauge.read_distance()).value_m - before == pytest.approx(shift_m, abs=shift_m / 25)

    async def test_the_serial_number_is_checked_at_connect(
        self, gauge: Any, gauge_case: GaugeCase, cell: CellConfig
    ) -> None:
        config = config_of(cell, gauge_case)
        assert (await gauge.identify()).serial == gauge_case.shown_serial(config)
        stranger = config.serial + 1 if gauge_case.stranger is None else gauge_case.stranger
        with pytest.raises(WrongDeviceError, match=r"cell\.toml"):
            async with config.model_copy(update={"serial": stranger}).open():
                pytest.fail("a stranger was let in")

    async def test_a_healthy_gauge_is_ready(self, gauge: Any) -> None:
        assert (await gauge.read_condition()).readiness is Readiness.READY
        capabilities = gauge.capabilities
        assert 0 < capabilities.resolution_m < capabilities.sigma_m < capabilities.range_m

    @pytest.mark.parametrize("way", range(4))
    async def test_a_lost_link_is_an_error_within_the_deadline_and_heals(
        self, gauge: Any, gauge_case: GaugeCase, cell: CellConfig, fake_client: FakeCellClient, way: int
    ) -> None:
        fault, parameters = gauge_case.link_faults[way]
        await fake_client.inject_fault(fault, device=gauge_case.name, **parameters)
        async with asyncio.timeout(2 * config_of(cell, gauge_case).deadline_s):
            with pytest.raises(DeviceError) as failure:
                await gauge.read_distance()
        assert gauge_case.name in str(failure.value)
        assert failure.value.remedy
        condition = await gauge.read_condition()
        assert condition.readiness is Readiness.UNREACHABLE
        assert condition.remedy
        await gauge_case.heal(fake_client)
        await until_ready(gauge, Readiness.READY)
        assert (await gauge.read_distance()).value_m > 0
