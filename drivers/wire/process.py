"""A child process for a vendor library that can hang, crash, or hold the interpreter.

Length-prefixed JSON over a socket pair; every call has a deadline. A child that misses one is killed: its
library may hold a lock for ever, and nothing inside the process could end it. What happened becomes a
DeviceError that names the device; starting a new child is the driver's decision, because it may touch the
device.
"""

import asyncio
import contextlib
import itertools
import logging
import os
import socket
import sys
from functools import partial
from pathlib import Path
from typing import Any, Self

from cellcal.calibration.documents.json_text import parse_json
from cellcal.calibration.message import make_message
from cellcal.drivers.errors import DeviceTimeoutError, RefusedError, UnreachableError, WireProtocolError
from cellcal.drivers.supervision import start_link_task
from cellcal.drivers.wire.child import HEADER, LONGEST_FRAME, pack_message
from cellcal.drivers.wire.process_exit import describe_exit

_log = logging.getLogger(__name__)

# Where `cellcal` is imported from: the child must find the same packages, wherever we run.
_ROOT = str(Path(__file__).absolute().parents[3])
_KEPT_BYTES = 4096
_LEAVE_S = 0.5
_COLLECT_S = 5.0


class ChildProcess:
    """One running child. Not restarted in place: a dead one is replaced by a new object.

    ``module`` is run as ``python -m module``; it calls cellcal.drivers.wire.child.serve with its handlers.
    ``title`` names its job in a sentence: "the process that talks to the controller".
    """

    def __init__(self, device: str, module: str, *, title: str) -> None:
        self.device, self._module, self._title = device, module, title
        self._numbers = itertools.count()
        self._waiting: dict[int, asyncio.Future[Any]] = {}
        self._printed = b""
        self._process: asyncio.subprocess.Process | None = None
        self._writer: asyncio.StreamWriter | None = None
        self._tasks: tuple[asyncio.Task[None], ...] = ()
        self._reason = ""  # why we killed it, if we did

    @classmethod
    async def start(cls, device: str, module: str, *, title: str, start_s: float) -> Self:
        """Start the child and wait until it answers; raise DeviceTimeoutError or UnreachableError."""
        child = cls(device, module, title=title)
        try:
            await child._spawn_child()
            await child.call_verb("ping", deadline_s=start_s)
        except BaseException:
            await child.close()
            raise
        return child

    @property
    def is_alive(self) -> bool:
        """Whether calls can still be answered."""
        return self._process is not None and self._process.returncode is None and not self._reason

    @property
    def pid(self) -> int:
        """Return the process id, for logs."""
        return self._process.pid if self._process is not None else 0

    async def call_verb(self, verb: str, *, deadline_s: float, **arguments: Any) -> Any:
        """Let the child do ``verb``; raise if it says no, ends, or misses the deadline (which kills it)."""
        if self._writer is None or not self.is_alive:
            raise self.ended_error()
        number = next(self._numbers)
        answer: asyncio.Future[Any] = asyncio.get_running_loop().create_future()
        self._waiting[number] = answer
        request = {"number": number, "verb": verb, "deadline_s": deadline_s, "arguments": arguments}
        try:
            self._writer.write(pack_message(request))
            async with asyncio.timeout(deadline_s):
                return await answer
        except TimeoutError:
            self.kill(
                make_message(
                    "it did not answer '{verb}' within {deadline_s:g} s", verb=verb, deadline_s=deadline_s
                )
            )
            raise self._late_error() from None
        finally:
            self._waiting.pop(number, None)

    def kill(self, reason: str) -> None:
        """End the child at once; every call under way raises."""
        if self._reason or self._process is None or self._process.returncode is not None:
            return
        self._reason = reason
        with contextlib.suppress(ProcessLookupError):
            self._process.kill()
        _log.warning("%s: ended %s (%d): %s", self.device, self._title, self.pid, reason)

    async def close(self) -> None:
        """Let the child leave; end it if it does not."""
        if self._writer is not None:
            self._writer.close()
        process = self._process
        if process is None:
            return
        try:
            async with asyncio.timeout(_LEAVE_S):
                await process.wait()
        except TimeoutError:
            self.kill("it did not leave when asked")
        finally:
            with contextlib.suppress(ProcessLookupError):
                process.kill()
        with contextlib.suppress(TimeoutError):  # a killed process that cannot end is the kernel's matter
            async with asyncio.timeout(_COLLECT_S):
                await asyncio.gather(process.wait(), *self._tasks, return_exceptions=True)

    async def _spawn_child(self) -> None:
        ours, child_socket = socket.socketpair()
        with child_socket:
            path = os.pathsep.join(p for p in (_ROOT, os.environ.get("PYTHONPATH", "")) if p)
            try:
                self._process = await asyncio.create_subprocess_exec(
                    sys.executable, "-m", self._module, str(child_socket.fileno()),
                    pass_fds=(child_socket.fileno(),), start_new_session=True,  # Ctrl-C is for the parent
                    stdin=asyncio.subprocess.DEVNULL,
                    stdout=asyncio.subprocess.PIPE, stderr=asyncio.subprocess.STDOUT,
                    env={**os.environ, "PYTHONPATH": path},
                )  # fmt: skip
            except OSError as error:
                ours.close()
                raise UnreachableError(
                    self.device,
                    make_message("{title} could not be started: {error}.", title=self._title, error=error),
                ) from error
            except BaseException:
                ours.close()
                raise
        reader, self._writer = await asyncio.open_connection(sock=ours)
        self._tasks = (
            start_link_task(
                make_message("answers of {device}", device=self.device),
                partial(self._read_answers, reader),
                self._end_broken,
            ),
            start_link_task(
                make_message("prints of {device}", device=self.device), self._collect_output, self._end_broken
            ),
        )

    async def _read_answers(self, reader: asyncio.StreamReader) -> None:
        assert self._process is not None
        error: Exception | None = None
        try:
            while True:
                (size,) = HEADER.unpack(await reader.readexactly(HEADER.size))
                if size > LONGEST_FRAME:
                    raise ValueError(make_message("a frame of {size} bytes", size=size))
                self._settle_call(parse_json(await reader.readexactly(size)))
        except (asyncio.IncompleteReadError, ConnectionError):
            pass  # it ended; the exit code says how
        except (ValueError, KeyError, TypeError) as fault:
            error = WireProtocolError(
                self.device,
                make_message("{title} sent what it must not: {fault}.", title=self._title, fault=fault),
            )
            self.kill(str(fault))
        await self._finish_process(error)

    def _end_broken(self, error: Exception) -> None:
        """End the child whose answers are not heard any more; callers are told, the next one starts another."""
        self.kill(
            make_message(
                "the program failed ({error_type}: {error})", error_type=type(error).__name__, error=error
            )
        )
        for answer in self._waiting.values():
            if not answer.done():
                answer.set_exception(self.ended_error())

    async def _finish_process(self, error: Exception | None) -> None:
        assert self._process is not None
        try:
            async with asyncio.timeout(_LEAVE_S):
                await self._process.wait()
        except TimeoutError:
            self.kill("it closed its channel")
            await self._process.wait()
        await asyncio.wait(self._tasks[1:], timeout=_LEAVE_S)  # its last words are still in the pipe
        if self._writer is not None:
            self._writer.close()
        for answer in self._waiting.values():
            if not answer.done():
                answer.set_exception(error or self.ended_error())

    def _settle_call(self, message: dict[str, Any]) -> None:
        answer = self._waiting.get(message["number"])
        if answer is None or answer.done():
            return  # the caller was cancelled
        if "refused" in message:
            text = str(message["refused"])
            answer.set_exception(
                RefusedError(self.device, make_message("{text}.", text=text.rstrip(". ")), vendor_text=text)
            )
        else:
            answer.set_result(message["value"])

    async def _collect_output(self) -> None:
        """Keep what the library printed last: it is all that is left after a crash."""
        assert self._process is not None
        assert self._process.stdout is not None
        while chunk := await self._process.stdout.read(_KEPT_BYTES):
            self._printed = (self._printed + chunk)[-_KEPT_BYTES:]
            _log.debug("%s: child: %s", self.device, chunk.decode(errors="replace").rstrip())

    def _late_error(self) -> DeviceTimeoutError:
        return DeviceTimeoutError(
            self.device,
            make_message("{title} hung: {reason}. It was ended.", title=self._title, reason=self._reason),
            remedy="Check the network cable and the controller, then try again: a new process is started.",
        )

    def ended_error(self) -> UnreachableError:
        """Return how the child ended, as an error to raise."""
        lines = self._printed.decode(errors="replace").split("\n")
        words = next((line.strip() for line in reversed(lines) if line.strip()), "")
        last_lines = make_message(' Its last words: "{words}".', words=words) if words else ""
        return UnreachableError(
            self.device,
            make_message(
                "{title} ended: {reason}.{last_lines}",
                title=self._title,
                reason=self._reason or self._exit_text(),
                last_lines=last_lines,
            ),
            remedy="Try again: a new process is started. If it happens again, report it with the log.",
        )

    def _exit_text(self) -> str:
        code = self._process.returncode if self._process is not None else None
        return "it was not started" if code is None else describe_exit(code)
