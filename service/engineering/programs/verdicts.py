"""What a point was found to be, as one word: a page shows it by shape and in its own language."""

import re
from collections.abc import Iterable
from dataclasses import dataclass

from cellcal.calibration.message import find_message

FITS, REACH, LIMIT, SINGULAR, FLIP, COLLISION, UNKNOWN = (
    "fits", "reach", "limit", "singular", "flip", "collision", "unknown",
)  # fmt: skip
VERDICTS = (FITS, REACH, LIMIT, SINGULAR, FLIP, COLLISION, UNKNOWN)
# How the sentences of `judge` and `postures` begin; a test holds these against what is really said.
_BEGINNINGS = (
    ("unreachable", REACH),
    ("no posture of the arm", REACH),
    ("no joints inside the limits", LIMIT),
    ("joint ", LIMIT),
    ("joints ", LIMIT),
    ("near a singularity", SINGULAR),
    ("the wrist would flip", FLIP),
    ("collides", COLLISION),
    ("comes too close", COLLISION),
)
_PLACE = re.compile(r"(\d+):(\d+): ")


def verdict_of(reason: str) -> str:
    """Return the word for the reason that a point was left for; ``fits`` where there is none."""
    if not reason:
        return FITS
    return next((word for beginning, word in _BEGINNINGS if reason.startswith(beginning)), UNKNOWN)


def count_verdicts(reasons: Iterable[str]) -> dict[str, int]:
    """Return how many points have which verdict."""
    found = dict.fromkeys(VERDICTS, 0)
    for reason in reasons:
        found[verdict_of(reason)] += 1
    return found


@dataclass(frozen=True, slots=True)
class FilePlace:
    """The place in a file where something is wrong; zeros: the file as a whole."""

    line: int
    column: int
    sentence: str


def place_in(message: str) -> FilePlace:
    """Return line and column that a refusal begins with, and the rest of it."""
    found = _PLACE.match(message)
    rest = message if found is None else message[found.end() :]
    return (
        FilePlace(0, 0, message)
        if found is None
        else FilePlace(int(found[1]), int(found[2]), find_message(rest) or rest)
    )
