"""Shifts of RAPID that do not turn with the targets: what was found while reading, and the rows it counts for."""

from collections.abc import Sequence
from dataclasses import dataclass, field

from drivers.abb.collected import Collected
from drivers.abb.uses import Uses
from drivers.programs.positions import CARTESIAN
from drivers.programs.shifts import NO_TURN, Axes, Quaternion, Shift, Triple


@dataclass(frozen=True, slots=True)
class ShiftFound:
    """One shift as it stands in the text."""

    place: int
    what: str
    scope: str
    name: str  # of the target
    user_frame: str | None
    translation_m: Triple
    quaternion: Quaternion | None = NO_TURN


@dataclass
class ShiftsFound:
    """The shifts of a module."""

    found: list[ShiftFound] = field(default_factory=list)

    def shifts(self, collected: Collected, uses: Uses) -> tuple[Shift, ...]:
        """Return the shifts with the rows of their targets, counted as they were read."""
        return tuple(self._shift(one, collected, uses) for one in self.found)

    @staticmethod
    def _shift(one: ShiftFound, collected: Collected, uses: Uses) -> Shift:
        rows = _cartesian(uses.rows_of(one.name, one.scope), collected)
        return Shift(
            collected.source.line_of(one.place),
            one.what,
            Axes.USER_FRAME,
            rows,
            point=one.name,
            user_frame=one.user_frame,
            translation_m=one.translation_m,
            quaternion=one.quaternion,
        )


def _cartesian(rows: Sequence[int], collected: Collected) -> tuple[int, ...]:
    return tuple(row for row in rows if collected.kinds[row] == CARTESIAN)
