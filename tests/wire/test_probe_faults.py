"""What a coupler, a dial gauge and a Modbus encoder can do wrong, seen by their drivers; and the fakes themselves."""

from collections.abc import AsyncIterator
from typing import Any

import pytest
from pymodbus.client import AsyncModbusTcpClient

from cellcal.drivers.errors import DeviceError, RefusedError, WireProtocolError, WrongDeviceError
from cellcal.drivers.interfaces import Readiness
from cellcal.service.configuration.cell_file import CellConfig
from cellcal.service.demo.fake_cell_client import FakeCellClient
from tests.wire.driver_cases import GAUGES, PROBES, Fault, open_retrying, until_open


@pytest.fixture
async def dial_gauge(cell: CellConfig, fake_client: FakeCellClient) -> AsyncIterator[Any]:
    await GAUGES["dial_gauge"].heal(fake_client)
    async with open_retrying(_device_config(cell, "dial")) as dial:
        yield dial


@pytest.fixture
async def draw_wire(cell: CellConfig, fake_client: FakeCellClient) -> AsyncIterator[Any]:
    await GAUGES["draw_wire_modbus"].heal(fake_client)
    async with open_retrying(_device_config(cell, "wire_tcp")) as wire:
        yield wire
    await fake_client.inject_fault("preset", device="wire_tcp", m=0.0)


def _device_config(cell: CellConfig, name: str) -> Any:
    return next(entry.device for entry in (*cell.gauges, *cell.probes) if entry.device.name == name)


# dial gauge


@pytest.mark.parametrize(
    ("fault", "parameters", "words"),
    [
        ("wire_break", {}, "below 4 mA or a broken wire"),
        ("overrange", {}, "above 20 mA"),
        ("push_in", {"m": 0.0}, "plunger is free"),
        ("push_in", {"m": 0.01247}, "plunger is at its end"),
        ("image_frozen", {}, "stands still"),
        ("bus_break", {"terminal": 5}, "after terminal 5"),
        ("watchdog_expired", {}, "watchdog has run out"),
    ],
)
async def test_a_dial_gauge_that_cannot_measure_says_why(
    dial_gauge: Any, fake_client: FakeCellClient, fault: str, parameters: dict[str, Any], words: str
) -> None:
    await fake_client.inject_fault(fault, device="dial", **parameters)
    with pytest.raises(DeviceError, match=words) as refused:
        await dial_gauge.read_distance()
    assert refused.value.remedy
    await GAUGES["dial_gauge"].heal(fake_client)
    assert (await dial_gauge.read_distance()).value_m == pytest.approx(0.004, abs=5e-5)


async def test_terminals_that_were_added_are_noticed_at_the_next_connect(
    cell: CellConfig, fake_client: FakeCellClient
) -> None:
    """Four more analogue words push the digital inputs away; the coupler reports it, and no setting must count them."""
    await PROBES["touch_probe"].heal(fake_client)
    await fake_client.inject_fault("terminal_added", device="probe")
    async with open_retrying(_device_config(cell, "probe")) as probe:
        await until_open(probe)
        await fake_client.inject_fault("stuck_closed", device="probe")
        assert (await probe.read_contact()).closed


@pytest.mark.parametrize(
    ("change", "words"),
    [({"contact_input": 9}, "8 digital inputs"), ({"echo_output": 9}, "8 digital outputs")],
)
async def test_a_channel_that_is_not_on_the_rail_is_refused(
    cell: CellConfig, fake_client: FakeCellClient, change: dict[str, int], words: str
) -> None:
    async with _device_config(cell, "probe").model_copy(update=change).open() as probe:
        with pytest.raises(RefusedError, match=words) as refused:
            await probe.read_contact()
        assert "cell.toml" in refused.value.remedy


async def test_an_echo_that_is_not_wired_is_a_dead_image(
    cell: CellConfig, fake_client: FakeCellClient
) -> None:
    async with _device_config(cell, "probe").model_copy(update={"echo_input": 5}).open() as probe:
        with pytest.raises(DeviceError, match="stands still") as dead:
            await probe.read_contact()
        assert "wire" in dead.value.remedy


async def test_the_echo_leaves_other_outputs_alone(cell: CellConfig, fake_client: FakeCellClient) -> None:
    config = _device_config(cell, "probe")
    client = AsyncModbusTcpClient(config.address, port=config.port)
    assert await client.connect()
    await client.write_coil(0x0200 + 6, True)  # another user's gripper
    async with config.open() as probe:
        await probe.read_contact()
        await probe.read_contact()
    assert (await client.read_coils(0x0200, count=8)).bits[6]
    await client.write_coil(0x0200 + 6, False)
    client.close()


async def test_an_exception_of_the_coupler_without_a_reason_stays_what_it_is(
    cell: CellConfig, fake_client: FakeCellClient
) -> None:
    async with _device_config(cell, "probe").open() as probe:
        await probe.read_contact()
        await fake_client.inject_fault("exception", device="probe", code=4, function=3, count=1)
        with pytest.raises(RefusedError, match="exception 4"):
            await probe.read_contact()


