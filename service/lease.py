"""One run at a time per robot: a lock that the operating system takes back when its holder dies."""

import fcntl
import os
import re
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from calibration.errors import CellError


class LeaseHeldError(CellError):
    """Somebody else is working on this robot."""

    code = "busy"


DEVICES = " devices"  # the right to connect to a robot and its gauge; without it, to run procedures on them


@contextmanager
def lease(directory: Path, robot: str, holder: str, right: str = "") -> Iterator[None]:
    """Hold the exclusive right to run procedures on a robot, or to connect to it (``DEVICES``).

    Raises
    ------
    LeaseHeldError
        Another run holds it, in this process or another.
    """
    directory.mkdir(parents=True, exist_ok=True)
    descriptor = os.open(_path(directory, robot + right), os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o644)
    try:
        try:
            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError as error:
            other = os.read(descriptor, 200).decode(errors="replace") or "somebody"
            raise LeaseHeldError(
                f"{other} is working on robot {robot}",
                remedy="Wait until that run has ended, or end it there.",
            ) from error
        os.ftruncate(descriptor, 0)
        os.write(descriptor, holder.encode())
        yield
    finally:
        os.close(descriptor)


def is_held(directory: Path, robot: str, right: str = "") -> bool:
    """Tell whether somebody runs a procedure on a robot now, or is connected to it (``DEVICES``)."""
    try:
        descriptor = os.open(_path(directory, robot + right), os.O_RDWR | os.O_CLOEXEC)
    except FileNotFoundError:
        return False
    try:
        fcntl.flock(descriptor, fcntl.LOCK_SH | fcntl.LOCK_NB)
    except BlockingIOError:
        return True
    finally:
        os.close(descriptor)
    return False


def _path(directory: Path, robot: str) -> Path:
    return directory / f"{re.sub(r'[^A-Za-z0-9_-]', '_', robot)}.lock"
