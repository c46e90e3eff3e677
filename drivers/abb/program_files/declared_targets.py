"""The targets that a file declares, by the scope that sees them: a routine, its module, all modules."""

from collections import defaultdict
from collections.abc import Sequence, Set
from dataclasses import dataclass, field

from cellcal.drivers.abb.program_files.frame_facts import ToolAndFrame
from cellcal.drivers.abb.program_files.measured_places import is_measured
from cellcal.drivers.programs.routine_calls import OWN, PARAMETER


@dataclass
class DeclaredTargets:
    """Declared targets, and routines' parameters, by scope."""

    scope: str = "/"  # module/routine
    shown: dict[str, bool] = field(default_factory=dict)  # targets of modules, and whether others see them
    parameters: set[tuple[str, str]] = field(default_factory=set)  # scope, name: each call gives its own
    local_keys: dict[int, str] = field(default_factory=dict)  # rows of routines' own targets
    rows: dict[tuple[str, str], list[int]] = field(default_factory=lambda: defaultdict(list))  # (scope, name)
    known_here: dict[ToolAndFrame, ToolAndFrame] = field(
        default_factory=dict
    )  # as written, and what it means in this scope
    of_modules: dict[str, list[int]] = field(
        default_factory=lambda: defaultdict(list)
    )  # seen from all routines

    def enter_module(self, name: str) -> None:
        """Begin a module."""
        self._enter_scope(f"{name.lower()}/")

    def enter_routine(self, name: str) -> None:
        """Begin a routine, or leave one with an empty name."""
        self._enter_scope(f"{self.scope.partition('/')[0]}/{name.lower()}")

    def _enter_scope(self, scope: str) -> None:
        self.scope = scope
        self.known_here.clear()

    def declare_parameter(self, name: str) -> None:
        """Note a routine's parameter, which hides a target, a tool or a work object of its name."""
        self.parameters.add((self.scope, name.lower()))
        self.known_here.clear()
        self.declare_without_row(name)

    def declare_without_row(self, name: str) -> None:
        """Note a target whose coordinates are not in the file."""
        self.rows.setdefault((self.scope, name.partition("{")[0].lower()), [])

    def declare_target(self, name: str, row: int, *, local: bool = False) -> None:
        """Note a declared target; an element stands for its array, too."""
        name = name.lower()
        bare = name.partition("{")[0]
        self._note_key(row, self.scope, name)
        self.rows[self.scope, name].append(row)
        if bare != name:
            self.rows[self.scope, bare].append(row)
        if self.scope.endswith("/"):
            self.shown[bare] = self.shown.get(bare, False) or not local
            if not local:
                self.of_modules[bare].append(row)

    def assign(self, name: str, row: int) -> bool:
        """Note a value that is assigned to a declared target; all moves to the name go to it, too.

        False where the declaration is not in this file: who else goes there is unknown.
        """
        where, bare = self.find_declared(name, self.scope)
        if where in ("?", ""):
            return False
        self._note_key(row, where, name.lower())
        for key in {(where, bare), (where, name.lower())}:
            self.rows[key].append(row)
        return True

    def _note_key(self, row: int, scope: str, name: str) -> None:
        if not scope.endswith("/"):
            self.local_keys[row] = f"{scope}:{name}"

    def key_for_other_files(self, name: str, scope: str) -> str:
        """Return a name as other files' routines get it; "" for a place without numbers."""
        if (scope, name.partition("{")[0].lower()) in self.parameters:
            return PARAMETER + name.partition("{")[0].lower()
        if is_measured(name):
            return OWN + name
        where, bare = self.find_declared(name, scope)
        if where in ("", "?") or (where.endswith("/") and self.shown.get(bare, True)):
            return name
        if not self.rows_of(name, scope):
            return ""
        return OWN + (name.lower() if where.endswith("/") else f"{where}:{name.lower()}")

    def rows_of(self, name: str, scope: str) -> list[int]:
        """Return the rows that a name means in a scope: the routine's own, the module's, another module's."""
        module = scope.partition("/")[0]
        for where in (scope, f"{module}/"):
            rows = self.rows.get((where, name.lower()))
            if rows is not None:
                return rows
        bare = name.partition("{")[0].lower()
        if bare != name.lower():
            return self.rows_of(bare, scope)
        return self.of_modules.get(bare, [])

    def add_rows(self, scope: str, name: str, rows: Sequence[int]) -> bool:
        """Note more targets that a name stands for; tell whether there are new ones."""
        its = self.rows[scope, name]
        new = [row for row in dict.fromkeys(rows) if row not in set(its)]
        its += new
        return bool(new)

    def find_declared(self, name: str, scope: str) -> tuple[str, str]:
        """Return where the declaration stands that a scope sees, and the name; ``?`` for none in this file."""
        bare = name.partition("{")[0].lower()
        module = f"{scope.partition('/')[0]}/"
        if is_measured(bare):
            return module, bare
        for where in (scope, module):
            if (where, bare) in self.rows:
                return where, bare
        return ("" if bare in self.of_modules else "?"), bare

    def is_own(self, name: str, scope: str) -> bool:
        return self.find_declared(name, scope)[0] != "?"

    def parameters_of(self, scope: str) -> Set[str]:
        """Return the names of a routine's parameters, in small letters."""
        return {name for where, name in self.parameters if where == scope}
