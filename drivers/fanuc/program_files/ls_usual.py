"""The usual records of /POS, cut into pieces a block at a time: nearly all of a million positions are written so.

The pieces put together are the block again. Where they do not fill it to its last byte, something in it is not usual,
and the records are read one by one instead.
"""

from collections.abc import Iterator, Sequence
from itertools import chain

import numpy as np
from numpy.typing import NDArray

from cellcal.calibration.geometry import Array
from cellcal.drivers.fanuc.program_files.ls_grammar import CONFIGURATION, GAP, SPLIT
from cellcal.drivers.fanuc.program_files.ls_numbers import all_decimals
from cellcal.drivers.fanuc.program_files.ls_records import ListingFile

_BLOCK_BYTES = 1 << 20  # whose pieces are in memory at once
_SIDE_BY_SIDE = (0, 1, 2, 3, *range(7, 21))  # pieces of a record; 4 to 6 are inside 3
_NUMBER, _GROUP, _USER_FRAME, _TOOL, _CONFIGURATION = 1, 4, 5, 6, 7
_VALUES = range(9, 21, 2)  # X Y Z W P R


class UsualRecords:
    """N usual records, one after the other, in columns of their pieces."""

    def __init__(self, start: int, pieces: Sequence[tuple[bytes, ...]]) -> None:
        self._columns: list[Sequence[bytes]] = list(zip(*pieces, strict=True))
        lengths = [np.fromiter(map(len, self._columns[i]), np.int64, len(pieces)) for i in _SIDE_BY_SIDE]
        self._starts = start + np.concatenate([[0], np.cumsum(sum(lengths))])
        self._head = lengths[0], lengths[1] + lengths[2]

    def __len__(self) -> int:
        """Return N."""
        return len(self._columns[0])

    @property
    def end_offset(self) -> int:
        """Return where the last record ends, if the records stand side by side."""
        return int(self._starts[-1])

    @property
    def number_at(self) -> NDArray[np.int64]:
        """Return the offsets of the positions' numbers in the file."""
        return self._starts[:-1] + self._head[0]

    @property
    def coordinate_offsets(self) -> NDArray[np.int64]:
        """Return the offsets of the coordinates in the file, behind the brace."""
        return self.number_at + self._head[1]

    @property
    def position_numbers(self) -> list[int]:
        """Return the positions' numbers."""
        return list(map(int, self._columns[_NUMBER]))

    @property
    def motion_groups(self) -> list[int]:
        """Return the motion groups, 1 where none is said."""
        return [int(text or 1) for text in self._columns[_GROUP]]

    @property
    def user_frames(self) -> Sequence[bytes]:
        """Return UF."""
        return self._columns[_USER_FRAME]

    @property
    def tool_texts(self) -> Sequence[bytes]:
        """Return UT."""
        return self._columns[_TOOL]

    @property
    def configuration_texts(self) -> Sequence[bytes]:
        """Return CONFIG."""
        return self._columns[_CONFIGURATION]

    @property
    def coordinate_texts(self) -> list[Sequence[bytes]]:
        """Return X Y Z W P R as written, blanks before them included."""
        return [self._columns[i] for i in _VALUES]

    def values_and_decimals(self) -> tuple[Array, Array]:
        """Return X Y Z W P R (N, 6) [mm, deg], and how many decimals each is written with (N, 6)."""
        values = [np.fromiter(map(float, texts), float, len(texts)) for texts in self.coordinate_texts]
        return np.stack(values, axis=1), np.stack(
            [all_decimals(texts) for texts in self.coordinate_texts], axis=1
        )

    def to_bytes(self) -> bytes:
        """Return the records as they stand in the file."""
        return b"".join(chain.from_iterable(zip(*(self._columns[i] for i in _SIDE_BY_SIDE), strict=True)))


def usual_records(place: ListingFile, start: int, end: int) -> Iterator[UsualRecords | None]:
    """Yield the records between two offsets in blocks; None, and no more, where something is not usual."""
    known_texts: set[bytes] = set()
    at = start
    while at < end:
        cut = place.data.find(b"\nP[", at + _BLOCK_BYTES, end)
        stop = end if cut < 0 else cut
        pieces = SPLIT.findall(place.data, at, stop)
        block = UsualRecords(at, pieces) if pieces else None
        done = at if block is None else block.end_offset
        gap = GAP.match(place.data, done, stop)
        whole = block is None or block.to_bytes() == place.data[at:done]
        if not whole or gap is None or gap.end() != stop or not _has_known_configurations(block, known_texts):
            yield None
            return
        if block is not None:
            yield block
        at = stop


def _has_known_configurations(block: UsualRecords | None, known_texts: set[bytes]) -> bool:
    """Return whether all configurations are such."""
    new = set() if block is None else set(block.configuration_texts) - known_texts
    known_texts |= new
    return all(CONFIGURATION.fullmatch(text.decode("cp437")) for text in new)
