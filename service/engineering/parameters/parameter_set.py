"""One parameter set: values with uncertainties of one robot, where they come from, and the text of its file.

A file holds deviations from a nominal model in SI, their standard uncertainties, the hash of the version before, and
its own hash, which proves that nothing was changed.
"""

import hashlib
import json
import math
from dataclasses import dataclass
from typing import Any

from cellcal.calibration.documents import DocumentError
from cellcal.calibration.documents.toml_text import parse_toml
from cellcal.calibration.errors import CalibrationError
from cellcal.calibration.message import make_message
from cellcal.service.times import has_time_zone

FORMAT = 1
_SUFFIXES = {"rad": "_rad", "m": "_m", "rad/m": "_rad_per_m", "1": ""}
_HEADER = (
    "# Parameter set of one robot, written by cellcal: deviations from the nominal model, SI units.\n"
    "# Import a changed copy as a new version instead of editing: the hash would no longer fit.\n"
)
_WORDS = ("robot_serial", "model", "nominal_sha256", "made_at", "made_by", "source")
_OPTIONAL = ("note", "previous_sha256", "factory_hash")


class ParameterSetError(CalibrationError):
    """A parameter set is missing, damaged, or does not belong where it is."""

    code = "parameters"


@dataclass(frozen=True, slots=True)
class ParameterValue:
    """One deviation from nominal, with its standard uncertainty where known."""

    name: str
    unit: str  # rad | m | rad/m | 1
    value: float
    standard_uncertainty: float | None = None
    correlations: tuple[float, ...] = ()  # with the values before it in the set, from the first on
    determined: bool = True  # False: the measurement left it where it was assumed, and it is no result

    def __post_init__(self) -> None:
        spread = 0.0 if self.standard_uncertainty is None else self.standard_uncertainty
        if not all(-1.0 <= rho <= 1.0 for rho in self.correlations):
            raise ParameterSetError(
                make_message(
                    "{name}: a correlation is between -1 and 1",
                    name=self.name,
                )
            )
        if self.unit not in _SUFFIXES or not (
            math.isfinite(self.value) and math.isfinite(spread) and spread >= 0
        ):
            raise ParameterSetError(
                make_message(
                    "{name}: a value is finite, in rad, m, rad/m or 1",
                    name=self.name,
                )
            )


@dataclass(frozen=True, slots=True)
class ParameterSet:
    """One version. ``version`` 0 is a draft: the store numbers it."""

    robot_serial: str
    model: str
    nominal_sha256: str
    made_at: str  # ISO 8601
    made_by: str
    source: str
    values: tuple[ParameterValue, ...]
    note: str = ""
    factory_hash: str = ""  # by which ROS names the arm's own table
    version: int = 0
    previous_sha256: str = ""
    rolls_back_to: int = 0

    def __post_init__(self) -> None:
        try:
            "".join([getattr(self, key) for key in (*_WORDS, *_OPTIONAL)]).encode()
        except UnicodeEncodeError as broken:
            raise ParameterSetError("a parameter set holds text that cannot be written") from broken
        if not has_time_zone(self.made_at):
            raise ParameterSetError(
                make_message(
                    "made_at of a parameter set is {found}: it is no time with a time zone.",
                    found=repr(self.made_at[:60]),
                ),
                remedy="Write it as 2026-05-04T08:30:00+02:00.",
            )
        names = [value.name for value in self.values]
        if not names or len(set(names)) != len(names):
            raise ParameterSetError("a parameter set holds at least one parameter, and none twice")

    @property
    def sha256(self) -> str:
        """The hash that the file carries."""
        return hashlib.sha256(_hashed_text(self).encode()).hexdigest()

    def find_value(self, name: str) -> ParameterValue | None:
        """Return a value by name."""
        return next((value for value in self.values if value.name == name), None)


def to_text(parameter_set: ParameterSet) -> str:
    """Return the text of a file, with its hash."""
    head, tables = _hashed_text(parameter_set).split("\n[[parameter]]", maxsplit=1)
    return f'{head}sha256 = "{parameter_set.sha256}"\n\n[[parameter]]{tables}'


