"""The configuration models of the drivers that a cell file may name."""

from typing import Any, get_args


def models_of(union: Any) -> set[Any]:
    """Return the configuration models of a union, which may hold unions."""
    if isinstance(union, type):
        return {union}
    return {model for part in get_args(union) if not _is_note(part) for model in models_of(part)}


def _is_note(part: Any) -> bool:
    return type(part).__name__ == "FieldInfo"
