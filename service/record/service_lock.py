"""One service at a time per data folder: a lock that the operating system releases when its process ends.

What a service keeps in memory (who has control, the orders that were given, which run goes on by itself) is right
only while it is the only one. Commands that write beside it have locks of their own: per robot, per transaction.
"""

import os
import socket
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from cellcal.calibration.errors import CellError
from cellcal.calibration.message import make_message
from cellcal.service.files import make_private_folder
from cellcal.service.record.robot_lock import LockBusyError, lock_alone

LOCK_NAME = "service.lock"
_LONGEST = 400  # bytes of what another service wrote of itself


class DataFolderInUseError(CellError):
    """Another service works on the data folder."""

    code = "busy"


@contextmanager
def hold_data_folder(data_dir: Path, service: str) -> Iterator[None]:
    """Be the only service on a data folder; ``service`` describes this one to another.

    Raises
    ------
    DataFolderInUseError
        There is one already, in this process or another.
    OSError
        The folder cannot be written.
    """
    make_private_folder(data_dir)
    path = data_dir / LOCK_NAME
    descriptor = os.open(path, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o600)
    try:
        try:
            lock_alone(descriptor)
        except LockBusyError as error:
            raise _in_use_error(data_dir, descriptor) from error
        os.ftruncate(descriptor, 0)
        os.pwrite(descriptor, f"{service} (process {os.getpid()} on {socket.gethostname()})\n".encode(), 0)
        yield
    finally:
        os.close(descriptor)


def _in_use_error(data_dir: Path, descriptor: int) -> DataFolderInUseError:
    other_service = os.pread(descriptor, _LONGEST, 0).decode(errors="replace").partition("\n")[0]
    return DataFolderInUseError(
        make_message(
            "{other} already works on the data folder {folder}.",
            other=other_service or "another service",
            folder=data_dir,
        ),
        remedy="Open its address in a browser, or end that process first. Another cell needs a data_dir of its own "
        "in its cell file.",
    )