def parse_set(text: str, where: str = "parameter set") -> ParameterSet:
    """Read the text of a file and prove its hash.

    Raises
    ------
    ParameterSetError
        Not such a file, an unknown key, or changed since it was written.
    """
    try:
        data = parse_toml(text)
    except DocumentError as broken:
        raise ParameterSetError(
            make_message(
                "{where} is not a parameter set: {broken}",
                where=where,
                broken=broken,
            )
        ) from broken
    found = _from_data(data, where)
    if data.get("sha256") != found.sha256:
        raise ParameterSetError(
            make_message(
                "{where} was changed after it was written: its hash does not fit.",
                where=where,
            ),
            remedy="Restore it from a backup, or import the values as a new version.",
        )
    return found


def _from_data(data: dict[str, Any], where: str) -> ParameterSet:
    valid_keys = {*_WORDS, *_OPTIONAL, "format", "version", "rolls_back_to", "sha256", "parameter"}
    missing = {*_WORDS, "version", "sha256", "parameter"} - data.keys()
    if data.get("format") != FORMAT or missing or data.keys() - valid_keys:
        raise ParameterSetError(
            make_message(
                "{where} is not a parameter set of format {format}: missing {missing}, unknown {unknown}",
                where=where,
                format=FORMAT,
                missing=", ".join(sorted(missing)) or "none",
                unknown=", ".join(sorted(data.keys() - valid_keys)) or "none",
            )
        )
    words = {key: data.get(key, "") for key in (*_WORDS, *_OPTIONAL)}
    numbers = {"version": data["version"], "rolls_back_to": data.get("rolls_back_to", 0)}
    tables = data["parameter"]
    valid = all(isinstance(v, str) for v in words.values()) and all(type(v) is int for v in numbers.values())
    if not valid or not isinstance(tables, list) or not all(isinstance(t, dict) for t in tables):
        raise ParameterSetError(
            make_message(
                "{where}: a word, a number or a table is of the wrong kind",
                where=where,
            )
        )
    values = tuple(_read_value(table, where) for table in tables)
    return ParameterSet(values=values, **words, **numbers)


def _read_value(table: dict[str, Any], where: str) -> ParameterValue:
    for unit, suffix in _SUFFIXES.items():
        key, spread = f"value{suffix}", f"standard_uncertainty{suffix}"
        if {"name", key} <= table.keys() <= {"name", key, spread, "correlations", "determined"}:
            rho = table.get("correlations", [])
            numbers = [table[key], table.get(spread, 0.0), *(rho if isinstance(rho, list) else [None])]
            is_determined = table.get("determined", True)
            words = isinstance(table["name"], str) and isinstance(is_determined, bool)
            if words and all(type(v) in (int, float) for v in numbers):
                uncertainty = float(table[spread]) if spread in table else None
                return ParameterValue(
                    table["name"], unit, float(table[key]), uncertainty, tuple(map(float, rho)), is_determined
                )
    raise ParameterSetError(
        make_message(
            "{where}: a parameter has a name, a value and a standard uncertainty of one unit",
            where=where,
        )
    )


def _hashed_text(item: ParameterSet) -> str:
    """Return the text that is hashed: the file without its hash."""
    lines = [f"format = {FORMAT}", f"version = {item.version}"]
    lines += [f"{key} = {_quote_toml(getattr(item, key))}" for key in _WORDS]
    lines += [f"{key} = {_quote_toml(getattr(item, key))}" for key in _OPTIONAL if getattr(item, key)]
    if item.rolls_back_to:
        lines.append(f"rolls_back_to = {item.rolls_back_to}")
    tables = [_value_table(value) for value in item.values]
    return _HEADER + "\n".join(lines) + "\n" + "".join(tables)


def _value_table(value: ParameterValue) -> str:
    suffix = _SUFFIXES[value.unit]
    lines = [
        "",
        "[[parameter]]",
        f"name = {_quote_toml(value.name)}",
        f"value{suffix} = {float(value.value)!r}",
    ]
    if value.standard_uncertainty is not None:
        lines.append(f"standard_uncertainty{suffix} = {float(value.standard_uncertainty)!r}")
    if value.correlations:
        lines.append(f"correlations = [{', '.join(f'{rho:.9g}' for rho in value.correlations)}]")
    if not value.determined:
        lines.append("determined = false")
    return "\n".join(lines) + "\n"


def _quote_toml(text: str) -> str:
    """Return a TOML string; JSON's are, but for one control character that it does not escape."""
    return json.dumps(text, ensure_ascii=False).replace("\x7f", "\\u007f")
