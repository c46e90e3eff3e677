"""The cell process: orders on standard input, what screens show on standard output, one line each.

Devices, solver and run are here, so that a page that is slow never holds up a capture. The process ends when its
parent does; a run under way is broken off, the robot stands, and the next cell process continues it.
"""

import asyncio
import contextlib
import logging
import os
import sys
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from pydantic import TypeAdapter, ValidationError

from cellcal.calibration.documents.json_text import parse_json
from cellcal.calibration.message import make_message
from cellcal.drivers.supervision import SUPERVISOR, start_task
from cellcal.service.cell_process.cell_controller import TASK, CellController
from cellcal.service.cell_process.lines import LineTooLongError, LineWriter, whole_lines
from cellcal.service.cell_process.messages import ALIVE, BROKEN_OFF, SessionCommand
from cellcal.service.cell_process.run_in_progress import RunInProgress
from cellcal.service.configuration.cell_file import read_cell_file
from cellcal.service.exit_codes import ExitCode
from cellcal.service.gc_freeze import freeze_startup_objects
from cellcal.service.session_documents import OrderReply
from cellcal.service.unexpected_errors import log_in_lines, run_guarded

_log = logging.getLogger(__name__)
LONGEST_END_S = 100.0  # from the end of standard input until the devices are released
_COMMAND: TypeAdapter[SessionCommand] = TypeAdapter(SessionCommand)


def main(path: str, *how: str) -> None:
    """Attend one cell until standard input ends. With ``BROKEN_OFF`` the run under way waits for a person."""
    log_in_lines("cell process: %(message)s")
    asyncio.run(_run_controller(Path(path), broken_off=BROKEN_OFF in how))


async def _run_controller(path: Path, *, broken_off: bool) -> None:
    write = _make_writer()
    config = read_cell_file(path)
    if broken_off:
        RunInProgress(config.cell.data_dir).clear_run()
    controller = CellController(config, lambda kind, content: write({"told": kind, "content": content}))
    freeze_startup_objects()
    at_work = start_task(TASK, controller.stay_connected)
    try:
        await _answer_lines(controller, write)
    finally:
        await _end_or_exit(at_work)


async def _answer_lines(controller: CellController, write: Callable[[Mapping[str, object]], None]) -> None:
    """Execute the orders of standard input until it ends."""
    orders: set[asyncio.Task[None]] = set()
    async for line in whole_lines(await _connect_stdin(), _name_long_line):
        order = asyncio.create_task(_answer_line(controller, line, write))
        orders.add(order)
        order.add_done_callback(orders.discard)


async def _end_or_exit(at_work: asyncio.Task[None]) -> None:
    """Cancel the work on the devices; leave the process where that does not end, with what it waits for in the log.

    A process without its parent must not keep the lease of the robot. The robot stands: its heartbeat ends with us.
    """
    at_work.cancel()
    await asyncio.wait({at_work}, timeout=LONGEST_END_S)
    if at_work.done():
        with contextlib.suppress(asyncio.CancelledError):
            at_work.result()
        return
    _log.error(
        "the devices were not released within %g s; the process ends: %s",
        LONGEST_END_S,
        describe_awaited(at_work),
    )
    sys.stderr.flush()
    os._exit(ExitCode.INTERNAL)


def describe_awaited(task: asyncio.Task[None]) -> str:
    """Return where a task waits: its coroutines from the outermost inwards, each with its file and line."""
    found: list[str] = []
    inner: Any = task.get_coro()
    while inner is not None:
        kind = next((kind for kind in ("cr", "gi", "ag") if hasattr(inner, f"{kind}_frame")), None)
        frame = None if kind is None else getattr(inner, f"{kind}_frame")
        if frame is None:  # a future, or a coroutine that has ended
            break
        found.append(f"{frame.f_code.co_qualname} ({frame.f_code.co_filename}:{frame.f_lineno})")
        inner = getattr(inner, "gi_yieldfrom" if kind == "gi" else f"{kind}_await")
    return " > ".join(found)


async def _answer_line(
    controller: CellController, line: bytes, write: Callable[[Mapping[str, object]], None]
) -> None:
    request: Any = None
    try:
        request = parse_json(line)
        if request.get("ask") == "session":
            reply: OrderReply = {"ok": True, "session": controller.describe_session()}
        elif request.get("ask") == ALIVE:
            reply = {"ok": True}
        else:
            reply = await controller.execute_command(_COMMAND.validate_python(request["command"]))
    except (ValidationError, ValueError, KeyError, TypeError, AttributeError) as error:
        reply = {
            "ok": False,
            "code": "desk.not_understood",
            "message": make_message("The order is not understood: {error}", error=error),
            "remedy": "Load the page again.",
        }
    number = request.get("number") if isinstance(request, dict) else None
    write({"number": number, "reply": reply})


def _name_long_line() -> None:
    SUPERVISOR.note_failure("orders to the cell", LineTooLongError("an order"), running=True)


def _make_writer() -> Callable[[Mapping[str, object]], None]:
    stream, lines = sys.stdout.buffer, LineWriter()

    def write(message: Mapping[str, object]) -> None:
        line = lines.line_of(message)
        with contextlib.suppress(BrokenPipeError):  # the reader is gone: standard input ends as well
            stream.write(line)
            stream.flush()

    return write


async def _connect_stdin() -> asyncio.StreamReader:
    reader = asyncio.StreamReader()
    loop = asyncio.get_running_loop()
    await loop.connect_read_pipe(lambda: asyncio.StreamReaderProtocol(reader), sys.stdin)
    return reader


if __name__ == "__main__":
    sys.exit(run_guarded(lambda: main(*sys.argv[1:])))
