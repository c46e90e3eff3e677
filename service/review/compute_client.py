"""A process of its own for what takes computing: the web's loop stays free for screens and for held buttons.

It is started with the first question, answers one after the other, and ends when the service does, however that ends:
its input closes.
"""

import asyncio
import contextlib
import os
import sys
from pathlib import Path
from typing import Any

import orjson

from cellcal.calibration.documents.json_text import parse_json
from cellcal.calibration.errors import CellError
from cellcal.calibration.message import make_message
from cellcal.calibration.message_table import remember_table
from cellcal.drivers.supervision import SUPERVISOR

LONGEST_LINE = 16 * 1024 * 1024
ANSWER_S = 30.0
TASK = "process that computes"
_MOST_WAITING = 8
_LEAVE_S = 3.0
_LATE_S = 0.5  # to finish an answer without a receiver: starting the process again takes longer
_REVIEWS = "cellcal.service.review.compute_worker"


class ComputeError(CellError):
    """The computation failed; the remedy says whether it is worth asking again."""

    code = "solver"


class ComputeBusyError(ComputeError):
    """Too much is being computed, or it took too long."""

    code = "solver.busy"

    def __init__(self) -> None:
        super().__init__("the service is computing other things just now.", remedy="Ask again in a moment.")


class SolverEndedError(ComputeError):
    """The process that computes ended before it had an answer."""

    def __init__(self, code: int) -> None:
        how = f"signal {-code}" if code < 0 else make_message("exit code {code}", code=code)
        super().__init__(
            make_message("the process that computes has ended ({how}) before it had an answer.", how=how),
            remedy="Ask again: another one is started. If this stays, look into the service's log.",
        )


class ComputeClient:
    """Keeps the process for one cell file."""

    def __init__(self, cell_file: Path, module: str = _REVIEWS, *, longest_s: float = ANSWER_S) -> None:
        self._cell_file, self._module, self._longest_s = cell_file, module, longest_s
        self._turn = asyncio.Lock()
        self._waiting = 0
        self._process: asyncio.subprocess.Process | None = None

    async def ask_worker(self, question: str, **arguments: Any) -> Any:
        """Return the answer to one of the questions of the process; a caller who is cancelled ends its work.

        Raises
        ------
        SolverBusyError
            Too many others wait, or there was no answer in time.
        SolverError
            The question has no answer; the message says why.
        """
        if self._waiting >= _MOST_WAITING:
            raise ComputeBusyError
        self._waiting += 1
        try:
            async with self._turn:
                reply = await self._exchange_line(
                    orjson.dumps({"question": question, "given": arguments}) + b"\n"
                )
        finally:
            self._waiting -= 1
        remember_table(reply)
        if reply["ok"]:
            return reply["answer"]
        raise ComputeError(reply["message"], remedy=reply["remedy"], code=reply["code"])

    async def _exchange_line(self, line: bytes) -> dict[str, Any]:
        process = await self._start_worker()
        assert process.stdin is not None
        assert process.stdout is not None
        answered = False
        try:
            async with asyncio.timeout(self._longest_s):
                process.stdin.write(line)
                await process.stdin.drain()
                reply_line = await process.stdout.readline()
            answered = bool(reply_line)
        except TimeoutError:
            raise ComputeBusyError from None
        except ConnectionError:  # it has ended
            reply_line = b""
        except asyncio.CancelledError:
            with contextlib.suppress(TimeoutError, ConnectionError):
                async with asyncio.timeout(_LATE_S):
                    answered = bool(await process.stdout.readline())
            raise
        finally:
            if not answered:  # an abandoned answer must not be taken for that of the next question
                await self.stop_worker()
        if not reply_line:
            ended = SolverEndedError(process.returncode or 0)
            SUPERVISOR.note_failure(TASK, ended, running=True)  # the next question starts another one
            raise ended
        found: dict[str, Any] = parse_json(reply_line)
        return found

    async def _start_worker(self) -> asyncio.subprocess.Process:
        if self._process is None or self._process.returncode is not None:
            self._process = await asyncio.create_subprocess_exec(
                sys.executable, "-m", self._module, str(self._cell_file),
                stdin=asyncio.subprocess.PIPE, stdout=asyncio.subprocess.PIPE,
                limit=LONGEST_LINE, start_new_session=True,  # Ctrl-C is for the service
                env={**os.environ, "OPENBLAS_NUM_THREADS": "1"},
            )  # fmt: skip
        return self._process

    async def stop_worker(self) -> None:
        """End the process; the next question starts another."""
        process, self._process = self._process, None
        if process is None or process.returncode is not None:
            return
        if process.stdin is not None:
            process.stdin.close()
        if process.stdout is None or not process.stdout.at_eof():  # one that ended by itself tells how
            with contextlib.suppress(ProcessLookupError):
                process.kill()
        with contextlib.suppress(TimeoutError):
            async with asyncio.timeout(_LEAVE_S):
                await process.wait()
