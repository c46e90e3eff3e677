"""Lines between the web process and the cell's process: none is longer than `LONGEST_LINE`, in either direction.

The sender never writes a longer line: what screens see is shortened, and says so. The reader drops one that came all
the same, names it, and goes on with the next.
"""

import asyncio
import logging
from collections.abc import AsyncIterator, Callable, Mapping
from typing import Any

import numpy as np
import orjson

from cellcal.calibration.errors import CellError
from cellcal.calibration.message import make_message
from cellcal.calibration.message_table import with_messages
from cellcal.service.cell_process.messages import LONGEST_LINE

_log = logging.getLogger(__name__)
_CHUNK = 1 << 16
# longest text and longest list, tried in turn until the line is short enough
_SHORTENED = ((20_000, 2_000), (4_000, 400), (1_000, 100), (200, 20), (40, 5), (10, 1))
_DEEPEST = 12


class LineTooLongError(CellError):
    """A line that is longer than what the two processes may send each other."""

    code = "line.too_long"

    def __init__(self, what: str) -> None:
        super().__init__(
            make_message(
                "{what} is longer than {longest_line} bytes and was not taken.",
                what=what,
                longest_line=LONGEST_LINE,
            ),
            remedy="What the journal has of the run is whole. Send the log to the maker of the program.",
        )


async def whole_lines(
    reader: asyncio.StreamReader, on_too_long: Callable[[], object] | None = None
) -> AsyncIterator[bytes]:
    """Yield line after line; one that is too long is dropped and told, never the one behind it."""
    buffered, too_long = b"", False
    while chunk := await reader.read(_CHUNK):
        *whole, rest = (buffered + chunk).split(b"\n")
        for line in whole:
            if not too_long and len(line) <= LONGEST_LINE:
                yield line
            elif on_too_long is not None:
                on_too_long()
            too_long = False
        too_long = too_long or len(rest) > LONGEST_LINE
        buffered = b"" if too_long else rest


class LineWriter:
    """Makes a line of each message; what is too long for one is shortened, and its session says so."""

    def __init__(self) -> None:
        self._logged: set[str] = set()

    def line_of(self, message: Mapping[str, object]) -> bytes:
        """Return the line, with its end."""
        line = _dumped(message)
        if len(line) <= LONGEST_LINE:
            return line
        self._log_once(str(message.get("told", "reply")), len(line))
        for longest_text, longest_list in _SHORTENED:
            short = _shortened(message, longest_text, longest_list)
            _say_so(short, len(line))
            found = _dumped(short)
            if len(found) <= LONGEST_LINE:
                return found
        return _dumped(_bare(message))

    def _log_once(self, kind: str, size: int) -> None:
        if kind not in self._logged:
            self._logged.add(kind)
            _log.error("a message to the screens (%s) has %d bytes and is shortened", kind, size)


def _dumped(message: Any) -> bytes:
    options = orjson.OPT_SERIALIZE_NUMPY | orjson.OPT_NON_STR_KEYS  # a name in a result may be a message
    return orjson.dumps(with_messages(message), option=options) + b"\n"


def _shortened(value: Any, longest_text: int, longest_list: int, depth: int = 0) -> Any:
    if depth > _DEEPEST:
        return None
    if isinstance(value, str):
        return value if len(value) <= longest_text else value[: longest_text - 1] + "…"
    if isinstance(value, np.ndarray | list | tuple):
        return [_shortened(each, longest_text, longest_list, depth + 1) for each in value[:longest_list]]
    if isinstance(value, dict):
        most = max(longest_list, 50)  # our own objects have fewer fields; what is measured may have thousands
        parts = list(value.items())[:most]
        return {key: _shortened(each, longest_text, longest_list, depth + 1) for key, each in parts}
    return value


def _say_so(message: dict[str, Any], size: int) -> None:
    """Name it among the troubles of the session that the line carries, if it carries one."""
    sessions = [message.get("content"), (message.get("reply") or {}).get("session")]
    for session in sessions:
        if isinstance(session, dict) and isinstance(session.get("troubles"), list):
            session["troubles"].append(
                {
                    "task": "screens",
                    "message": make_message(
                        "what the screens show is shortened: it has {size} bytes.", size=size
                    ),
                    "remedy": "The journal and the certificate have everything.",
                    "failures": 1,
                    "running": True,
                }
            )


def _bare(message: Mapping[str, object]) -> Mapping[str, object]:
    """Return what is left where nothing can be shortened enough: a reply that says so, or live values of nothing."""
    error = LineTooLongError("the message")
    if "number" in message:
        reply = {"ok": False, "code": error.code, "message": error.message, "remedy": error.remedy}
        return {"number": message["number"], "reply": reply}
    return {"told": "live", "content": {"devices": []}}
