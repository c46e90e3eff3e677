"""Lines and columns of places in a text."""

import numpy as np
from numpy.typing import NDArray


class LineNumbers:
    """Where the lines of a text end, found once: a large program has a hundred thousand places to name."""

    def __init__(self, text: str) -> None:
        characters = np.frombuffer(text.encode("utf-32-le", "surrogatepass"), dtype="<u4")
        self._breaks = np.flatnonzero(characters == ord("\n"))

    def line_of(self, place: int) -> int:
        """Return the line, from 1, of a place in the text."""
        return int(np.searchsorted(self._breaks, place)) + 1

    def lines_of(self, places: NDArray[np.int64]) -> NDArray[np.int64]:
        """Return the lines, from 1, of places in the text."""
        return np.searchsorted(self._breaks, places) + 1

    def column_of(self, place: int) -> int:
        """Return the column, from 1, of a place in the text."""
        line = self.line_of(place)
        return place - (int(self._breaks[line - 2]) if line > 1 else -1)
