"""Errors that no code foresaw, and those of the operating system: one sentence for a person, never a trace.

The trace goes to a report file for its owner only, which can be sent to those who mend the program.
"""

import errno
import hashlib
import logging
import os
import sys
import tempfile
import traceback
from collections.abc import Callable
from pathlib import Path

from cellcal.calibration.errors import CellError
from cellcal.calibration.message import make_message
from cellcal.service.exit_codes import ExitCode

_OURS = ("cellcal", "__main__")
_LONGEST = 200  # characters of an unexpected error in a sentence
_OF_THE_SYSTEM = (errno.ENOSPC, errno.EDQUOT, errno.EROFS, errno.EIO, errno.EMFILE, errno.ENFILE)
_CURES = {
    errno.EROFS: (
        "its disk is read-only",
        "Name a place on a disk that may be written, or mount this one so.",
    ),
    errno.EIO: (
        "the disk fails to read or write it (an input or output error)",
        "Copy the file to another disk and try again; have this one checked.",
    ),
    errno.ENOSPC: ("the disk is full", "Make room on the disk and try again."),
    errno.EDQUOT: ("the quota of disk space is used up", "Make room and try again."),
    errno.EACCES: ("permission was denied", "Log in as a user who may use it, or let its owner permit it."),
    errno.EPERM: ("the operation is not permitted", "Log in as a user who may use it."),
    errno.ENOENT: ("there is no such file or folder", "Correct the path."),
    errno.EISDIR: ("it is a folder", "Name a file in it."),
    errno.ENOTDIR: ("a part of the path is a file, not a folder", "Correct the path."),
    errno.EEXIST: ("it is there already", "Give another name, or move it away."),
    errno.ENAMETOOLONG: ("the name is too long", "Give a shorter name."),
    errno.EMFILE: ("this process has no file descriptors left", "End other connections, or raise its limit."),
    errno.ENFILE: ("this computer has no file descriptors left", "End other programs, or raise its limit."),
    errno.ELOOP: ("its links lead in a circle", "Correct the links."),
}


def explain_os_error(error: OSError) -> tuple[str, str]:
    """Return what the operating system refused, and the cure."""
    cause, cure = _CURES.get(
        error.errno or 0,
        (error.strerror or str(error), "Give a path that exists and may be read and written."),
    )
    where = "" if error.filename is None else f"{os.fsdecode(_file_name(error.filename))}: "
    return make_message("{where}{cause}.", where=where, cause=cause), cure


def is_about_the_system(error: BaseException) -> bool:
    """Return whether an error is of a file or disk, and no fault of the program."""
    return lacks_resources(error) or (isinstance(error, OSError) and error.filename is not None)


def lacks_resources(error: BaseException) -> bool:
    """Return whether a disk or the system itself refused something, whatever was to be done."""
    return isinstance(error, OSError) and error.errno in _OF_THE_SYSTEM


def describe_unexpected(error: BaseException) -> tuple[str, str]:
    """Write a report of an error that nothing foresaw; return a sentence about it, and what to do."""
    words = " ".join(str(error).split())[:_LONGEST]
    words = words.encode("utf-8", errors="backslashreplace").decode()
    path = write_report(error)
    where = (
        "No report could be written." if path is None else make_message("The report is in {path}.", path=path)
    )
    name = type(error).__name__
    return (
        make_message(
            "Internal error: {error}. {where}", error=f"{name}: {words}" if words else name, where=where
        ),
        "This is a fault of cellcal: please send the report and what you did. Nothing that was stored is lost.",
    )


def write_report(error: BaseException) -> Path | None:
    """Write the trace of an error to a new file in the folder for temporary files; None where that fails."""
    try:
        from importlib.metadata import version  # noqa: PLC0415 - a command that ends well does not need it

        trace = "".join(traceback.format_exception(error))
        descriptor, name = tempfile.mkstemp(prefix="cellcal-report-", suffix=".txt")  # mode 0600
        with os.fdopen(descriptor, "w", encoding="utf-8", errors="backslashreplace") as file:
            file.write(f"cellcal {version('cellcal')}, Python {sys.version}\n{trace}")
    except (OSError, RecursionError, MemoryError):
        return None
    return Path(name)


class OneLineFormatter(logging.Formatter):
    """Log records of one line each: a trace goes to a report, which the line names."""

    def __init__(self, form: str) -> None:
        super().__init__(form)
        self._reports: dict[str, str] = {}

    def format(self, record: logging.LogRecord) -> str:
        """Return the line of a record."""
        plain = logging.makeLogRecord(
            {**record.__dict__, "exc_info": None, "exc_text": None, "stack_info": None}
        )
        line = " ".join(super().format(plain).split())
        error = record.exc_info[1] if record.exc_info else None
        return (
            line if error is None else f"{line} [{type(error).__name__}: {error}; {self._report_of(error)}]"
        )

    def _report_of(self, error: BaseException) -> str:
        """Return where the trace is; the same one is written once a process."""
        trace = hashlib.sha256("".join(traceback.format_tb(error.__traceback__)).encode()).hexdigest()
        if trace not in self._reports:
            path = write_report(error)
            self._reports[trace] = "no report could be written" if path is None else f"report in {path}"
        return self._reports[trace]


def _is_ours_or_serious(record: logging.LogRecord) -> bool:
    """Drivers turn what libraries tell into errors of ours; what ends a task or the server is let through."""
    package = record.name.partition(".")[0]
    return package in _OURS or (package in ("asyncio", "uvicorn") and record.levelno >= logging.ERROR)


def log_in_lines(form: str = "%(levelname)s: %(message)s") -> None:
    """Send our own warnings to standard error in one line each, and what libraries log nowhere."""
    root = logging.getLogger()
    if not root.handlers:
        handler = logging.StreamHandler(sys.stderr)
        handler.setFormatter(OneLineFormatter(form))
        handler.addFilter(_is_ours_or_serious)
        root.addHandler(handler)
        root.setLevel(logging.WARNING)
    logging.captureWarnings(True)
    sys.unraisablehook = _log_unraisable


def _log_unraisable(lost: "sys.UnraisableHookArgs") -> None:
    """Log an error that nothing can catch, as of an object that is taken down; Python would print its trace."""
    logging.getLogger("cellcal").warning("an object could not be taken down: %s", lost.exc_value)


def run_guarded(main: Callable[[], int | None]) -> int:
    """Run a process's main function; what nothing foresaw becomes a sentence on standard error and exit code 70."""
    try:
        return main() or 0
    except KeyboardInterrupt:
        return ExitCode.CANCELLED
    except CellError as error:
        message, remedy, code = error.message, error.remedy, ExitCode.USAGE
    except Exception as error:  # noqa: BLE001  the last line of defence
        if isinstance(error, OSError) and is_about_the_system(error):
            (message, remedy), code = explain_os_error(error), ExitCode.USAGE
        else:
            (message, remedy), code = describe_unexpected(error), ExitCode.INTERNAL
    sys.stderr.write(f"{message} {remedy.strip()}\n".encode(errors="backslashreplace").decode())
    return code


def _file_name(filename: object) -> str | bytes:
    return filename if isinstance(filename, str | bytes) else str(filename)
