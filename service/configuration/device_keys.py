"""Which keys the device models of a union take: for a sentence about one that is wrong."""

import difflib
from collections.abc import Mapping, Sequence
from typing import Any

CHOICES = ("driver", "interface")  # keys that choose among device models


def wrong_choice(union: Any, context: Mapping[str, Any]) -> str:
    """Say that there is no such device model, and which there are."""
    key = str(context["discriminator"]).strip("'")
    problem = f"there is no {key} {context['tag']!r}" if "tag" in context else f"names no {key}"
    return f"{problem}; there are {', '.join(_valid_choices(union, key))}"


def _valid_choices(union: Any, key: str) -> tuple[str, ...]:
    """Return what may stand behind a key that chooses."""
    found = [str(name) for model in _device_models(union) for name in _literal_values(model, key)]
    return tuple(dict.fromkeys(found))


def keys_of(union: Any, table: Mapping[str, Any]) -> tuple[str, ...]:
    """Return the valid keys of the device model that a table chooses."""
    choices = [(key, table[key]) for key in CHOICES if key in table]
    for model in _device_models(union):
        if choices and all(value in _literal_values(model, key) for key, value in choices):
            return tuple(model.model_fields)
    return ("driver",)


def _literal_values(model: Any, key: str) -> tuple[Any, ...]:
    field = model.model_fields.get(key)
    return () if field is None else getattr(field.annotation, "__args__", ())


def _device_models(union: Any) -> list[Any]:
    """Return the models of a union, which may hold unions."""
    bare = getattr(union, "__origin__", union)
    if hasattr(bare, "model_fields"):
        return [bare]
    return [model for part in bare.__args__ for model in _device_models(part)]


def suggest_key(key: str, valid: tuple[str, ...]) -> str:
    """Say which key was meant, or which are valid."""
    close = close_key(key, valid)
    return f"did you mean {close!r}?" if close else f"valid here: {', '.join(sorted(valid))}"


def close_key(key: str, valid: Sequence[str]) -> str | None:
    """Return the valid key that is most like another one; None where none is."""
    return next(iter(difflib.get_close_matches(key, valid, n=1)), None)
