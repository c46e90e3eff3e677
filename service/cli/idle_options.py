"""Options that nothing reads beside what else was asked for: refused, for one that is passed over looks followed."""

import inspect
from collections.abc import Callable, Collection, Iterator, Mapping
from dataclasses import dataclass, fields, is_dataclass
from typing import Any, get_args

from cyclopts import Parameter

from cellcal.calibration.errors import CellError


@dataclass(frozen=True, slots=True)
class OptionRule:
    """What options of a command need beside them, by the names of the command's arguments."""

    options: tuple[str, ...]
    needs: tuple[str, ...] = ()  # one of these must be given
    not_with: tuple[str, ...] = ()  # none of these may be given
    only_for: tuple[str, tuple[str, ...]] = ("", ())  # an argument, and its values that read the options


def refuse_idle_options(
    command: Callable[..., object], values: Mapping[str, Any], rules: Collection[OptionRule]
) -> None:
    """Refuse options that were given and that nothing would read.

    Parameters
    ----------
    command : function
        A command, whose defaults are what was not given.
    values : mapping
        Its arguments, as ``locals()`` in its first line.

    Raises
    ------
    CellError
        With every such option, and what it needs.
    """
    found = dict(_options_of(command, values))
    for rule in rules:
        idle = [found[name].text for name in rule.options if found[name].is_given]
        if not idle:
            continue
        names, have = " and ".join(idle), "has" if len(idle) == 1 else "have"
        if rule.needs and not any(found[name].is_given for name in rule.needs):
            needed = " or ".join(found[name].text for name in rule.needs)
            raise _idle_error(f"{names} {have} no effect without {needed}.")
        if stops := [found[name].text for name in rule.not_with if found[name].is_given]:
            raise _idle_error(f"{names} {have} no effect with {' and '.join(stops)}.")
        argument, taking = rule.only_for
        if argument and found[argument].value not in taking:
            chosen = f"{found[argument].text} {found[argument].value}"
            raise _idle_error(f"{names} {have} no effect with {chosen}.")


def _idle_error(sentence: str) -> CellError:
    return CellError(sentence, remedy="Leave out what is not meant.", code="usage")


@dataclass(frozen=True, slots=True)
class _Option:
    text: str  # as it is typed
    value: object
    is_given: bool


def _options_of(command: Callable[..., object], values: Mapping[str, Any]) -> Iterator[tuple[str, _Option]]:
    """Return the options by the names of their arguments; those of a class of options by its fields."""
    for name, parameter in inspect.signature(command).parameters.items():
        value = values[name]
        if is_dataclass(value):
            for field in fields(value):
                inner = getattr(value, field.name)
                yield field.name, _Option(_text_of(field.name, field.type), inner, inner != field.default)
        else:
            text = _text_of(name, parameter.annotation)
            yield name, _Option(text, value, value != parameter.default)


def _text_of(name: str, annotation: object) -> str:
    for word in get_args(annotation):
        if isinstance(word, Parameter) and word.name:
            return str(next(iter(word.name)))
    return f"--{name.replace('_', '-')}"
