"""The desk as a process of its own: orders on standard input, what screens see on standard output, a line each.

Devices, solver and run are here, so that a page that is slow never holds up a capture. The process ends when its
parent does; a run under way is broken off, the robot stands, and the next desk goes on with it.
"""

import asyncio
import contextlib
import sys
from collections.abc import AsyncIterator, Callable
from pathlib import Path
from typing import Any

import orjson
from pydantic import TypeAdapter, ValidationError

from cellcal.calibration.documents.json_text import parse_json
from cellcal.drivers.supervision import start_task
from cellcal.service.cell_process.cell_process import TASK, Desk
from cellcal.service.cell_process.messages import LONGEST_LINE, Command
from cellcal.service.configuration.cell_file import read_cell_file
from cellcal.service.settled import settle
from cellcal.service.unexpected import log_in_lines, run_guarded

_COMMAND: TypeAdapter[Command] = TypeAdapter(Command)


def main(path: str) -> None:
    """Attend one cell until standard input ends."""
    log_in_lines("desk: %(message)s")
    asyncio.run(_attend(Path(path)))


async def _attend(path: Path) -> None:
    write = _writer()
    desk = Desk(read_cell_file(path), lambda kind, content: write({"told": kind, "content": content}))
    settle()
    at_work = start_task(TASK, desk.attend)
    lines = await _lines()
    orders: set[asyncio.Task[None]] = set()
    async for line in whole_lines(lines):
        order = asyncio.create_task(_obey(desk, line, write))
        orders.add(order)
        order.add_done_callback(orders.discard)
    at_work.cancel()
    with contextlib.suppress(asyncio.CancelledError):
        await at_work


async def _obey(desk: Desk, line: bytes, write: Callable[[dict[str, Any]], None]) -> None:
    asked: Any = None
    try:
        asked = parse_json(line)
        if asked.get("ask") == "session":
            reply: dict[str, Any] = {"ok": True, "session": desk.session()}
        else:
            reply = await desk.obey(_COMMAND.validate_python(asked["command"]))
    except (ValidationError, ValueError, KeyError, TypeError, AttributeError) as error:
        reply = {
            "ok": False,
            "code": "desk.not_understood",
            "message": f"The order is not understood: {error}",
            "remedy": "Load the page again.",
        }
    number = asked.get("number") if isinstance(asked, dict) else None
    write({"number": number, "reply": reply})


async def whole_lines(reader: asyncio.StreamReader) -> AsyncIterator[bytes]:
    """Yield line after line; one that is longer than any order is dropped, never the one behind it."""
    kept, too_long = b"", False
    while chunk := await reader.read(1 << 16):
        *whole, rest = (kept + chunk).split(b"\n")
        for line in whole:
            if not too_long and len(line) <= LONGEST_LINE:
                yield line
            too_long = False
        too_long = too_long or len(rest) > LONGEST_LINE
        kept = b"" if too_long else rest


def _writer() -> Callable[[dict[str, Any]], None]:
    stream = sys.stdout.buffer

    def write(message: dict[str, Any]) -> None:
        line = orjson.dumps(message, option=orjson.OPT_SERIALIZE_NUMPY) + b"\n"
        with contextlib.suppress(BrokenPipeError):  # nobody hears any more: standard input ends as well
            stream.write(line)
            stream.flush()

    return write


async def _lines() -> asyncio.StreamReader:
    reader = asyncio.StreamReader()
    loop = asyncio.get_running_loop()
    await loop.connect_read_pipe(lambda: asyncio.StreamReaderProtocol(reader), sys.stdin)
    return reader


if __name__ == "__main__":
    sys.exit(run_guarded(lambda: main(sys.argv[1])))
