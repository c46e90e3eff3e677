"""What a program file for a pendant consists of, whatever its language."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass

Way = tuple[tuple[float, ...], ...]


@dataclass(frozen=True, slots=True)
class ProgramHeader:
    """The head of a program: its name, the token of its moves, for whom it is, and what it is not."""

    name: str
    token: str
    robot: str
    warning: str


@dataclass(frozen=True, slots=True)
class ProgramWriter:
    """Writes joint moves [rad] at a speed of the fastest joint [rad/s] for one make."""

    suffix: str
    write: Callable[[ProgramHeader, Way, float], str]


def lines_of(text: str, width: int) -> Iterator[str]:
    """Break a text between words into lines of at most ``width`` characters."""
    line = ""
    for word in text.split():
        if line and len(line) + 1 + len(word) > width:
            yield line
            line = ""
        line = f"{line} {word}".strip()
    if line:
        yield line
