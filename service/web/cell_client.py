"""The web process's line to the desk's process: orders out, what screens see in."""

import asyncio
import contextlib
import itertools
import os
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import orjson

from cellcal.calibration.documents.json_text import parse_json
from cellcal.calibration.errors import CellError
from cellcal.drivers.supervision import start_task
from cellcal.service.cell_process.messages import LONGEST_LINE
from cellcal.service.child_processes import ChildEndedError, StderrTail, end_child

ANSWER_S = 10.0
TASK = "process of the cell"
_JUST_NOW_S = 0.25  # live values come ten times a second; older ones say nothing of now


class CellProcessGoneError(CellError):
    """The desk's process does not answer."""

    code = "desk.gone"

    def __init__(self) -> None:
        super().__init__(
            "the cell's process does not answer just now; it is started again.",
            remedy="Wait a few seconds. If it stays away, look into the service's log.",
        )


class InvalidOrderError(CellError):
    """An order that cannot be passed on."""

    code = "request"

    def __init__(self, why: str) -> None:
        super().__init__(f"The request is not understood: {why}.", remedy="See /openapi.json.")


class CellProcessClient:
    """Keeps a desk running for one cell file. A desk that dies is started again; screens are told meanwhile.

    ``on_event`` is called with ("session" or "live", content) for everything that the desk tells.
    """

    def __init__(self, cell_file: Path, on_event: Callable[[str, dict[str, Any]], None]) -> None:
        self._cell_file, self._on_event = cell_file, on_event
        self._numbers = itertools.count(1)
        self._waiting: dict[int, asyncio.Future[dict[str, Any]]] = {}
        self._process: asyncio.subprocess.Process | None = None
        self.session: dict[str, Any] | None = None
        self._live: tuple[float, dict[str, Any]] | None = None

    def start_process(self) -> asyncio.Task[None]:
        """Begin to run the desk; it leaves when the task is cancelled."""
        return start_task(TASK, self._run_once)

    @property
    def live_values(self) -> dict[str, Any] | None:
        """The newest live values, None where none came just now: a desk that hangs must not look alive."""
        heard_s, content = self._live or (float("-inf"), {})
        return content if time.monotonic() - heard_s < _JUST_NOW_S else None

    async def send_order(self, command: dict[str, Any]) -> dict[str, Any]:
        """Send a command and return the desk's reply; DeskGoneError where there is none."""
        return await self._request_reply({"command": command})

    async def _request_reply(self, message: dict[str, Any]) -> dict[str, Any]:
        process = self._process
        if process is None or process.returncode is not None or process.stdin is None:
            raise CellProcessGoneError
        number = next(self._numbers)
        try:
            line = orjson.dumps({"number": number, **message}) + b"\n"
        except TypeError as error:
            raise InvalidOrderError(str(error)) from error
        answer: asyncio.Future[dict[str, Any]] = asyncio.get_running_loop().create_future()
        self._waiting[number] = answer
        try:
            process.stdin.write(line)
            await process.stdin.drain()
            async with asyncio.timeout(ANSWER_S):
                return await answer
        except (TimeoutError, ConnectionError) as error:
            raise CellProcessGoneError from error
        finally:
            self._waiting.pop(number, None)

    async def _run_once(self) -> None:
        self._process = process = await asyncio.create_subprocess_exec(
            sys.executable, "-m", "cellcal.service.cell_process", str(self._cell_file),
            stdin=asyncio.subprocess.PIPE, stdout=asyncio.subprocess.PIPE, stderr=asyncio.subprocess.PIPE,
            limit=LONGEST_LINE, start_new_session=True,  # Ctrl-C is for the service, which lets it leave
            env={**os.environ, "OPENBLAS_NUM_THREADS": "1"},
        )  # fmt: skip
        assert process.stdout is not None
        assert process.stderr is not None
        words = StderrTail()
        try:
            async with asyncio.TaskGroup() as streams:
                streams.create_task(words.pass_on(process.stderr))
                await self._read_messages(process.stdout)
                await self._stop_process()
        except ExceptionGroup as group:
            raise group.exceptions[0] from None
        finally:
            await self._stop_process()
            self._drop_session()
        raise ChildEndedError("the cell's process", process.returncode or 0, words.last_line())

    async def _read_messages(self, stream: asyncio.StreamReader) -> None:
        with contextlib.suppress(ConnectionError):
            while line := await stream.readline():
                self._handle_message(parse_json(line))

    def _drop_session(self) -> None:
        """Let everybody know that the desk is gone."""
        self._process = self.session = self._live = None
        for answer in self._waiting.values():
            if not answer.done():
                answer.set_exception(CellProcessGoneError())
        self._on_event("gone", {})

    def _handle_message(self, message: dict[str, Any]) -> None:
        if "told" in message:
            if message["told"] == "session":
                self.session = message["content"]
            elif message["told"] == "live":
                self._live = (time.monotonic(), message["content"])
            self._on_event(message["told"], message["content"])
            return
        answer = self._waiting.get(message["number"] or 0)
        if answer is not None and not answer.done():
            answer.set_result(message["reply"])

    async def _stop_process(self) -> None:
        if self._process is not None:
            await end_child(self._process)
