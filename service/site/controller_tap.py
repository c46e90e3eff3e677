"""The cell process's messages, as they come through a pipe: the newest counts, nothing is waited for."""

import threading
import time
from collections.abc import Callable
from functools import partial
from typing import BinaryIO, cast

from cellcal.calibration.documents import DocumentError
from cellcal.calibration.documents.json_text import parse_json
from cellcal.calibration.message_table import remember_table
from cellcal.drivers.supervision import start_thread
from cellcal.service.session_documents import LiveDocument, SessionDocument

CONTROLLER_SILENT_S = 5.0
LONGEST_LINE = 1 << 20


class ControllerTap:
    """The newest message of the cell process. A thread reads; older lines are left out, never waited for."""

    def __init__(self, stream: BinaryIO | None, clock: Callable[[], float] = time.monotonic) -> None:
        self._clock = clock
        self._session: tuple[float, SessionDocument] | None = None
        self._live: tuple[float, LiveDocument] | None = None
        self.ended = threading.Event()
        if stream is not None:
            start_thread("cell process tap", partial(self._read_stream, stream), self.ended)

    def latest_session(self) -> SessionDocument | None:
        """Return the cell process's session; None while there is no such process, or it sends nothing."""
        newest, live = self._session, self._live
        if newest is None or self._clock() - max(newest[0], live[0] if live else 0.0) > CONTROLLER_SILENT_S:
            return None
        return newest[1]

    def latest_live(self) -> LiveDocument | None:
        """Return the newest live values; None while there are none that are new enough."""
        newest = self._live
        return None if newest is None or self._clock() - newest[0] > CONTROLLER_SILENT_S else newest[1]

    def take_line(self, line: bytes) -> None:
        """Take in one line."""
        try:
            message = parse_json(line)
            remember_table(message)
            kind, content = message["told"], message["content"]
        except (DocumentError, KeyError, TypeError):
            return
        if not isinstance(content, dict):
            return
        if kind == "live":
            self._live = (self._clock(), cast(LiveDocument, content))
        elif kind == "session":
            self._session = (self._clock(), cast(SessionDocument, content))
        elif kind == "gone":
            self._session = self._live = None

    def _read_stream(self, stream: BinaryIO) -> None:
        while line := stream.readline(LONGEST_LINE):
            self.take_line(line)
        self.ended.set()
