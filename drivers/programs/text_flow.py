"""The blocks and labels of a routine: whether each way to a place goes through another above it."""

from bisect import bisect_right
from collections.abc import Sequence
from dataclasses import dataclass, field
from math import inf
from operator import attrgetter


@dataclass(eq=False)
class TextBlock:
    """A loop, whose first line is reached from its last, too, or a branch."""

    begin: int
    around: "TextBlock | None"
    repeats: bool
    end: float = inf


@dataclass
class TextFlow:
    """The blocks of a routine while it is read, from top to bottom."""

    labels: list[int] = field(default_factory=list)  # where jumps land
    blocks: list[TextBlock] = field(default_factory=list)
    blocks_ended: int = 0
    _open: TextBlock | None = None

    def begin_block(self, place: int, *, repeats: bool) -> None:
        """Note that a block begins."""
        self._open = TextBlock(place, self._open, repeats)
        self.blocks.append(self._open)

    def end_block(self, place: int) -> None:
        """Note that the innermost block ends."""
        if self._open is not None:
            self._open.end, self._open = place, self._open.around
            self.blocks_ended += 1

    def blocks_around(self, place: int) -> list[TextBlock]:
        """Return the blocks around a place, the innermost first."""
        at = bisect_right(self.blocks, place, key=attrgetter("begin")) - 1
        block = self.blocks[at] if at >= 0 else None
        found = []
        while block is not None:
            if place < block.end:
                found.append(block)
            block = block.around
        return found

    def surely_passes(self, place: int, until: int, next_place: float) -> bool:
        """Return whether each way to a place goes through another above it, and not through a third below."""
        if bisect_right(self.labels, place) < bisect_right(self.labels, until):
            return False
        outer, inner = self.blocks_around(place), self.blocks_around(until)
        more = len(inner) - len(outer)
        if more < 0 or inner[more:] != outer:
            return False
        return all(block.end <= next_place for block in inner[:more] if block.repeats)

    def may_meet(self, marks: Sequence[int], place: int, until: int) -> bool:
        """Return whether a way from a place to another below it, not over the first again, may meet one of the marks.

        A loop around the other alone leads from below it to it again.
        """
        met = bisect_right(marks, until)
        if bisect_right(marks, place) < met:
            return True
        outer = self.blocks_around(place)
        inner = [block for block in self.blocks_around(until) if block.repeats and block not in outer]
        return any(met < bisect_right(marks, block.end) for block in inner)
