"""Which points a program moves to in a base that no external axis turns, whatever its machine is.

``$BASE=BASE_DATA[n]``, and ``BAS(#BASE,n)`` that does the same (BAS.SRC of KSS 8), do not look at the machine which
$CONFIG.DAT puts the base on. The inline forms do, and EK() names one.
"""

from collections.abc import Sequence, Set
from dataclasses import replace

from cellcal.drivers.programs.file_declarations import ExternalUses, MoveFrames
from cellcal.drivers.programs.positions import Positions


def with_standing_bases(positions: Positions, taught: Set[int]) -> Positions:
    """Return the positions of a file that note which of them its own moves go to in such a base."""
    rows = {
        row
        for row, base in enumerate(positions.user_frames)
        if _is_number(base) and row not in taught and row not in positions.conditions
    }
    return replace(positions, standing_frames=frozenset(rows))


def standing_rows(positions: Positions, external_uses: ExternalUses, keys: Sequence[str]) -> frozenset[int]:
    """Return the positions that moves of any file go to in such a base; ``external_uses`` still name frame data."""
    return positions.standing_frames | {
        row for row, key in enumerate(keys) if any(_stands(use) for use, _ in external_uses.uses_of_name(key))
    }


def _stands(use: MoveFrames) -> bool:
    return not use.why and _is_number(use.frame)


def _is_number(base: str | None) -> bool:
    return base is not None and base.isdigit()