@pytest.mark.parametrize("fault", ["wrong_tid", "wrong_function", "short_list"])
async def test_a_foreign_answer_never_becomes_a_contact(
    cell: CellConfig, fake_client: FakeCellClient, fault: str
) -> None:
    async with _device_config(cell, "probe").open() as probe:
        await probe.read_contact()
        await fake_client.inject_fault(fault, device="probe", count=1)
        with pytest.raises((WireProtocolError, DeviceError)):
            await probe.read_contact()
        assert not (await probe.read_contact()).closed


# Modbus draw-wire


@pytest.mark.parametrize(
    ("fault", "error", "words"),
    [
        (("encoder_alarm", {"bits": 2}), RefusedError, "flash memory"),
        (("other_device", {}), WrongDeviceError, "serial number 816"),
        (("swapped_words", {}), WrongDeviceError, "serial number"),
        (("preset", {"m": 0.02}), RefusedError, "zero of the gauge moved by 20.0 mm"),
        (("wire_snap", {}), RefusedError, "all in"),
        (("wire_offset", {"m": 5.0}), RefusedError, "out to its end"),
    ],
)
async def test_an_encoder_that_cannot_be_trusted_gives_no_length(
    draw_wire: Any, fake_client: FakeCellClient, fault: Fault, error: type[DeviceError], words: str
) -> None:
    await draw_wire.read_distance()
    name, parameters = fault
    await fake_client.inject_fault(name, device="wire_tcp", **parameters)
    with pytest.raises(error, match=words) as refused:
        await draw_wire.read_distance()
    assert refused.value.remedy
    if name in ("encoder_alarm", "preset"):
        assert (await draw_wire.read_condition()).readiness is Readiness.NOT_READY
    await GAUGES["draw_wire_modbus"].heal(fake_client)
    if name == "preset":
        await fake_client.inject_fault("preset", device="wire_tcp", m=-parameters["m"])
    assert (await draw_wire.read_distance()).value_m > 0


# the fakes, seen by an unmodified client


async def test_the_fake_coupler_answers_as_its_manual_says(
    cell: CellConfig, fake_client: FakeCellClient
) -> None:
    await GAUGES["dial_gauge"].heal(fake_client)
    config = _device_config(cell, "probe")
    client = AsyncModbusTcpClient(config.address, port=config.port)
    assert await client.connect()
    assert (await client.read_holding_registers(0x2000, count=9)).registers == [
        0, 0xFFFF, 0x1234, 0xAAAA, 0x5555, 0x7FFF, 0x8000, 0x3FFF, 0x4000,
    ]  # fmt: skip
    assert (await client.read_holding_registers(0x1022, count=4)).registers == [0, 64, 8, 8]
    assert (await client.read_holding_registers(0x1031, count=3)).registers == [0x0030, 0xDE0A, 0x0B0C]
    image = (await client.read_input_registers(0, count=5)).registers
    assert image[0] == 3  # nothing is wired there: below 4 mA
    assert image[1] & 7 == 0
    assert image[1] >> 3 == pytest.approx(0.004 / 0.0125 * 4095, abs=8)
    assert (await client.read_holding_registers(0x1234, count=1)).exception_code == 2
    assert (await client.read_holding_registers(0, count=6)).exception_code == 2
    assert (await client.write_coil(0x0200 + 9, True)).exception_code == 2
    await client.write_registers(0x0200, [0b101])
    assert (await client.read_holding_registers(0x0200, count=1)).registers == [0b101]
    bits = (await client.read_discrete_inputs(0, count=8)).bits
    assert bits[1]  # the first output is wired back to the second input
    await client.write_register(0x0200, 0)
    assert not (await client.read_discrete_inputs(0, count=8)).bits[1]
    client.close()


async def test_the_fake_encoder_answers_as_its_manual_says(
    cell: CellConfig, fake_client: FakeCellClient
) -> None:
    await GAUGES["draw_wire_modbus"].heal(fake_client)
    config = _device_config(cell, "wire_tcp")
    client = AsyncModbusTcpClient(config.host, port=config.port)
    assert await client.connect()
    high, low = (await client.read_input_registers(0, count=2)).registers
    again = (await client.read_holding_registers(94, count=2)).registers
    assert high << 16 | low == pytest.approx(again[0] << 16 | again[1], abs=20)
    true_m = (await fake_client.read_truth())["gauges"]["wire_tcp"]["reading_m"]
    assert (high << 16 | low) * config.step_um * 1e-6 == pytest.approx(true_m, abs=1e-3)
    assert (await client.read_holding_registers(0, count=1)).exception_code == 2
    assert (await client.write_register(94, 0)).exception_code == 2
    assert (await client.read_coils(0, count=1)).exception_code == 1
    client.close()
