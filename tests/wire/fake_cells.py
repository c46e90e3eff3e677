"""Fake cells for wire tests: built in this process, on ports that the system picks."""

import asyncio
import struct
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager
from typing import Any

from cellcal.fake_devices.cell import FakeCell
from cellcal.fake_devices.control_server import ControlServer
from cellcal.fake_devices.device import FakeDevice
from tests.machine_speed import stretched_s

ROBOT = {"name": "fanuc", "driver": "modbus_robot", "address": "127.0.0.1", "port": 0, "serial": "F-104711"}
GAUGE = {
    "name": "wire", "driver": "draw_wire", "host": "127.0.0.1", "port": 0, "channel": "can0",
    "node_id": 7, "serial": 4711, "range_m": 3.0, "sigma_m": 0.0002, "robot": "fanuc",
}  # fmt: skip


def cell_document(**fake: Any) -> dict[str, Any]:
    """Return the cell file of a robot and its wire; the clock runs 500 times as fast, watchdogs wait long."""
    return {
        "robot": [ROBOT],
        "gauge": [GAUGE],
        "fake": {"seed": 1, "time_factor": 500.0, "watchdog_factor": 10.0, **fake},
    }


@asynccontextmanager
async def run_cell(**fake: Any) -> AsyncIterator[FakeCell]:
    """Run that cell."""
    async with FakeCell(cell_document(**fake)) as cell:
        yield cell


@asynccontextmanager
async def behind_control_server(**fake: Any) -> AsyncIterator[ControlServer]:
    """Run that cell with its control port."""
    async with FakeCell(cell_document(**fake)) as cell, ControlServer(cell) as control_server:
        yield control_server


async def wait_until(true: Callable[[], bool]) -> None:
    """Wait for something that will become true."""
    async with asyncio.timeout(stretched_s(30.0)):
        while not true():
            await asyncio.sleep(0.002)


async def cause_fault(device: FakeDevice, fault: str, **parameters: Any) -> None:
    """Let a fault happen to a device."""
    await device.inject_fault(fault, parameters)


def int32_words(*values: int) -> list[int]:
    """Return registers, low word first."""
    return [word for value in values for word in struct.unpack("<HH", struct.pack("<i", value))]


def float32_words(*values: float) -> list[int]:
    """Return registers, low word first."""
    return [word for value in values for word in struct.unpack("<HH", struct.pack("<f", value))]


def integers_from(words: list[int]) -> list[int]:
    """Return the signed 32-bit values of registers."""
    return list(struct.unpack(f"<{len(words) // 2}i", struct.pack(f"<{len(words)}H", *words)))


def floats_from(words: list[int]) -> list[float]:
    """Return the single-precision values of registers."""
    return list(struct.unpack(f"<{len(words) // 2}f", struct.pack(f"<{len(words)}H", *words)))


def text_from(words: list[int]) -> str:
    """Return the string in registers, low byte first."""
    return struct.pack(f"<{len(words)}H", *words).split(b"\0")[0].decode("latin-1")
