"""A device that is connected for the length of a block."""

from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from typing import Protocol


class ConnectedDevice(Protocol):
    """The context that opens and closes a device's connection."""

    async def connect(self) -> None: ...
    async def close(self) -> None: ...


@asynccontextmanager
async def connection_to(device: ConnectedDevice) -> AsyncIterator[None]:
    """Connect a device for a block and close it at the end, also where connecting has failed."""
    try:
        await device.connect()
        yield
    finally:
        await device.close()
