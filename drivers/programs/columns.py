"""Numbers of positions that are all written alike, in columns: where they stand, how finely; new ones for them."""

from collections.abc import Sequence
from itertools import repeat

import numpy as np
from numpy.typing import NDArray

from cellcal.calibration.geometry import Array
from cellcal.drivers.programs.positions import PositionChange, Positions
from cellcal.drivers.programs.spans import Edit

BEYOND = 1e7  # mm; no robot goes there

# By decimals: what rounding hides, to the last bit what is reckoned of a single number.
HALF = np.array([0.5 * 10.0**-decimals * (1 - 1e-9) for decimals in range(16)])


def gets_only_a_pose(
    rows: NDArray[np.int64], change: PositionChange, positions: Positions
) -> NDArray[np.bool_]:
    """Return (K,): whether a change brings rows a new pose that a robot can have, and nothing else."""
    if change.frame_tip is None:
        return np.zeros(len(rows), dtype=bool)
    near = np.abs(change.frame_tip[:, :3, 3]).max(axis=1) * 1e3 < BEYOND
    is_given = np.asarray(np.isfinite(change.frame_tip).all(axis=(1, 2)) & near)
    if change.joints is not None:
        is_given &= ~np.isfinite(change.joints).any(axis=1)
    if change.external is not None:
        is_given &= ~np.isfinite(change.external).any(axis=1)
    for texts, old in (
        (change.configurations, positions.configurations),
        (change.user_frames, positions.user_frames),
    ):
        if texts is not None:
            is_given &= [text == (old[row] or "") for text, row in zip(texts, rows.tolist(), strict=True)]
    return is_given


def part_of(change: PositionChange, some: NDArray[np.bool_]) -> PositionChange:
    """Return a change of some of its rows."""

    def select_texts(of: Sequence[str] | None) -> list[str] | None:
        return None if of is None else [text for text, one in zip(of, some.tolist(), strict=True) if one]

    return PositionChange(
        np.asarray(change.rows)[some],
        frame_tip=None if change.frame_tip is None else change.frame_tip[some],
        joints=None if change.joints is None else change.joints[some],
        configurations=select_texts(change.configurations),
        user_frames=select_texts(change.user_frames),
        external=None if change.external is None else change.external[some],
    )


def widths_and_decimals(
    texts: Sequence[str], sizes: Sequence[int]
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return of N positions' numbers as written, position by position, what their columns hold.

    ``sizes`` are how many numbers of a position share their decimals, kind by kind: 3 lengths, 3 angles. Returned are
    the widths in characters (N, K), and the decimals of the finest of each kind (N, len(sizes)).
    """
    widths = np.fromiter(map(len, texts), np.int64, len(texts)).reshape(-1, sum(sizes))
    points = np.fromiter(map(str.find, texts, repeat(".")), np.int64, len(texts)).reshape(widths.shape)
    decimals = np.where(points < 0, 0, widths - points - 1)
    return widths, np.maximum.reduceat(decimals, np.cumsum([0, *sizes[:-1]]), axis=1)


def number_edits(
    starts: NDArray[np.int64],
    widths: NDArray[np.int64],
    gaps: Sequence[int],
    values: Array,
    digits: NDArray[np.int64],
    other: NDArray[np.bool_],
) -> list[Edit]:
    """Return the edits that write ``other`` (N, K) of the values with so many digits, in the places of the old.

    ``gaps`` (K,) are the characters before each number, from where its position starts or the number before it ends.
    """
    ends = starts[:, None] + np.cumsum(widths + np.asarray(gaps), axis=1)
    texts = [
        f"{round(value, decimals) + 0.0:.{decimals}f}"  # no -0.000
        for value, decimals in zip(values[other].tolist(), digits[other].tolist(), strict=True)
    ]
    return list(zip((ends - widths)[other].tolist(), ends[other].tolist(), texts, strict=True))
