"""What is exported of a cell: runs, the figures they ended with, the readings of one, parameter sets."""

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from cellcal.service.certificates.points import list_readings
from cellcal.service.configuration.cell_file import CellConfig
from cellcal.service.engineering.parameters.parameter_sets import ParameterSets
from cellcal.service.export.tables import ExportColumn, ExportError, ExportTable, Value, unit_of
from cellcal.service.record.journal_files import lease_folder, open_journal
from cellcal.service.record.robot_lock import runs_under_way
from cellcal.service.record.run_store import RunStore, RunView

SETS = "parameter_sets"  # beside the cell file
_MOST_COLUMNS = 4000
_RUN = (
    "run_id",
    "procedure",
    "version",
    "robot_serial",
    "started_utc",
    "begun_by",
    "state",
    "word",
    "reason",
)
_FIGURE = ("run_id", "started_utc", "procedure", "robot_serial", "figure", "unit", "value")
_FIGURE_REST = ("standard_uncertainty", "coverage", "expanded_uncertainty", "limit", "decision")
_READING = ("step", "at_utc", "used", "reason")
_PARAMETER = ("robot_serial", "version", "made_at", "made_by", "source", "note", "rolls_back_to", "sha256")
_PARAMETER_REST = ("name", "unit", "value", "standard_uncertainty", "determined")


def runs_table(config: CellConfig) -> ExportTable:
    """Return every run, oldest first."""
    with open_journal(config) as journal:
        views = RunStore(journal).list_runs()
    under_way = runs_under_way(lease_folder(config))
    rows = [
        (
            view.run_id, view.procedure, view.version, _robot_serial(view), view.started_utc, view.begun_by,
            view.state_seen(under_way), str((view.judgement or {}).get("word", "")), view.reason,
        )
        for view in views
    ]  # fmt: skip
    return ExportTable("runs", _plain_columns(_RUN), tuple(rows))


def history_table(config: CellConfig) -> ExportTable:
    """Return every figure that a run ended with, oldest first; the unit stands in its row."""
    with open_journal(config) as journal:
        views = RunStore(journal).list_runs()
    rows = [
        _figure_row(view, figure)
        for view in views
        for figure in (view.judgement or {}).get("characteristics", [])
    ]
    return ExportTable("history", _plain_columns((*_FIGURE, *_FIGURE_REST)), tuple(rows))


def points_table(config: CellConfig, run_id: str) -> ExportTable:
    """Return every reading of a run, used or not, with all numbers it holds; ``last`` is the newest run.

    Raises
    ------
    CellError
        There is no such run.
    """
    with open_journal(config) as journal:
        view, events = RunStore(journal).with_events(run_id)
    taken = [
        (reading, dict(_flatten_value(reading.get("value"))))
        for reading in list_readings(events, view.judgement)
    ]
    names = list(dict.fromkeys(name for _, flat in taken for name in flat))
    if len(names) > _MOST_COLUMNS:
        raise ExportError(
            f"the readings of {view.run_id} hold {len(names)} different numbers.",
            remedy="Take them from the certificate (JSON).",
        )
    columns = (
        *_plain_columns(_READING),
        *(ExportColumn(name, unit_of(name.rpartition(".")[2].partition("[")[0])) for name in names),
    )
    rows = [
        (
            reading["step"],
            reading["at_utc"],
            reading["used"],
            reading["reason"],
            *(flat.get(name) for name in names),
        )
        for reading, flat in taken
    ]
    return ExportTable("points", columns, tuple(rows))


def parameters_table(config: CellConfig, robot_serial: str, version: int | None = None) -> ExportTable:
    """Return every parameter of all versions of a robot's sets, or of one; the unit stands in its row.

    Raises
    ------
    CellError
        There is no such robot or version, or a set was changed after it was written.
    """
    sets = ParameterSets(Path(config.path).parent / SETS)
    found = sets.load_history(robot_serial) if version is None else (sets.load_set(robot_serial, version),)
    rows = [
        (*(getattr(one, key) for key in _PARAMETER), *(getattr(value, key) for key in _PARAMETER_REST))
        for one in found
        for value in one.values
    ]
    return ExportTable("parameters", _plain_columns((*_PARAMETER, *_PARAMETER_REST)), tuple(rows))


def _plain_columns(names: tuple[str, ...]) -> tuple[ExportColumn, ...]:
    return tuple(ExportColumn(name) for name in names)


def _figure_row(view: RunView, figure: Mapping[str, Any]) -> tuple[Value, ...]:
    head = (
        view.run_id,
        view.started_utc,
        view.procedure,
        _robot_serial(view),
        str(figure["name"]),
        str(figure["unit"]),
    )
    return (*head, figure["value"], *(figure.get(key) for key in _FIGURE_REST))


def _robot_serial(view: RunView) -> str:
    devices = view.cell.get("devices") or [{}]
    return str((devices[0].get("identity") or {}).get("serial", ""))


def _flatten_value(value: Any, name: str = "") -> Iterator[tuple[str, Value]]:
    """Yield every number and text of a JSON value under the path that leads to it; places count from 1."""
    if isinstance(value, Mapping):
        for key, part in value.items():
            yield from _flatten_value(part, f"{name}.{key}" if name else str(key))
    elif isinstance(value, list):
        for place, part in enumerate(value, 1):
            yield from _flatten_value(part, f"{name}[{place}]")
    elif value is not None:
        yield name or "value", value
