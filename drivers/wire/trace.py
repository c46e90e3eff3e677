"""The last frames of a link, kept so that a fault can be looked at afterwards."""

import logging
import time
from collections import deque
from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class WireFrame:
    """One frame as it went over the wire."""

    at_s: float  # host monotonic clock
    direction: str  # ">" to the device, "<" from it
    data: str  # hex


class FrameTrace:
    """Ring buffer of the last frames; each also goes to the log ``wire.<device>`` at DEBUG."""

    def __init__(self, device: str, *, keep: int = 200) -> None:
        self._log = logging.getLogger(f"wire.{device}")
        self._frames: deque[WireFrame] = deque(maxlen=keep)

    def add_frame(self, direction: str, data: str) -> None:
        """Keep one frame."""
        self._frames.append(WireFrame(time.monotonic(), direction, data))
        self._log.debug("%s %s", direction, data)

    def last_received(self) -> str:
        """Return the newest frame from the device, for an error message."""
        return next((frame.data for frame in reversed(self._frames) if frame.direction == "<"), "")

    def ends_with_received(self) -> bool:
        """Whether something came from the device since the last frame to it."""
        return bool(self._frames) and self._frames[-1].direction == "<"

    def list_frames(self) -> tuple[WireFrame, ...]:
        """Return what is kept, oldest first."""
        return tuple(self._frames)
