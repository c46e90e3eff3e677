"""Starts a child, lets it hang or idle, says its pid, and waits to be killed."""

import asyncio
import sys

from cellcal.drivers.wire.process import ChildProcess
from tests.machine_speed import stretched_s


async def _main() -> None:
    child = await ChildProcess.start(
        "arm", "tests.wire.naughty_child", title="the child", start_s=stretched_s(20.0)
    )
    verb = sys.argv[1]
    call = asyncio.create_task(child.call_verb(verb, deadline_s=1.0)) if verb != "idle" else asyncio.sleep(0)
    await asyncio.sleep(0.05)
    print(child.pid, flush=True)
    await asyncio.sleep(3600)
    await call


if __name__ == "__main__":
    asyncio.run(_main())
