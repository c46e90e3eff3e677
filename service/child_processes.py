"""Child processes of the service: how one ended, and what it said last."""

import asyncio
import contextlib
import signal
import sys

from cellcal.calibration.errors import CellError
from cellcal.calibration.message import make_message
from cellcal.drivers.wire.process_exit import describe_exit

_KEPT_BYTES = 4096
_CHUNK = 4096
_LEAVE_S = 5.0


class ChildEndedError(CellError):
    """A process that is to run as long as the service has ended."""

    code = "process.ended"

    def __init__(self, title: str, code: int, words: str) -> None:
        reason = describe_exit(code)
        was_killed = -code in (signal.SIGKILL, signal.SIGTERM)  # by another: what it said before is no reason
        last_lines = (
            make_message(' Its last words: "{words}".', words=words) if words and not was_killed else ""
        )
        super().__init__(
            make_message(
                "{title} ended: {reason}.{last_lines}", title=title, reason=reason, last_lines=last_lines
            ),
            remedy="It is started again by itself. If this stays, look into the log of the service.",
        )


class StderrTail:
    """The errors that a process prints: passed on to our own, and the end of it stored."""

    def __init__(self) -> None:
        self._tail = b""

    async def pass_on(self, stream: asyncio.StreamReader) -> None:
        """Pass on until the stream ends."""
        while chunk := await stream.read(_CHUNK):
            self._tail = (self._tail + chunk)[-_KEPT_BYTES:]
            sys.stderr.write(chunk.decode(errors="replace"))
            sys.stderr.flush()

    def last_line(self) -> str:
        """Return the last line that says anything."""
        lines = self._tail.decode(errors="replace").split("\n")
        return next((line.strip()[:300] for line in reversed(lines) if line.strip()), "")


async def end_child(process: asyncio.subprocess.Process) -> bool:
    """Close a child's standard input, at which it ends by itself; kill one that does not, and return True.

    One that waits for a disk for ever cannot even be killed: it is left running, and the caller continues.
    """
    if process.returncode is not None:
        return False
    if process.stdin is not None:
        process.stdin.close()
    try:
        async with asyncio.timeout(_LEAVE_S):
            await process.wait()
        return False
    except TimeoutError:
        process.kill()
        with contextlib.suppress(TimeoutError):
            async with asyncio.timeout(_LEAVE_S):
                await process.wait()
        return True
