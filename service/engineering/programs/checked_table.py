"""Tables of a TOML file as strict pydantic models, and every fault of one as a sentence with its cure.

A type such as `Text` states what it allows in words; a fault names the table by its heading, the key, what is allowed
and what stands there. Numbers are finite, and ``true`` is none.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Annotated, Any, ClassVar, NoReturn, get_args, get_origin

from pydantic import BaseModel, ConfigDict, Field, ValidationError, WrapValidator
from pydantic_core import ErrorDetails, PydanticCustomError

from cellcal.calibration.message import make_message
from cellcal.service.configuration.device_keys import close_key

_LONGEST_VALUE = 80  # characters of a wrong value in a sentence
_SENTENCE, _VALUE, _REMEDY = "sentence", "value", "remedy"  # of the context of a fault


class CheckedTable(BaseModel):
    """A table of the file: unknown keys are refused, for a misspelled limit is no limit."""

    model_config = ConfigDict(frozen=True, extra="forbid", strict=True, allow_inf_nan=False)
    missing_remedies: ClassVar[Mapping[str, str]] = {}  # by key: what to write where it is missing

    @property
    def is_empty(self) -> bool:
        """Whether no key is written in the table."""
        return not self.model_fields_set


@dataclass(frozen=True, slots=True)
class TableFault:
    """One fault of a file."""

    heading: str  # of the table, as the file writes it; empty at the top
    sentence: str
    remedy: str = ""

    @property
    def text(self) -> str:
        """Return the table's heading and the sentence."""
        if not self.heading:
            return self.sentence
        return make_message("{heading}: {sentence}", heading=self.heading, sentence=self.sentence)


def refuse_value(sentence: str, remedy: str = "") -> NoReturn:
    """Refuse a value or a table from inside a pydantic validator.

    Raises
    ------
    PydanticCustomError
        Always; `table_faults` takes sentence and remedy from it.
    """
    raise PydanticCustomError("refused", "{sentence}", {_SENTENCE: sentence, _REMEDY: remedy})


def allow_only(sentence: str, remedy: str = "") -> WrapValidator:
    """Return the validator of a type whose wrong values are refused with "KEY sentence, not VALUE."."""

    def check(value: Any, validate: Callable[[Any], Any]) -> Any:
        try:
            return validate(value)
        except ValidationError:
            raise PydanticCustomError(
                "kind",
                "{sentence}",
                {_SENTENCE: sentence, _VALUE: _shorten_value(value), _REMEDY: remedy},
            ) from None

    return WrapValidator(check)


Text = Annotated[str, Field(min_length=1), allow_only("is a text in quotes")]
Number = Annotated[float, allow_only("is a finite number")]
NonNegative = Annotated[float, Field(ge=0), allow_only("is a finite number, not below zero")]
Numbers = Annotated[list[float], allow_only("is a list of finite numbers")]
Triple = Annotated[
    list[float], Field(min_length=3, max_length=3), allow_only("is a list of 3 finite numbers")
]
Quadruple = Annotated[
    list[float], Field(min_length=4, max_length=4), allow_only("is a list of 4 finite numbers")
]


def table_faults(
    error: ValidationError, model: type[CheckedTable], data: Mapping[str, Any]
) -> list[TableFault]:
    """Return every fault of a document that a model refuses; a remedy of several stands behind the last."""
    found = [_fault_of(each, model, data) for each in error.errors(include_url=False)]
    last = {fault.remedy: at for at, fault in enumerate(found)}
    return [
        fault if last[fault.remedy] == at else replace(fault, remedy="") for at, fault in enumerate(found)
    ]


def _fault_of(error: ErrorDetails, model: type[CheckedTable], data: Mapping[str, Any]) -> TableFault:
    context, place = error.get("ctx", {}), error["loc"]
    if error["type"] == "refused":  # by a table: it names its keys itself
        return TableFault(_heading_of(place, data), context[_SENTENCE], context[_REMEDY])
    key, table = str(place[-1]) if place else "", _table_at(model, place[:-1])
    heading = _heading_of(place[:-1], data)
    if error["type"] == "kind":
        sentence = make_message(
            "{key} {is_allowed}, not {value}.", key=key, is_allowed=context[_SENTENCE], value=context[_VALUE]
        )
        return TableFault(heading, sentence, context[_REMEDY])
    if error["type"] == "missing":
        return TableFault(
            heading, make_message("{name} is missing.", name=key), table.missing_remedies.get(key, "")
        )
    if error["type"] == "extra_forbidden":
        return TableFault(heading, *unknown_key(key, tuple(table.model_fields)))
    if error["type"] == "list_type":
        return TableFault(
            heading,
            make_message("{key} is a list of tables.", key=key),
            make_message("Begin each with [[{key}]].", key=key),
        )
    return TableFault(
        heading,
        make_message("{key} is a table, written {heading}.", key=key, heading=_heading_of(place, data)),
    )


def unknown_key(key: str, known: Sequence[str]) -> tuple[str, str]:
    """Return that a key is unknown, with the one that was meant, and as the remedy what is known."""
    close = close_key(key, known)
    return (
        make_message("unknown {key}; did you mean {close!r}?", key=key, close=close)
        if close
        else make_message("unknown {key}.", key=key),
        make_message("Known here: {keys}.", keys=", ".join(sorted(known))),
    )


def _heading_of(place: Sequence[int | str], data: Mapping[str, Any]) -> str:
    """Return the heading of a table: ``[tools.1.real]``, or ``[[track]] 2 (rail)`` of one in a list."""
    if len(place) > 1 and isinstance(place[1], int):
        number = place[1]
        name = data[str(place[0])][number].get("name")
        named = f" ({name})" if isinstance(name, str) and name else ""
        return " ".join((f"[[{place[0]}]] {number + 1}{named}", *map(str, place[2:])))
    return f"[{'.'.join(map(str, place))}]" if place else ""


def _table_at(model: type[CheckedTable], place: Sequence[int | str]) -> type[CheckedTable]:
    """Return the model of the table at a place of a document."""
    parts = iter(place)
    for part in parts:
        annotation = model.model_fields[str(part)].annotation
        model = next(_models_in(annotation), model)
        if any(get_origin(each) in (dict, list) for each in (annotation, *get_args(annotation))):
            next(parts, None)  # the name or the number of one of several tables
    return model


def _models_in(annotation: Any) -> Iterator[type[CheckedTable]]:
    if isinstance(annotation, type) and issubclass(annotation, CheckedTable):
        yield annotation
    for part in get_args(annotation):
        yield from _models_in(part)


def _shorten_value(value: Any) -> str:
    text = repr(value)
    return text if len(text) <= _LONGEST_VALUE else f"{text[:_LONGEST_VALUE]}…"
