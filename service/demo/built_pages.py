"""Whether the pages that the service shows are there; a checkout that has none builds them."""

import fcntl
import os
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

from cellcal.service.web.pages import DIST

_SCRIPT = Path(__file__).resolve().parents[2] / "deploy" / "build_pages.sh"


def see_to_pages(say: Callable[[str], None]) -> bool:
    """Build the pages where a checkout has none; return whether there are any. `make` knows when they are old."""
    if not _are_there() and _SCRIPT.is_file():
        with _SCRIPT.open("rb") as turn:  # two demos at once do not build into each other
            fcntl.flock(turn, fcntl.LOCK_EX)
            if not _are_there():
                _build_pages(say)
    return _are_there()


def _build_pages(say: Callable[[str], None]) -> None:
    say("The pages are built first; that takes a minute once.")
    ended = subprocess.run(
        ["bash", str(_SCRIPT)], env={**os.environ, "VENV": sys.prefix}, stdin=subprocess.DEVNULL, check=False
    )
    if ended.returncode != 0:
        say("The pages could not be built; the lines above say why.")


def _are_there() -> bool:
    return (DIST / "index.html").is_file()
