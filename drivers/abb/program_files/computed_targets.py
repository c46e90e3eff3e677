"""Targets that functions of a RAPID module compute: what they are made of is used where moves go to the result."""

import re
from dataclasses import dataclass, field

from cellcal.drivers.abb.program_files.frame_facts import ToolAndFrame
from cellcal.drivers.abb.program_files.instructions import COMPUTED, MoveInstruction, MoveTarget
from cellcal.drivers.abb.program_files.literals import NAME, W, decode_name
from cellcal.drivers.abb.program_files.measured_places import measured_name
from cellcal.drivers.abb.program_files.passed_targets import split_arguments
from cellcal.drivers.abb.program_files.target_uses import RESULT, TargetUses, result_of

_SOURCE = re.compile(rf"(?<![\w.\\])({NAME})", re.ASCII)
_RETURNED = re.compile(rf"{W}({NAME}){W}(?:\{{[^{{}};]*+\}}{W})?+;", re.ASCII)
_CALLED = re.compile(rf"({NAME}){W}\(", re.ASCII)


@dataclass
class ComputedTargets:
    """Moves to the results of functions, and what the module's own functions return."""

    text: str
    uses: TargetUses
    moves: set[tuple[str, str, ToolAndFrame]] = field(default_factory=set)  # scope, function, and with what
    numbers: dict[tuple[str, ToolAndFrame], int] = field(default_factory=dict)
    is_local: bool = False  # other modules do not see the routine that is read

    def note_move(self, target: MoveTarget, instruction: MoveInstruction) -> None:
        """Take the data that the target of a move is computed from as if a copy of them were moved to."""
        if target.remark != COMPUTED or measured_name(self.text, target.place):
            return
        scope, with_what = self.uses.scope, (instruction.tool, instruction.frame)
        _, argument = next(split_arguments(self.text, (target.place, instruction.end)), (False, ""))
        number = self.numbers.setdefault((scope, with_what), len(self.numbers))
        result = f"result {number}"  # one for all that are moved to alike
        self.uses.declare_without_row(result)
        self.uses.note_use(result, *with_what)
        names = [decode_name(name) for name in _SOURCE.findall(argument)]
        self.uses.returned |= {(scope, name, result) for name in names if not self._is_parameter(name)}
        if (called := _CALLED.match(argument)) is not None:
            self.moves.add((scope, decode_name(called[1]), with_what))

    def note_return(self, end: int) -> None:
        """Take a target that a function returns, where ``RETURN`` ends at a place."""
        found = _RETURNED.match(self.text, end)
        module, _, function = self.uses.scope.partition("/")
        if found is None or not function or self._is_parameter(decode_name(found[1])):
            return
        result = result_of(function)
        self.uses.rows.setdefault((f"{module}/", result), [])
        self.uses.shown[result] = self.uses.shown.get(result, False) or not self.is_local
        self.uses.returned.add((self.uses.scope, decode_name(found[1]), result))

    def finish_reading(self) -> None:
        """Count moves to the results of functions, of the module or of another one."""
        for scope, function, with_what in self.moves:
            self.uses.used[scope, result_of(function)].add(with_what)

    def results_elsewhere(self) -> frozenset[str]:
        """Return the results of functions that the module does not have, or of which it names no target."""
        results = {(scope, result_of(function)) for scope, function, _ in self.moves}
        results |= {(scope, name) for scope, name, _ in self.uses.returned if name.startswith(RESULT)}
        return frozenset(name for scope, name in results if not self.uses.is_own(name, scope))

    def _is_parameter(self, name: str) -> bool:
        return (self.uses.scope, name.lower()) in self.uses.parameters
