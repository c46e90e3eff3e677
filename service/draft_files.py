"""Drafts of files that are being written: hidden, and named after their process, which identifies their owner.

A killed process leaves its drafts behind. The next run in the same folder removes them; those of a process that
still runs, or of another computer, stay.
"""

import os
import re
import secrets
import shutil
import socket
import time
from contextlib import suppress
from pathlib import Path

_HOST = re.sub(r"[^A-Za-z0-9]", "", socket.gethostname()) or "here"
_DRAFT = re.compile(rf"\.cellcal-{_HOST}-(\d+)-[0-9a-f]{{16}}")
# A container may share the folder and not the numbers of processes: what is new may be of a process that is not seen.
_SURELY_LEFT_S = 60.0
_tidied: set[tuple[Path, bool]] = set()  # with what is below, or without


def draft_beside(path: Path) -> str:
    """Return a new name for the draft of a file, in the file's folder."""
    # a line has thousands: no objects for paths
    return f"{path.parent}{os.sep}.cellcal-{_HOST}-{os.getpid()}-{secrets.token_hex(8)}"


def remove_left_behind(folder: Path, *, deep: bool = True, least_age_s: float = 0.0) -> None:
    """Remove what killed processes of this computer left in a folder and, where it is ours whole, below it."""
    for place, folders, names in os.walk(folder):
        for name in names:
            if _is_left_behind(place, name, least_age_s):
                with suppress(OSError):
                    os.unlink(os.path.join(place, name))  # noqa: PTH108, PTH118
        for name in [each for each in folders if _is_left_behind(place, each, least_age_s)]:
            shutil.rmtree(os.path.join(place, name), ignore_errors=True)  # noqa: PTH118
            folders.remove(name)
        if not deep:
            return


def remove_drafts_once(folder: Path, *, deep: bool = True) -> None:
    """Remove once in the life of this process what killed ones left in a folder, and below it where ``deep``."""
    if (folder, deep) not in _tidied:
        _tidied.add((folder, deep))
        remove_left_behind(folder, deep=deep, least_age_s=_SURELY_LEFT_S)


def _is_left_behind(place: str, name: str, least_age_s: float) -> bool:
    found = _DRAFT.fullmatch(name)
    if found is None or _is_alive(int(found[1])):
        return False
    if least_age_s <= 0.0:
        return True
    try:
        return time.time() - os.lstat(os.path.join(place, name)).st_mtime >= least_age_s  # noqa: PTH118
    except OSError:
        return False


def _is_alive(pid: int) -> bool:
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return False
    except (OSError, OverflowError):
        return True  # of another user
    return True
