"""Axes that a person names as the pendant of the robot does, where a setting counts them from 1."""

import re
from collections.abc import Mapping, Sequence
from typing import Any

from cellcal.calibration.errors import CellError
from cellcal.calibration.message import make_message
from cellcal.service.runs.settings_description import label_of, schema_of

_BETWEEN = re.compile(r"[\s,;]+")


def with_numbered_axes(
    procedure: str, settings: Mapping[str, object], names: Sequence[str]
) -> dict[str, object]:
    """Return the settings with each named axis as its number, counted from 1; what is no name stays as it is.

    ``names`` are those of the pendant, axis by axis. ``S, L`` may be one text, as ``--set axes_again=S,L`` gives it.

    Raises
    ------
    CellError
        No axis of this robot has that name.
    """
    fields = schema_of(procedure, {}).get("properties", {})
    by_name = {name.upper(): number for number, name in enumerate(names, 1)}
    by_name |= {f"J{number}": number for number in range(1, len(names) + 1) if f"J{number}" not in by_name}
    numbered = dict(settings)
    for setting in settings.keys() & fields.keys():
        if fields[setting].get("x-axes"):
            numbered[setting] = _number_axes(procedure, setting, settings[setting], by_name, names)
    return numbered


def _number_axes(
    procedure: str, setting: str, value: object, by_name: Mapping[str, int], names: Sequence[str]
) -> object:
    if isinstance(value, str):
        value = [word for word in _BETWEEN.split(value.strip("[] ")) if word]
    elif type(value) is int:  # one axis, as --set axes_again=2 gives it
        value = [value]
    if not isinstance(value, list | tuple):
        return value
    return [_number_axis(procedure, setting, each, by_name, names) for each in value]


def _number_axis(
    procedure: str, setting: str, axis: Any, by_name: Mapping[str, int], names: Sequence[str]
) -> Any:
    """Return the number of an axis; what is neither name nor number is left to the setting's own check."""
    if not isinstance(axis, str) and type(axis) is not int:
        return axis
    word = str(axis).strip("'\" ").upper()
    if word in by_name:
        return by_name[word]
    if word.isascii() and word.isdecimal() and 1 <= int(word) <= len(names):
        return int(word)
    raise CellError(
        make_message(
            "{label} ({setting}): this robot has no axis {axis}.",
            label=label_of(procedure, [setting]),
            setting=setting,
            axis=axis,
        ),
        remedy=make_message("Its axes are {names}.", names=", ".join(names)),
        code="usage",
    )
