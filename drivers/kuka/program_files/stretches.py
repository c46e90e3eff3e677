"""Stretches of routines between two settings of ``$TOOL`` or ``$BASE``, as routines of their own for other files.

Files compare what is set around a move with what its routine sets. Where that is several, one value of a called
routine or an interrupt may be among them and still not be the move's.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import TypeAlias

from cellcal.drivers.kuka.program_files.frame_uses import KrlRoutine
from cellcal.drivers.programs.file_declarations import RoutineEffects

Now: TypeAlias = tuple[
    str | None, str | None, bool
]  # tool and base set last on each way to a move, and whether other routines are called since


@dataclass
class Stretches:
    """The stretches of a file's routines in which moves stand."""

    _names: dict[tuple[int, Now], str] = field(default_factory=dict)
    _found: dict[str, tuple[int, RoutineEffects]] = field(default_factory=dict)

    def __contains__(self, name: str) -> bool:
        """Return whether a name is a stretch's, and no whole routine's."""
        return name in self._found

    def calls_others(self, name: str) -> bool:
        """Return whether other routines are called within a stretch, or may interrupt it."""
        effects = self._found[name][1]
        return bool(effects.calls or effects.handlers or effects.shown_handlers)

    def name_of(self, routine: KrlRoutine, now: Now) -> str:
        """Return the name of what stands around a move: the routine's, or a stretch's where it sets several."""
        tool_now, base_now, calls_since = now
        values = (
            routine.tool.values if tool_now is None else {tool_now},
            routine.base.values if base_now is None else {base_now},
        )
        if values == (routine.tool.values, routine.base.values):
            return routine.name
        key = routine.number, now
        if key not in self._names:
            calls_count = calls_since or tool_now is None or base_now is None
            own = effects_of(routine)
            tools, bases = map(frozenset, values)
            self._names[key] = name = f"{routine.name} {len(self._names)}"
            stretch = replace(
                own, tools=tools, frames=bases, calls=own.calls if calls_count else frozenset(), shown=False
            )
            self._found[name] = routine.number, replace(stretch, resets=False)
        return self._names[key]

    def effects_with(self, routines: Sequence[KrlRoutine]) -> dict[str, RoutineEffects]:
        """Return what routines and stretches set; a routine calls its stretches, where interrupts reach them."""
        own: dict[int, set[str]] = {}
        for name, (number, _) in self._found.items():
            own.setdefault(number, set()).add(name)
        effects = {name: each for name, (_, each) in self._found.items()}
        for routine in routines:
            its = effects_of(routine)
            effects[routine.name] = replace(its, calls=its.calls.union(own.get(routine.number, ())))
        return effects


def effects_of(routine: KrlRoutine) -> RoutineEffects:
    """Return what a routine sets, for the files that call it."""
    return RoutineEffects(
        frozenset(routine.tool.values),
        frozenset(routine.base.values),
        frozenset(routine.calls),
        routine.shown,
        routine.resets,
        handlers=frozenset(routine.handlers),
        shown_handlers=frozenset(routine.shown_handlers),
        external_tool=routine.external_tool,
        held_tool=routine.held_tool,
    )
