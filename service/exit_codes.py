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


# The first row that fits decides: the narrow scenarios stand above the wide ones.
_BY_TYPE: tuple[tuple[type[BaseException], ExitCode], ...] = (
    (KeyboardInterrupt, ExitCode.CANCELLED),
    (asyncio.CancelledError, ExitCode.CANCELLED),
    (MotionStoppedError, ExitCode.STOPPED),
    (BusyError, ExitCode.BUSY),
    (DeviceError, ExitCode.UNREACHABLE),
    (CalibrationError, ExitCode.REFUSED),
)
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
    if isinstance(error, CellError) and error.code in _BY_CODE:
        return _BY_CODE[error.code]
    for kind, code in _BY_TYPE:
        if isinstance(error, kind):
            return code
    if isinstance(error, CellError) and error.code.startswith("procedure"):
        return ExitCode.REFUSED
    return ExitCode.INTERNAL
