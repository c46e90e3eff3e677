"""Drafts of files that are being written: hidden, and named after their process, which identifies their owner.

A killed process leaves its drafts behind. The next run in the same folder removes them; those of a process that
still runs, or of another computer, stay.
"""

import os
import re
import secrets
import socket
from contextlib import suppress
from pathlib import Path

_HOST = re.sub(r"[^A-Za-z0-9]", "", socket.gethostname()) or "here"
_DRAFT = re.compile(rf"\.cellcal-{_HOST}-(\d+)-[0-9a-f]{{16}}")


def draft_beside(path: Path) -> str:
    """Return a new name for the draft of a file, in the file's folder."""
    # a line has thousands: no objects for paths
    return f"{path.parent}{os.sep}.cellcal-{_HOST}-{os.getpid()}-{secrets.token_hex(8)}"


def remove_left_behind(folder: Path) -> None:
    """Remove what killed processes of this computer left in a folder and below it."""
    for place, _, names in os.walk(folder):
        for name in names:
            found = _DRAFT.fullmatch(name)
            if found and not _is_alive(int(found[1])):
                with suppress(OSError):
                    os.unlink(os.path.join(place, name))  # noqa: PTH108, PTH118


def _is_alive(pid: int) -> bool:
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return False
    except (OSError, OverflowError):
        return True  # of another user
    return True
