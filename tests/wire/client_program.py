"""Programs that hold a client of others: run once against a simulated device, for what they print."""

import asyncio
from pathlib import Path
from typing import Any


async def print_of_client(*command: str | Path, deadline_s: float, **settings: Any) -> bytes:
    """Run a program to its end and return what it printed; what it complains of is shown where it fails."""
    process = await asyncio.create_subprocess_exec(
        *command, stdout=asyncio.subprocess.PIPE, stderr=asyncio.subprocess.PIPE, **settings
    )
    try:
        async with asyncio.timeout(deadline_s):
            printed, complaints = await process.communicate()
    finally:
        if process.returncode is None:
            process.kill()
            await process.wait()
    assert process.returncode == 0, complaints.decode()
    return printed
