"""The web process's client of the cell process: sends orders, receives what screens show."""

import asyncio
import contextlib
import itertools
import os
import sys
import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import orjson

from cellcal.calibration.documents.json_text import parse_json
from cellcal.calibration.errors import CellError
from cellcal.calibration.message import make_message
from cellcal.calibration.message_table import remember_table
from cellcal.drivers.supervision import SUPERVISOR, log_failures, start_task
from cellcal.service.cell_process.lines import LineTooLongError, whole_lines
from cellcal.service.cell_process.messages import ALIVE, BROKEN_OFF, LONGEST_LINE
from cellcal.service.cell_process.run_in_progress import RunInProgress
from cellcal.service.child_processes import ChildEndedError, StderrTail, end_child
from cellcal.service.configuration.cell_file import read_cell_file
from cellcal.service.session_documents import (
    CommandDocument,
    LiveDocument,
    OnCellEvent,
    OrderReply,
    SessionDocument,
)
from cellcal.service.web.liveness import (
    HANGS_AFTER_S,
    TICK_S,
    CellHangsError,
    UnansweredTime,
    read_process_state,
)

ANSWER_S = 10.0
STOP_ANSWER_S = 2.0  # where the cell process sends nothing at all: a person must not wait for the answer
TASK = "process of the cell"
_LINES = "words of the cell's process"
_NOTE = "note that no run goes on by itself"
_NOTED_S = 5.0  # a disk that takes longer is not waited for
_MOST_UNREAD = 4 * LONGEST_LINE
_JUST_NOW_S = 0.25  # live values come ten times a second; older ones say nothing of now


class CellProcessGoneError(CellError):
    """The cell process does not answer."""

    code = "desk.gone"

    def __init__(self) -> None:
        super().__init__(
            "the cell's process does not answer just now; it is started again.",
            remedy="Wait a few seconds. If it stays away, look into the service's log.",
        )


class CellProcessSilentError(CellProcessGoneError):
    """The cell process runs, and did not answer in time."""

    code = "desk.silent"

    def __init__(self) -> None:
        CellError.__init__(
            self,
            make_message(
                "the cell's process did not answer within {answer_s:.0f} s; it is not known whether it "
                "did what was ordered.",
                answer_s=ANSWER_S,
            ),
            remedy="See on this page and at the robot what was done, then go on.",
        )


class StopUnconfirmedError(CellProcessGoneError):
    """A stop that may not have reached the robot."""

    code = "desk.stop_unconfirmed"

    def __init__(self) -> None:
        CellError.__init__(
            self,
            "the stop is not confirmed: the cell's process does not answer, and the robot may still move.",
            remedy="Press the emergency stop. No run goes on by itself afterwards.",
        )


class InvalidOrderError(CellError):
    """An order that cannot be passed on."""

    code = "request"

    def __init__(self, why: str) -> None:
        super().__init__(
            make_message("The request is not understood: {why}.", why=why), remedy="See /openapi.json."
        )


