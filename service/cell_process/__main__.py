"""The desk as a process of its own: orders on standard input, what screens see on standard output, a line each.

Devices, solver and run are here, so that a page that is slow never holds up a capture. The process ends when its
parent does; a run under way is broken off, the robot stands, and the next desk goes on with it.
"""

import asyncio
import contextlib
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
from cellcal.service.gc_freeze import freeze_startup_objects
from cellcal.service.session_documents import OrderReply
from cellcal.service.unexpected_errors import log_in_lines, run_guarded

_COMMAND: TypeAdapter[SessionCommand] = TypeAdapter(SessionCommand)


def main(path: str, *how: str) -> None:
    """Attend one cell until standard input ends. With ``BROKEN_OFF`` the run under way waits for a person."""
    log_in_lines("desk: %(message)s")
    asyncio.run(_run_controller(Path(path), broken_off=BROKEN_OFF in how))


async def _run_controller(path: Path, *, broken_off: bool) -> None:
    write = _make_writer()
    config = read_cell_file(path)
    if broken_off:
        RunInProgress(config.cell.data_dir).clear_run()
    controller = CellController(config, lambda kind, content: write({"told": kind, "content": content}))
    freeze_startup_objects()
    at_work = start_task(TASK, controller.stay_connected)
    lines = await _connect_stdin()
    orders: set[asyncio.Task[None]] = set()
    async for line in whole_lines(lines, _name_long_line):
        order = asyncio.create_task(_answer_line(controller, line, write))
        orders.add(order)
        order.add_done_callback(orders.discard)
    at_work.cancel()
    with contextlib.suppress(asyncio.CancelledError):
        await at_work


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
