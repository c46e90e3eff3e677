"""What the shell gets to know. The list is part of the product's promise: scripts depend on it."""

import asyncio
from enum import IntEnum

from calibration.errors import CalibrationError, CellError
from drivers.errors import BusyError, DeviceError, MotionStoppedError


class ExitCode(IntEnum):
    """Exit codes of every command."""

    PASS = 0
    INTERNAL = 1
    USAGE = 2
    OUT_OF_TOLERANCE = 3
    REFUSED = 4  # a gate said no: geometry, stale data, wrong context
    UNREACHABLE = 5
    STOPPED = 6  # emergency stop or another safety stop
    CANCELLED = 7
    SIGNATURE = 8
    BUSY = 9


_BY_CODE = {
    "config": ExitCode.USAGE,
    "usage": ExitCode.USAGE,
    "measurements": ExitCode.USAGE,
    "busy": ExitCode.BUSY,
    "procedure.out_of_tolerance": ExitCode.OUT_OF_TOLERANCE,
    "procedure.declined": ExitCode.CANCELLED,
}


def exit_code_of(error: BaseException) -> ExitCode:
    """Return the exit code that belongs to an error."""
    if isinstance(error, (KeyboardInterrupt, asyncio.CancelledError)):
        return ExitCode.CANCELLED
    if isinstance(error, MotionStoppedError):
        return ExitCode.STOPPED
    if isinstance(error, BusyError):
        return ExitCode.BUSY
    if isinstance(error, DeviceError):
        return ExitCode.UNREACHABLE
    if isinstance(error, CellError):
        by_code = _BY_CODE.get(error.code)
        if by_code is not None:
            return by_code
        return (
            ExitCode.REFUSED
            if isinstance(error, CalibrationError) or error.code.startswith("procedure")
            else ExitCode.INTERNAL
        )
    return ExitCode.INTERNAL
