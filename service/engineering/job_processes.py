"""The process of a job that a page has begun: how the service runs it, and how it ends with the service.

The process writes one JSON object a line on its output. Its input is open for as long as the service runs.
"""

import asyncio
import contextlib
import json
import logging
import os
import sys
from collections.abc import Callable, Sequence
from typing import Any

from cellcal.calibration.documents.json_text import parse_json
from cellcal.calibration.errors import CellError
from cellcal.calibration.message_table import with_messages
from cellcal.service.engineering.job_limits import JobLimits

_LONGEST_LINE = 1 << 20
_LEAVE_S = 5.0
_BROKEN = {"message": "The computation failed; the service's log has the cause.", "remedy": ""}


async def run_job_process(
    module: str, arguments: Sequence[str], on_message: Callable[[dict[str, Any]], None]
) -> int:
    """Run a module as a process, pass on each of its messages, and return its exit code.

    The process is killed when the caller is cancelled.

    Raises
    ------
    OSError
        It could not be started.
    """
    process = await asyncio.create_subprocess_exec(
        sys.executable, "-m", module, *arguments,
        stdin=asyncio.subprocess.PIPE, stdout=asyncio.subprocess.PIPE,
        limit=_LONGEST_LINE, start_new_session=True,  # Ctrl-C is for the service
        env={**os.environ, "OPENBLAS_NUM_THREADS": "1"},
    )  # fmt: skip
    assert process.stdout is not None
    try:
        while line := await process.stdout.readline():
            on_message(parse_json(line))
        with contextlib.suppress(TimeoutError):
            async with asyncio.timeout(_LEAVE_S):  # how it ended by itself must not be taken for our own kill
                await process.wait()
    finally:
        with contextlib.suppress(ProcessLookupError):
            process.kill()
        await process.wait()
    return process.returncode or 0


def write_message(**words: Any) -> None:
    """Write one line to the service."""
    sys.stdout.write(json.dumps(with_messages(words)) + "\n")
    sys.stdout.flush()


def finish_job(work: Callable[[], None], limits: JobLimits, log: logging.Logger, name: str) -> None:
    """Do the work of a job, and write to the service how it ended."""
    try:
        work()
    except CellError as error:
        write_message(end="failed", message=error.message, remedy=error.remedy)
    except MemoryError:
        write_message(end="failed", message=limits.too_large, remedy=limits.remedy)
    except Exception:
        log.exception("%s broke", name)
        write_message(end="failed", **_BROKEN)
    else:
        write_message(end="done")


def leave_with_the_service() -> None:
    """End this process when the service ends, however that ends."""
    while os.read(0, 4096):  # past Python's own buffer, which must be free when the interpreter ends
        pass
    os._exit(1)
