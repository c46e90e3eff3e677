"""Places that routines get as parameters, and what their calls pass for these."""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import NamedTuple

PARAMETER = "\0"  # begins the name of a tool or frame that a routine's caller gives
OWN = "\1"  # begins the name of a place that only the calling file sees, as its positions are keyed

UNCERTAIN = "\2"  # begins what may be the name of a tool, or nothing: the use tells of a frame only


class ParameterUse(NamedTuple):
    """The tool and frame of a routine's moves to a parameter, None where its file does not say."""

    tool: str | None
    frame: str | None
    why: str = ""  # why they cannot be determined; "" where they can
    routine: str = ""  # whose callers and called routines may set others
    file: str = ""  # of that routine, where it is not the one that gets the place


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
    parts: tuple[str, ...] = ()  # for the arguments that are a component of data: the name of the data
    stated: ParameterUse | None = None  # the tool and frame that the call itself names beside places
    references: tuple[
        str, ...
    ] = ()  # data that it passes so that a routine may set them, where this is not known
    of_copy: bool = False  # it passes a copy of the named data: what is done to it counts for moves only

    @property
    def passes_on(self) -> bool:
        """Return whether a routine passes what it gets itself."""
        names = (*self.arguments, *self.parts, *self.options.values())
        return any(name.startswith(PARAMETER) for name in names)

    @property
    def caller(self) -> str:
        """Return the routine that calls."""
        return self.scope.rpartition("/")[2]

    def with_sources(self, sources: Sequence[Iterable[str]]) -> Iterator["RoutineCall"]:
        """Yield the call as if it passed the data themselves whose copies its arguments, in this order, are."""
        for at, some in enumerate(sources):
            for source in some:
                arguments = (*self.arguments[:at], source, *self.arguments[at + 1 :])
                yield self._replace(
                    arguments=arguments, options={}, parts=(), stated=None, references=(), of_copy=True
                )

    def data_of_parameter(self, parameters: Sequence["RoutineParameter"], name: str) -> str:
        """Return the data of which a parameter gets the whole or a component; "" for nothing that has a name."""
        required = [one.name for one in parameters if not one.optional]
        part = "".join(self.parts[required.index(name) :][:1]) if name in required else ""
        return part or self.argument_for(parameters, name)

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
    """The use that a routine makes of places that it gets as parameters."""

    parameters: tuple[RoutineParameter, ...]
    uses: Mapping[str, frozenset[ParameterUse]]  # of its moves, by parameter
    written: frozenset[str] = frozenset()  # parameters that it gives a value, for its caller too
    shown: bool = True  # other files may call it

    def passed_uses(self, call: RoutineCall) -> Iterator[tuple[str, ParameterUse]]:
        """Yield the names that a call passes, and how the routine goes there."""
        for name, some in self.uses.items():
            passed = call.argument_for(self.parameters, name)
            for use in some if passed else ():
                tool, frame = (call.frame_for(self.parameters, one) for one in use[:2])
                is_lost = use.tool and use.frame and not (tool and frame)
                yield passed, use._replace(tool=tool, frame=frame, why="" if is_lost else use.why)

    def passed_values(self, call: RoutineCall) -> Iterator[str]:
        """Yield the names of data that the routine gives a value, or a component's, where it is called so."""
        for name in () if call.of_copy else sorted(self.written):
            if passed := call.data_of_parameter(self.parameters, name):
                yield passed
