"""Everything waits with a deadline, and a missed one says what was waited for."""

import asyncio
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager

from cellcal.drivers.errors import DeviceTimeoutError

_REMEDY = "Check the device and its cable, then try again."


@asynccontextmanager
async def deadline(device: str, seconds: float, doing: str) -> AsyncIterator[None]:
    """Raise DeviceTimeoutError when the block takes longer than ``seconds``."""
    limit = asyncio.timeout(seconds)
    try:
        async with limit:
            yield
    except TimeoutError:
        if not limit.expired():
            raise
        raise too_long(device, seconds, doing) from None


def too_long(device: str, seconds: float, doing: str) -> DeviceTimeoutError:
    """Return the error of a device that did not come to an end in time."""
    return DeviceTimeoutError(device, f"{doing} took longer than {seconds:.4g} s.", remedy=_REMEDY)
