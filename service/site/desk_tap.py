"""What the desk says, as it comes through a pipe: the newest counts, nothing is waited for."""

import threading
import time
from collections.abc import Callable
from functools import partial
from typing import Any, BinaryIO

from cellcal.calibration.documents import DocumentError
from cellcal.calibration.documents.json_text import parse_json
from cellcal.drivers.supervision import start_thread

DESK_SILENT_S = 5.0
LONGEST_LINE = 1 << 20


class DeskTap:
    """The newest that the desk said. A thread reads; older lines are left out, never waited for."""

    def __init__(self, stream: BinaryIO | None, clock: Callable[[], float] = time.monotonic) -> None:
        self._clock = clock
        self._session: tuple[float, dict[str, Any]] | None = None
        self._live: tuple[float, dict[str, Any]] | None = None
        self.ended = threading.Event()
        if stream is not None:
            start_thread("desk tap", partial(self._read, stream), self.ended)

    def session(self) -> dict[str, Any] | None:
        """Return the desk's session; None while there is no desk, or it is silent."""
        kept, live = self._session, self._live
        if kept is None or self._clock() - max(kept[0], live[0] if live else 0.0) > DESK_SILENT_S:
            return None
        return kept[1]

    def live(self) -> dict[str, Any] | None:
        """Return the newest live values; None while there are none that are new enough."""
        kept = self._live
        return None if kept is None or self._clock() - kept[0] > DESK_SILENT_S else kept[1]

    def take(self, line: bytes) -> None:
        """Take in one line."""
        try:
            said = parse_json(line)
            kind, content = said["told"], said["content"]
        except (DocumentError, KeyError, TypeError):
            return
        if not isinstance(content, dict):
            return
        if kind == "live":
            self._live = (self._clock(), content)
        elif kind == "session":
            self._session = (self._clock(), content)
        elif kind == "gone":
            self._session = self._live = None

    def _read(self, stream: BinaryIO) -> None:
        while line := stream.readline(LONGEST_LINE):
            self.take(line)
        self.ended.set()
