"""How a child process ended, in words."""

import signal

from cellcal.calibration.message import make_message


def describe_exit(code: int) -> str:
    """Return the words for an exit code, or for the signal that a negative one stands for."""
    if code >= 0:
        return make_message("exit code {code}", code=code)
    return make_message("signal {number} ({name})", number=-code, name=signal.strsignal(-code) or "unknown")
