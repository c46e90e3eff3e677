"""The name of a robot for people: that of a file without its folder and digest."""

import re
from pathlib import Path

_DIGEST = re.compile(r"[?&]sha256=[0-9a-f]+")


def shown_name(reference: str) -> str:
    """Return a model's reference for headings and sentences."""
    where, mark, question = _DIGEST.sub("", reference).partition("?")
    return f"{Path(where).name}{mark}{question}"
