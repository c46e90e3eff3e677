"""One run at a time per robot: a lock that the operating system releases when its process ends."""

import fcntl
import os
import re
import time
from collections.abc import Collection, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from cellcal.calibration.errors import CellError
from cellcal.calibration.message import make_message
from cellcal.service.files import make_private_folder

_RUN_AT_END = re.compile(r" \(([^()]+)\)$")
_LOOKS, _LOOK_S = 5, 0.01


class LeaseHeldError(CellError):
    """Another process is working on this robot."""

    code = "busy"


class LockBusyError(Exception):
    """Another process holds a lock."""


class LeaseLostError(CellError):
    """The right to command this robot went to another process while it was used."""

    code = "lease_lost"


@dataclass(frozen=True, slots=True)
class Lease:
    """A right that is held: its file, and the token that was written into it. No two holders have the same."""

    path: Path
    descriptor: int
    token: int

    def check_held(self) -> None:
        """Raise LeaseLostError where the file was taken away, or carries the token of another holder."""
        if not self._is_ours():
            raise LeaseLostError(
                "another process has taken the right to command this robot",
                remedy="Look at the robot. Find out who else works on it, end one of the two, then resume.",
            )

    def _is_ours(self) -> bool:
        try:
            here, there = os.fstat(self.descriptor), self.path.stat()
            return os.path.samestat(here, there) and _read_token(self.descriptor) == self.token
        except OSError:
            return False


DEVICES = " devices"  # the right to connect to a robot and its gauge; without it, to run procedures on them


@contextmanager
def acquire_lease(directory: Path, robot: str, holder: str, right: str = "") -> Iterator[Lease]:
    """Hold the exclusive right to run procedures on a robot, or to connect to it (``DEVICES``).

    Raises
    ------
    LeaseHeldError
        Another run holds it, in this process or another.
    """
    make_private_folder(directory)
    path = _lease_path(directory, robot + right)
    descriptor = os.open(path, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o600)
    try:
        try:
            lock_alone(descriptor)
        except LockBusyError as error:
            other = os.read(descriptor, 200).decode(errors="replace").partition("\n")[0] or "another process"
            raise LeaseHeldError(
                make_message("{other} is working on robot {robot}", other=other, robot=robot),
                remedy="Wait until that run has ended, or end it there.",
            ) from error
        token = _read_token(descriptor) + 1  # fencing: every holder has a higher one than those before
        os.ftruncate(descriptor, 0)
        os.pwrite(descriptor, f"{holder}\n{token}\n".encode(), 0)
        yield Lease(path, descriptor, token)
    finally:
        os.close(descriptor)


def is_held(directory: Path, robot: str, right: str = "") -> bool:
    """Return whether a process runs a procedure on a robot now, or is connected to it (``DEVICES``)."""
    return _holder_of(_lease_path(directory, robot + right)) is not None


def runs_under_way(directory: Path) -> frozenset[str]:
    """Return the identifiers of the runs that go on in any process of this computer."""
    holders = [_holder_of(path) for path in directory.glob("*.lock")]
    return frozenset(found[1] for each in holders if each and (found := _RUN_AT_END.search(each)))


def state_seen(state: str, run_id: str, under_way: Collection[str]) -> str:
    """Return the state of a run, "running" where it has no end yet and is one of those that go on in some process."""
    return "running" if state == "interrupted" and run_id in under_way else state


def _holder_of(path: Path) -> str | None:
    """Return who holds a lease; None where no process does."""
    try:
        # For reading: a look must also do on a disk that is read-only.
        descriptor = os.open(path, os.O_RDONLY | os.O_CLOEXEC)
    except FileNotFoundError:
        return None
    except OSError as error:
        raise CellError(
            make_message(
                "whether the robot is in use cannot be seen: {error}.", error=error.strerror or error
            ),
            remedy="Run cellcal as the user of its data folder, or give that user its files.",
            code="store.io",
        ) from error
    try:
        fcntl.flock(descriptor, fcntl.LOCK_SH | fcntl.LOCK_NB)
    except BlockingIOError:
        return os.read(descriptor, 200).decode(errors="replace").partition("\n")[0]
    finally:
        os.close(descriptor)
    return None


def lock_alone(descriptor: int) -> None:
    """Take the lock of a file; who only looks whether it is held (``is_held``) has it for a moment.

    Raises
    ------
    LockBusyError
        Another process holds it.
    CellError
        The file system knows no locks.
    """
    for look in range(_LOOKS):
        try:
            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError as error:
            if look == _LOOKS - 1:
                raise LockBusyError from error
            time.sleep(_LOOK_S)
        except OSError as error:  # a share that knows no locks; no other process need be there
            raise CellError(
                make_message(
                    "the disk of data_dir cannot lock files: {error}.", error=error.strerror or error
                ),
                remedy="Set data_dir of the cell file to a folder on a disk of this computer.",
                code="store.io",
            ) from error
        else:
            return


def _read_token(descriptor: int) -> int:
    """Return the token of the last holder; 0 where there was none."""
    _, _, rest = os.pread(descriptor, 400, 0).decode(errors="replace").partition("\n")
    number = rest.strip()
    return int(number) if number.isdecimal() else 0


def _lease_path(directory: Path, robot: str) -> Path:
    return directory / f"{re.sub(r'[^A-Za-z0-9_-]', '_', robot)}.lock"
