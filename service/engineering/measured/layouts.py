"""A file that says how measurements are written: columns, units, conventions, where guessing is not enough."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from cellcal.calibration.documents import DocumentError
from cellcal.calibration.documents.plain_files import read_plain_text
from cellcal.calibration.documents.toml_text import parse_toml
from cellcal.calibration.message import make_message
from cellcal.service.engineering.measured.measurements import Measurements, ReadOptions
from cellcal.service.engineering.measured.table import MeasurementError
from cellcal.service.files import missing_file_words

_COLUMNS = ("joints", "position", "rotation", "length", "controller", "group")
_UNITS = ("joints", "slides", "position", "rotation", "length", "controller")
_WORDS = ("convention", "sheet", "joint_coupling")


def layout_data(path: Path) -> dict[str, Any]:
    """Return what a layout file holds.

    Raises
    ------
    MeasurementError
        No such file, or no TOML.
    """
    if not path.is_file():
        why, remedy = missing_file_words(path)
        raise MeasurementError(why, remedy=remedy)
    try:
        return parse_toml(read_plain_text(path))
    except (OSError, DocumentError) as broken:
        raise MeasurementError(
            make_message("{path} is no TOML: {broken}.", path=path, broken=broken), remedy=_EXAMPLE
        ) from broken


def read_layout(path: Path) -> ReadOptions:
    """Read a layout file.

    Raises
    ------
    MeasurementError
        No such file, no TOML, or a key that no layout has.
    """
    data = layout_data(path)
    refuse_unknown(path, data, ("columns", "units", *_WORDS))
    columns, units = _read_table(path, data, "columns"), _read_table(path, data, "units")
    refuse_unknown(path, columns, _COLUMNS)
    refuse_unknown(path, units, _UNITS)
    words = {key: _read_word(path, key, data[key]) for key in _WORDS if key in data}
    return ReadOptions(
        columns={key: _read_names(path, key, value) for key, value in columns.items()},
        units={key: _read_word(path, key, value) for key, value in units.items()},
        convention=words.get("convention", ""),
        sheet=words.get("sheet"),
        joint_coupling=words.get("joint_coupling", ""),
    )


_EXAMPLE = 'Write such as `[columns]`, `joints = ["q1", "q2", …]`, `[units]`, `joints = "deg"`.'


def overlay_options(below: ReadOptions, above: ReadOptions) -> ReadOptions:
    """Return the options of a layout file with those of the command line over them."""
    return ReadOptions(
        {**below.columns, **above.columns},
        {**below.units, **above.units},
        above.convention or below.convention,
        above.sheet if above.sheet is not None else below.sheet,
        above.joint_coupling or below.joint_coupling,
        above.joints_file,
    )


def layout_document(found: Measurements, options: ReadOptions) -> dict[str, object]:
    """Return how a file was understood, as an object whose keys are those of a layout file."""
    layout = found.layout
    columns = {
        "joints": layout.as_typed(layout.joints),
        "position": layout.as_typed(layout.position),
        "rotation": layout.turn if found.convention else (),
        "length": (layout.length,) if layout.length else (),
        "controller": layout.controller,
        "group": (layout.group,) if layout.group else (),
    }
    named = {key: list(names) for key, names in columns.items() if names}
    return {
        "convention": found.convention or ("none" if layout.turn else ""),
        "sheet": options.sheet or "",
        "joint_coupling": options.joint_coupling or "controller",
        "columns": named,
        "units": {
            key: found.units[key] for key in _UNITS if key in found.units and key in (*named, "slides")
        },
    }


def layout_text(document: Mapping[str, Any]) -> str:
    """Return the text of a layout file."""
    lines = [f"{key} = {_quote_toml(document[key])}" for key in _WORDS if document[key]]
    for table in ("columns", "units"):
        lines += ["", f"[{table}]"]
        for key, value in document[table].items():
            words = [value] if isinstance(value, str) else value
            quoted = ", ".join(_quote_toml(word) for word in words)
            lines.append(f"{key} = {quoted}" if isinstance(value, str) else f"{key} = [{quoted}]")
    return "\n".join(lines).strip() + "\n"


def _quote_toml(text: str) -> str:
    escaped = text.replace("\\", "\\\\").replace('"', '\\"').replace("\t", "\\t").replace("\n", "\\n")
    return f'"{escaped}"'


def refuse_unknown(path: Path, found: Mapping[str, Any], valid_keys: tuple[str, ...]) -> None:
    """Refuse a key that is not among those known."""
    unknown = [key for key in found if key not in valid_keys]
    if unknown:
        raise MeasurementError(
            make_message("{path}: a layout knows no {key!r}.", path=path, key=unknown[0]),
            remedy=make_message("It knows {meanings}.", meanings=", ".join(valid_keys)),
        )


def _read_table(path: Path, data: Mapping[str, Any], key: str) -> Mapping[str, Any]:
    table = data.get(key, {})
    if not isinstance(table, dict):
        raise MeasurementError(
            make_message("{path}: {key} is no table.", path=path, key=key), remedy=_EXAMPLE
        )
    return table


def _read_word(path: Path, key: str, value: object) -> str:
    if not isinstance(value, str):
        raise MeasurementError(make_message("{path}: {key} is no text.", path=path, key=key), remedy=_EXAMPLE)
    return value


def _read_names(path: Path, key: str, value: object) -> tuple[str, ...]:
    names = [value] if isinstance(value, str) else value
    if not isinstance(names, list) or not all(isinstance(name, str) for name in names):
        raise MeasurementError(
            make_message("{path}: columns of {key} are no list of names.", path=path, key=key),
            remedy=_EXAMPLE,
        )
    return tuple(names)
