"""Supervises a process beside the web service that reports to the outside, and forwards the cell's events to it.

The web process only writes lines into a pipe and never waits for it: what does not fit is left out, since the next
line is newer anyway. The site's publisher and the webhook's sender are such processes.
"""

import asyncio
import contextlib
import os
import sys
from pathlib import Path

import orjson

from cellcal.calibration.message import make_message
from cellcal.calibration.message_table import with_messages
from cellcal.drivers.supervision import start_task
from cellcal.service.child_processes import ChildEndedError, StderrTail, end_child
from cellcal.service.session_documents import EventContent

_MOST_WAITING = 1 << 20  # bytes in the pipe
_SESSION_AGAIN_S = 2.0


class ForwardingProcess:
    """Runs ``python -m MODULE CELL_FILE`` for one cell file; one that ends is started again."""

    def __init__(self, module: str, cell_file: Path) -> None:
        self.module, self._cell_file = module, cell_file
        self.title = make_message("process {module}", module=module)
        self._process: asyncio.subprocess.Process | None = None
        self._session: bytes = b""

    def on_event(self, kind: str, content: EventContent) -> None:
        """Pass on a message of the cell process."""
        line = orjson.dumps(with_messages({"told": kind, "content": content})) + b"\n"
        if kind != "live":
            self._session = line
        self._write_line(line)

    def start_tasks(self) -> list[asyncio.Task[None]]:
        """Begin to keep the process; it leaves when the tasks are cancelled."""
        return [
            start_task(make_message("words for {receiver}", receiver=self.title), self._resend_session),
            start_task(self.title, self._run_once),
        ]

    async def _run_once(self) -> None:
        self._process = process = await asyncio.create_subprocess_exec(
            sys.executable, "-m", self.module, str(self._cell_file),
            stdin=asyncio.subprocess.PIPE, stderr=asyncio.subprocess.PIPE, start_new_session=True,
            env={**os.environ, "OPENBLAS_NUM_THREADS": "1"},
        )  # fmt: skip
        assert process.stderr is not None
        words = StderrTail()
        try:
            self._write_line(self._session)
            await words.pass_on(process.stderr)
            code = await process.wait()
        finally:
            await self._stop_process()
        raise ChildEndedError(self.title, code, words.last_line())

    async def _resend_session(self) -> None:
        while True:  # a line may have been left out, and a process that was started again has heard none
            await asyncio.sleep(_SESSION_AGAIN_S)
            self._write_line(self._session)

    def _write_line(self, line: bytes) -> None:
        process = self._process
        if not line or process is None or process.returncode is not None or process.stdin is None:
            return
        if process.stdin.transport.get_write_buffer_size() < _MOST_WAITING:
            with contextlib.suppress(ConnectionError, RuntimeError):
                process.stdin.write(line)

    async def _stop_process(self) -> None:
        if self._process is not None:
            await end_child(self._process)
