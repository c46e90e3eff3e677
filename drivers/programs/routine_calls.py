"""Places that routines get as parameters, and what their calls pass for these."""

from collections.abc import Iterator, Mapping, Sequence
from typing import NamedTuple

PARAMETER = "\0"  # begins the name of a tool or frame that a routine's caller gives


class RoutineParameter(NamedTuple):
    """One parameter of a routine."""

    name: str  # in small letters
    optional: bool
    is_target: bool
    by_value: bool  # what the routine does to it does not count for what is passed


class RoutineCall(NamedTuple):
    """A call, and what it passes: names of data, "" for anything else."""

    scope: str  # where it stands
    routine: str  # in small letters
    arguments: tuple[str, ...]  # for the parameters that are not optional, in order
    options: Mapping[str, str]  # for optional ones, by name in small letters

    def argument_for(self, parameters: Sequence[RoutineParameter], name: str) -> str:
        """Return what is passed for a parameter; "" for nothing that has a name."""
        required = [one.name for one in parameters if not one.optional]
        if name in required:
            return "".join(self.arguments[required.index(name) :][:1])
        return self.options.get(name, "")

    def frame_for(self, parameters: Sequence[RoutineParameter], name: str | None) -> str | None:
        """Return the tool or frame that a routine's ``name`` stands for; None where that cannot be told."""
        if name is None or not name.startswith(PARAMETER):
            return name
        passed = self.argument_for(parameters, name.removeprefix(PARAMETER))
        return passed if passed and "{" not in passed else None


class RoutineTargets(NamedTuple):
    """What a routine does to places that it gets as parameters."""

    parameters: tuple[RoutineParameter, ...]
    uses: Mapping[str, frozenset[tuple[str | None, str | None]]]  # tool and frame of its moves, by parameter

    def passed_uses(self, call: RoutineCall) -> Iterator[tuple[str, str | None, str | None]]:
        """Yield the names that a call passes, and the tool and frame that the routine goes there with."""
        for name, some in self.uses.items():
            passed = call.argument_for(self.parameters, name)
            for tool, frame in some if passed else ():
                yield passed, call.frame_for(self.parameters, tool), call.frame_for(self.parameters, frame)
