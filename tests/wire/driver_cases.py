"""What the contract suites need to know of each gauge and probe, and how a test waits for a device."""

import asyncio
from collections.abc import AsyncIterator, Awaitable, Callable
from contextlib import AsyncExitStack, asynccontextmanager
from dataclasses import dataclass
from typing import Any

from cellcal.drivers.errors import DeviceError
from cellcal.drivers.interfaces import Condition, ContactEdge, Readiness
from cellcal.service.demo.fake_cell_client import FakeCellClient
from tests.machine_speed import stretched_s

Fault = tuple[str, dict[str, Any]]
Truth = dict[str, Any]


@dataclass(frozen=True)
class GaugeCase:
    """One gauge of the cell file, by the name it has there."""

    name: str
    heal: Callable[[FakeCellClient], Awaitable[None]]
    link_faults: tuple[Fault, ...]
    true_length_m: Callable[[Truth], float] = lambda truth: truth["reading_m"]
    shelf: str = "gauges"  # of the cell file and of the control port's truth
    shift_m: float = 0.05  # a change within its range
    stranger: Any = None  # the serial of another one; None: the next number
    shown_serial: Callable[[Any], str] = lambda config: str(config.serial)


@dataclass(frozen=True)
class ProbeCase:
    """One touch probe of the cell file, by the name it has there."""

    name: str
    heal: Callable[[FakeCellClient], Awaitable[None]]
    link_faults: tuple[Fault, ...]
    stale_faults: tuple[Fault, ...]  # every way in which its inputs can stop telling
    stranger: Any


async def wait_until(holds: Callable[[], Awaitable[bool]]) -> None:
    """Ask again and again until it holds; the world is another process and cannot tell us."""
    async with asyncio.timeout(stretched_s(60.0)):
        while not await holds():
            await asyncio.sleep(0.01)


@asynccontextmanager
async def open_retrying(config: Any) -> AsyncIterator[Any]:
    """Open a device that may still be coming back from what an earlier test did to it."""
    async with AsyncExitStack() as stack:
        found: list[Any] = []

        async def is_there() -> bool:
            try:
                found.append(await stack.enter_async_context(config.open()))
            except DeviceError:
                return False
            return True

        await wait_until(is_there)
        yield found[0]


async def until_ready(device: Any, readiness: Readiness) -> Condition:
    """Wait for one readiness and return the condition that had it."""
    found: list[Condition] = []

    async def is_ready() -> bool:
        found.append(await device.read_condition())
        return found[-1].readiness is readiness

    await wait_until(is_ready)
    return found[-1]


async def until_open(probe: Any) -> None:
    """Wait until a probe's contact is open."""

    async def is_open() -> bool:
        return not (await probe.read_contact()).closed

    await wait_until(is_open)


async def watch_touch(
    probe: Any, case: ProbeCase, fake_client: FakeCellClient
) -> "asyncio.Task[ContactEdge]":
    """Wait for a touch in a task of its own; return once the probe has seen the contact open.

    The driver's second write of its echo tells: the first one came back in the image that the watch starts from.
    """

    async def write_count() -> int:
        return int((await fake_client.read_truth())["probes"][case.name]["output_writes"])

    before = await write_count()
    task = asyncio.create_task(probe.wait_for_touch())

    async def has_looked() -> bool:
        return task.done() or await write_count() >= before + 2

    await wait_until(has_looked)
    return task


async def _heal_draw_wire(fake_client: FakeCellClient) -> None:
    await fake_client.send_command("clear")
    await fake_client.inject_fault("node_off", device="wire")  # forgets every answer that is still under way
    await fake_client.inject_fault("node_on", device="wire")
    await fake_client.inject_fault("wire_restore", device="wire")
    await fake_client.inject_fault("emcy_clear", device="wire")


async def _heal_by_clearing(fake_client: FakeCellClient) -> None:
    await fake_client.send_command("clear")


async def _heal_modbus_draw_wire(fake_client: FakeCellClient) -> None:
    await fake_client.send_command("clear")
    await fake_client.inject_fault("wire_restore", device="wire_tcp")


async def _heal_dial(fake_client: FakeCellClient) -> None:
    await fake_client.send_command("clear")
    await fake_client.inject_fault("push_in", device="dial", m=0.004)


_MODBUS_LINK: tuple[Fault, ...] = (("silent", {}), ("reset", {}), ("refuse", {}), ("cut", {"bytes": 5}))
_OTHER_MAC = "00:30:DE:0A:0B:0D"


GAUGES: dict[str, GaugeCase] = {
    "draw_wire": GaugeCase(
        name="wire",
        heal=_heal_draw_wire,
        link_faults=(("daemon_stop", {}), ("daemon_hang", {}), ("sdo_silent", {}), ("node_off", {})),
    ),
    "draw_wire_modbus": GaugeCase(name="wire_tcp", heal=_heal_modbus_draw_wire, link_faults=_MODBUS_LINK),
    "dial_gauge": GaugeCase(
        name="dial",
        heal=_heal_dial,
        link_faults=_MODBUS_LINK,
        shelf="probes",
        shift_m=0.002,
        stranger=_OTHER_MAC,
        shown_serial=lambda config: config.serial.replace(":", "").lower(),
    ),
}

PROBES: dict[str, ProbeCase] = {
    "touch_probe": ProbeCase(
        name="probe",
        heal=_heal_by_clearing,
        link_faults=_MODBUS_LINK,
        stale_faults=(("image_frozen", {}), ("bus_break", {"terminal": 2}), ("watchdog_expired", {})),
        stranger=_OTHER_MAC,
    ),
}
