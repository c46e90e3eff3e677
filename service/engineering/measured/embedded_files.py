"""Files that a setting names by their path, or carries whole: a page cannot name files of the service's computer."""

import base64
import binascii
import json
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from cellcal.calibration.errors import CellError
from cellcal.calibration.message import make_message

_MOST_NAME = 120


def is_embedded(value: Any) -> bool:
    """Return whether a setting brings its file along, as ``{"name": …, "content_base64": …}``."""
    return isinstance(value, dict) and "content_base64" in value


@contextmanager
def file_of(value: Any, what: str) -> Iterator[Path]:
    """Yield the file that a setting names or carries; what was carried is gone afterwards.

    Raises
    ------
    CellError
        Neither a path nor a carried file.
    """
    if isinstance(value, str) and value:
        yield Path(value)
    elif is_embedded(value):
        with tempfile.TemporaryDirectory(prefix="cellcal-") as folder:
            path = Path(folder) / plain_name(value.get("name"), what)
            path.write_bytes(content_of(value["content_base64"], what))
            yield path
    else:
        raise CellError(
            make_message(
                "{what} names no file: {value}.", what=what, value=json.dumps(value, default=str)[:80]
            ),
            remedy=make_message("Write {what}=FILE, or choose the file on the page.", what=what),
            code="usage",
        )


def plain_name(name: Any, what: str) -> str:
    """Return the last part of a carried file's name: only its ending tells what is in it.

    Raises
    ------
    CellError
        It has none that a file can have.
    """
    plain = name.replace("\\", "/").rpartition("/")[2] if isinstance(name, str) else ""
    if not plain or plain.startswith(".") or len(plain) > _MOST_NAME or not plain.isprintable():
        raise CellError(
            make_message("the file of {what} has no name.", what=what),
            remedy="Choose a file with a name.",
            code="usage",
        )
    return plain


def content_of(text: Any, what: str) -> bytes:
    """Return the bytes of a carried file.

    Raises
    ------
    CellError
        They did not arrive whole.
    """
    try:
        return base64.b64decode(text, validate=True)
    except (TypeError, ValueError, binascii.Error) as broken:
        raise CellError(
            make_message("the file of {what} did not arrive whole: {broken}", what=what, broken=broken),
            remedy="Choose it again.",
            code="usage",
        ) from broken