class CellProcessClient:
    """Keeps a cell process running for one cell file. One that ends is started again; screens show that meanwhile.

    ``on_event`` is called with ("session" or "live", content) for each message of the cell process.
    """

    def __init__(
        self,
        cell_file: Path,
        on_event: OnCellEvent,
        *,
        hangs_after_s: float = HANGS_AFTER_S,
    ) -> None:
        self._cell_file, self._on_event = cell_file, on_event
        self._unanswered = UnansweredTime(hangs_after_s)
        self._hangs_after_s = hangs_after_s
        self._lines_received = 0
        self._broken_off = False  # the run under way waits for a person: it was to stop, or the process hung
        self._begun_broken_off = False
        self._noting: asyncio.Task[None] | None = None
        self._numbers = itertools.count(1)
        self._waiting: dict[int, asyncio.Future[OrderReply]] = {}
        self._process: asyncio.subprocess.Process | None = None
        self.session: SessionDocument | None = None
        self._live: tuple[float, LiveDocument] | None = None

    def start_process(self) -> asyncio.Task[None]:
        """Begin to run the cell process; it ends when the task is cancelled."""
        return start_task(TASK, self._run_once)

    @property
    def live_values(self) -> LiveDocument | None:
        """The newest live values, None where none came just now: a process that hangs must not look alive."""
        if self._live is None:
            return None
        received_s, content = self._live
        return content if time.monotonic() - received_s < _JUST_NOW_S else None

    async def send_order(self, command: CommandDocument) -> OrderReply:
        """Send a command and return the cell process's reply; CellProcessGoneError where there is none."""
        if command["order"]["op"] == "stop":
            return await self._stop(command)
        if command["order"]["op"] in ("start", "resume"):
            self._broken_off = False
        return await self._request_reply({"command": command})

    async def _stop(self, command: CommandDocument) -> OrderReply:
        """Send a stop; without an answer say so, and make sure that no later process continues the run by itself."""
        try:
            return await self._request_reply({"command": command}, is_stop=True)
        except CellProcessGoneError as error:
            self._break_off()
            raise StopUnconfirmedError from error

    def _break_off(self) -> None:
        """Let the run under way wait for a person: in the next cell process, and in the next service."""
        self._broken_off = True
        self._noting = asyncio.create_task(self._note_broken_off(), name=_NOTE)

    async def _note_broken_off(self) -> None:
        with log_failures(_NOTE):
            await asyncio.to_thread(self._clear_run_under_way)

    def _clear_run_under_way(self) -> None:
        RunInProgress(read_cell_file(self._cell_file).cell.data_dir).clear_run()

    async def _request_reply(self, message: Mapping[str, object], *, is_stop: bool = False) -> OrderReply:
        number, answer = self._send(message)
        try:
            return await self._answer_to(answer, is_stop=is_stop)
        finally:
            self._waiting.pop(number, None)

    def _send(self, message: Mapping[str, object]) -> tuple[int, asyncio.Future[OrderReply]]:
        """Write a message; what the pipe does not take yet waits in our own memory, as long as the process runs."""
        process = self._process
        if process is None or process.returncode is not None or process.stdin is None:
            raise CellProcessGoneError
        number = next(self._numbers)
        try:
            line = orjson.dumps({"number": number, **message}) + b"\n"
        except TypeError as error:
            raise InvalidOrderError(str(error)) from error
        if len(line) > LONGEST_LINE:
            raise InvalidOrderError(
                make_message("it is longer than {longest_line} bytes", longest_line=LONGEST_LINE)
            )
        if "ask" not in message and process.stdin.transport.get_write_buffer_size() > _MOST_UNREAD:
            raise CellProcessSilentError
        answer: asyncio.Future[OrderReply] = asyncio.get_running_loop().create_future()
        self._waiting[number] = answer
        process.stdin.write(line)
        return number, answer

    async def _answer_to(self, answer: asyncio.Future[OrderReply], *, is_stop: bool) -> OrderReply:
        """Wait for an answer; for that to a stop only shortly where the process sends nothing at all meanwhile."""
        lines_before = self._lines_received
        first_s = STOP_ANSWER_S if is_stop else ANSWER_S
        await asyncio.wait({answer}, timeout=first_s)
        if not answer.done() and self._lines_received > lines_before:
            await asyncio.wait({answer}, timeout=ANSWER_S - first_s)
        if not answer.done():
            raise CellProcessSilentError
        return answer.result()

    async def _begin_process(self) -> asyncio.subprocess.Process:
        while True:
            self._begun_broken_off = self._broken_off
            process = await asyncio.create_subprocess_exec(
                sys.executable, "-m", "cellcal.service.cell_process", str(self._cell_file),
                *[BROKEN_OFF] * self._begun_broken_off,
                stdin=asyncio.subprocess.PIPE, stdout=asyncio.subprocess.PIPE, stderr=asyncio.subprocess.PIPE,
                start_new_session=True,  # Ctrl-C is for the service, which lets it leave
                env={**os.environ, "OPENBLAS_NUM_THREADS": "1"},
            )  # fmt: skip
            if self._begun_broken_off == self._broken_off:
                return process
            await end_child(process)  # a stop came meanwhile, and this one would go on with the run

    async def _run_once(self) -> None:
        self._process = process = await self._begin_process()
        assert process.stdout is not None
        assert process.stderr is not None
        words = StderrTail()
        self._unanswered = UnansweredTime(self._hangs_after_s)
        try:
            async with asyncio.TaskGroup() as streams:
                streams.create_task(words.pass_on(process.stderr))
                watching = streams.create_task(self._end_if_it_hangs(process))
                await self._read_messages(process.stdout)
                watching.cancel()
                await self._stop_process()
        except ExceptionGroup as group:
            raise group.exceptions[0] from None
        finally:
            await self._stop_process()
            self._drop_session()
        raise ChildEndedError("the cell's process", process.returncode or 0, words.last_line())

    async def _end_if_it_hangs(self, process: asyncio.subprocess.Process) -> None:
        """Ask all the time whether the process's event loop runs; kill one that could have answered and did not.

        Raises
        ------
        CellHangsError
            It was killed.
        """
        while process.returncode is None:
            number, answer = self._send({"ask": ALIVE})
            try:
                await self._wait_for_life(process, answer)
            finally:
                self._waiting.pop(number, None)
            await asyncio.sleep(TICK_S)

    async def _wait_for_life(
        self, process: asyncio.subprocess.Process, answer: asyncio.Future[OrderReply]
    ) -> None:
        while not answer.done() and process.returncode is None:
            await asyncio.wait({answer}, timeout=TICK_S)
            if not answer.done():
                self._unanswered.count(read_process_state(process.pid))
            if self._unanswered.hangs:
                self._break_off()
                with contextlib.suppress(ProcessLookupError):
                    process.kill()
                raise CellHangsError(self._unanswered.does)

    async def _read_messages(self, stream: asyncio.StreamReader) -> None:
        with contextlib.suppress(ConnectionError):
            async for line in whole_lines(stream, _name_long_line):
                self._lines_received += 1
                self._unanswered.note_message()
                with log_failures(_LINES):
                    message = parse_json(line)
                    remember_table(message)
                    self._handle_message(message)

    def _drop_session(self) -> None:
        """Tell all screens that the cell process ended."""
        self._process = self.session = self._live = None
        for answer in self._waiting.values():
            if not answer.done():
                answer.set_exception(CellProcessGoneError())
        self._on_event("gone", {})

    def _handle_message(self, message: Mapping[str, Any]) -> None:
        if "told" in message:
            if message["told"] == "session":
                self.session = message["content"]
                if self._begun_broken_off:  # this process has the order
                    self._broken_off = self._begun_broken_off = False
            elif message["told"] == "live":
                self._live = (time.monotonic(), message["content"])
            self._on_event(message["told"], message["content"])
            return
        answer = self._waiting.get(message["number"] or 0)
        if answer is not None and not answer.done():
            answer.set_result(message["reply"])

    async def _stop_process(self) -> None:
        if self._process is not None and await end_child(self._process):
            self._break_off()
        if self._noting is not None:
            await asyncio.wait({self._noting}, timeout=_NOTED_S)


def _name_long_line() -> None:
    SUPERVISOR.note_failure(_LINES, LineTooLongError("what the cell's process says"), running=True)
