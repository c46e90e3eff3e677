"""What the shell gets to know. The list is part of the product's promise: scripts depend on it."""

import errno
from collections.abc import Iterable
from enum import IntEnum

from cellcal.calibration.errors import CalibrationError, CellError


class ExitCode(IntEnum):
    """Exit codes of every command."""

    PASS = 0
    USAGE = 2
    OUT_OF_TOLERANCE = 3
    REFUSED = 4  # a gate said no: geometry, stale data, wrong context
    UNREACHABLE = 5
    STOPPED = 6  # emergency stop or another safety stop
    CANCELLED = 7
    SIGNATURE = 8
    BUSY = 9
    INTERNAL = 70  # a fault of ours: the report file has the trace
    NO_READER = 141  # `| head` closed our output: what was found did not get out whole (128 + SIGPIPE)
    FILES_REFUSED = 10  # some of the files that were named could not be used; the others were


# An error's code is a path, "device.stopped": the longest beginning of it that stands here decides.
_BY_CODE = {
    "config": ExitCode.USAGE,
    "usage": ExitCode.USAGE,
    "measurements": ExitCode.USAGE,
    "missing_extra": ExitCode.USAGE,
    "bench": ExitCode.USAGE,
    "people": ExitCode.REFUSED,
    "busy": ExitCode.BUSY,
    "fake": ExitCode.UNREACHABLE,
    "calibration": ExitCode.REFUSED,
    "parameters": ExitCode.REFUSED,
    "program": ExitCode.FILES_REFUSED,
    "procedure": ExitCode.REFUSED,
    "procedure.out_of_tolerance": ExitCode.OUT_OF_TOLERANCE,
    "procedure.declined": ExitCode.CANCELLED,
    "procedure.unknown": ExitCode.USAGE,
    "device": ExitCode.UNREACHABLE,
    "device.stopped": ExitCode.STOPPED,
    "device.busy": ExitCode.BUSY,
    "device.nobody": ExitCode.CANCELLED,  # a question met a closed input
    "store": ExitCode.REFUSED,  # a full disk, a torn-off network drive: nothing is begun that cannot be kept
    "store.damaged": ExitCode.SIGNATURE,
    "signature": ExitCode.SIGNATURE,
    "certificate": ExitCode.REFUSED,
    "delivery": ExitCode.REFUSED,
    "site": ExitCode.REFUSED,
    "store.busy": ExitCode.BUSY,
    "store.conflict": ExitCode.BUSY,
    "store.no_such_run": ExitCode.USAGE,
    "store.no_such_step": ExitCode.USAGE,
    "store.finished": ExitCode.USAGE,
    "store.not_a_fact": ExitCode.INTERNAL,
}

_LACKS = (errno.ENOSPC, errno.EDQUOT, errno.EMFILE, errno.ENFILE)  # room on a disk, or descriptors


def exit_code_of(error: BaseException) -> ExitCode:
    """Return the exit code that belongs to an error."""
    import asyncio  # noqa: PLC0415 - a command that ends well may not need it

    if isinstance(error, KeyboardInterrupt | asyncio.CancelledError):
        return ExitCode.CANCELLED
    if isinstance(error, CalibrationError) and error.code not in _BY_CODE:
        return ExitCode.REFUSED
    if isinstance(error, CellError):
        return exit_code_named(error.code)
    if isinstance(error, OSError) and error.errno in _LACKS:
        return ExitCode.REFUSED  # as the store's own refusal of a full disk
    if isinstance(error, OSError) and (error.filename is not None or error.errno == errno.EROFS):
        return ExitCode.USAGE  # a file or folder that was named cannot be used
    return ExitCode.INTERNAL


def exit_code_of_word(word: str | None) -> ExitCode:
    """Return the exit code of a finished run's verdict; where a procedure states none, its end is the verdict."""
    by_word = {"fail": ExitCode.OUT_OF_TOLERANCE, "undecided": ExitCode.REFUSED}
    return by_word.get(word or "", ExitCode.PASS)


_GRAVITY = (ExitCode.OUT_OF_TOLERANCE, ExitCode.UNREACHABLE, ExitCode.REFUSED, ExitCode.PASS)


def gravest_exit_code(codes: Iterable[ExitCode]) -> ExitCode:
    """Return the exit code of a look at many robots: a change or loss first, then a robot that was not read."""
    found = set(codes)
    return next((code for code in _GRAVITY if code in found), ExitCode.PASS)


def exit_code_named(code: str) -> ExitCode:
    """Return the exit code that belongs to the code of an error, as a run's end is journalled with it."""
    while code:
        if code in _BY_CODE:
            return _BY_CODE[code]
        code = code.rpartition(".")[0]
    return ExitCode.INTERNAL
