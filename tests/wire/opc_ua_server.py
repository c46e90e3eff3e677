"""A robot with an OPC UA server for one test, on a loopback address of its own, and what tests ask of its driver."""

import asyncio
import random
from collections.abc import AsyncIterator, Mapping
from contextlib import asynccontextmanager, suppress
from typing import Any

import pytest

from cellcal.drivers.errors import DeviceError, UnreachableError
from cellcal.drivers.opc_ua.config import OpcUaConfig
from cellcal.fake_devices.opc_ua.device import FakeOpcUaRobot, create_device
from cellcal.fake_devices.world import World
from tests.machine_speed import stretched_s

SERIAL = "ER-230817"
POSITION = "Axis_3/ParameterSet/ActualPosition"


@asynccontextmanager
async def fake_server(settings: Mapping[str, Any] | None = None) -> AsyncIterator[FakeOpcUaRobot]:
    """Start a robot with an OPC UA server on a loopback address of its own."""
    rng = random.SystemRandom()
    for _ in range(20):
        address = f"127.{rng.randint(1, 250)}.{rng.randint(0, 250)}.{rng.randint(1, 250)}"
        table = {"name": "any_maker", "model": "fanuc_m6ib", "serial": SERIAL, "address": address}
        fake = create_device(World(3), {**table, "settings": settings or {}})
        try:
            await fake.start()
        except OSError:
            continue
        fake.address = address
        try:
            yield fake
        finally:
            await fake.stop()
        return
    raise AssertionError("no free loopback address")


def config_of(fake: Any, **changes: Any) -> OpcUaConfig:
    """Return the entry of a cell file that reaches this fake."""
    entry = {
        "driver": "opc_ua", "name": "any_maker", "model": "fanuc_m6ib", "serial": SERIAL, "address": fake.address,
        "deadline_s": stretched_s(2.0), "still_s": 0.1,
    }  # fmt: skip
    return OpcUaConfig.model_validate({**entry, **changes})


def believed(fake: FakeOpcUaRobot) -> list[float]:
    return list(fake.true_state()["controller_joints_rad"])


async def failure_of(call: Any) -> DeviceError:
    """Return the error of a call, which names the device and says what to do."""
    with pytest.raises(DeviceError) as failure:
        await call
    assert "any_maker" in str(failure.value)
    assert failure.value.remedy
    return failure.value


async def failure_of_opening(config: OpcUaConfig) -> DeviceError:
    async def opened() -> None:
        async with config.open():
            pytest.fail("it was let in")

    return await failure_of(opened())


async def reads_again(robot: Any, fake: FakeOpcUaRobot) -> None:
    """Read until the link is back, and compare with the truth."""
    async with asyncio.timeout(stretched_s(20.0)):
        while True:
            with suppress(UnreachableError):
                assert (await robot.read_joints()).joints_rad == pytest.approx(believed(fake), abs=1e-9)
                return
            await asyncio.sleep(0.01)


async def until_standing(robot: Any) -> None:
    async with asyncio.timeout(stretched_s(20.0)):
        while (await robot.read_joints()).moving:
            await asyncio.sleep(0.01)
