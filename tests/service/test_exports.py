"""Tables that are taken away: every number comes back as it was, no text becomes a formula, nothing is left out."""

import asyncio
import csv
import importlib.util
import io
import json
import math
import random
import struct
import sys
import zipfile
from datetime import datetime
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st
from openpyxl import load_workbook

from cellcal.calibration.documents.json_text import parse_json
from cellcal.calibration.errors import CellError
from cellcal.procedures.run_history import EventKind
from cellcal.service.certificates.certificate import issue_certificate
from cellcal.service.certificates.points import list_readings
from cellcal.service.cli.app import run_command_line
from cellcal.service.configuration.cell_file import CellConfig
from cellcal.service.engineering.parameters.parameter_set import ParameterSet
from cellcal.service.engineering.parameters.parameter_set import ParameterValue as Parameter
from cellcal.service.engineering.parameters.parameter_sets import ParameterSets
from cellcal.service.exit_codes import ExitCode
from cellcal.service.export.cell_tables import history_table, parameters_table, points_table, runs_table
from cellcal.service.export.table_files import BOM, as_csv, as_csv_file, as_xlsx_file
from cellcal.service.export.tables import ExportColumn, ExportError, ExportTable, Value, unit_of
from cellcal.service.record.journal_files import lease_folder, open_journal
from cellcal.service.record.robot_lock import acquire_lease
from tests.procedures.certified_runs import cell_config, run_in
from tests.procedures.procedure_scenes import user_frame_scene
from tests.service.service_client import open_service_client

HOSTILE = (
    "=1+1", "+1", "-1", "@SUM(A1)", "\t=1", "\r=1", "\n=1", "\uff1d1", '=HYPERLINK("http://evil","x")',
    "=cmd|' /C calc'!A0", "a,b;c\td", 'say "=1"', "two\nlines", "李工", "#N/A", "1e5", "00123", "TRUE",
    "'=1", " =1", "é" * 3,
)  # fmt: skip
FLOATS = st.floats(allow_nan=False, allow_infinity=False)


def table_of(*rows: tuple[Value, ...]) -> ExportTable:
    return ExportTable("t", tuple(ExportColumn(f"c{k}", "m") for k in range(len(rows[0]))), tuple(rows))


def read_csv(content: bytes, delimiter: str = ",") -> list[list[str]]:
    text = content.decode("utf-8")
    assert text.startswith(BOM)
    return list(csv.reader(io.StringIO(text[1:], newline=""), delimiter=delimiter))


def read_xlsx(content: bytes) -> list[list[Any]]:
    book = load_workbook(io.BytesIO(content))  # formulas as formulas: data_only would hide them
    return [[cell.value for cell in row] for row in book.active.iter_rows()]


@given(st.lists(FLOATS, min_size=1, max_size=8))
def test_every_float_comes_back_from_csv(values: list[float]) -> None:
    got = [float(text) for text in read_csv(as_csv_file(table_of(tuple(values))))[2]]
    assert [struct.pack("d", value) for value in got] == [struct.pack("d", value) for value in values]


def test_every_float_comes_back_from_xlsx() -> None:
    rng = random.Random(7)
    bits = [struct.unpack("d", struct.pack("Q", rng.getrandbits(64)))[0] for _ in range(3000)]
    values = [value for value in bits if math.isfinite(value)] + [
        0.1 + 0.2,
        5e-324,
        -0.0,
        1.7976931348623157e308,
        1e22,
    ]
    got = [row[0] for row in read_xlsx(as_xlsx_file([table_of(*((value,) for value in values))]))[2:]]
    assert all(isinstance(value, float) for value in got)
    assert [struct.pack("d", value) for value in got] == [struct.pack("d", value) for value in values]


@pytest.mark.parametrize("delimiter", [",", ";", "\t"])
def test_no_text_is_a_formula_in_csv_and_numbers_stay_numbers(delimiter: str) -> None:
    content = as_csv_file(
        table_of(*((text, -1.5, True, None, -3) for text in HOSTILE)),
    )
    rows = read_csv(
        (BOM + as_csv(table_of(*((t, -1.5, True, None, -3) for t in HOSTILE)), delimiter)).encode(), delimiter
    )
    assert content.startswith(b"\xef\xbb\xbfc0,c1,")
    for text, row in zip(HOSTILE, rows[2:], strict=True):
        assert row[0] == (f"'{text}" if text[0] in "=+-@\t\r\n\uff1d" else text)
        assert row[1:] == ["-1.5", "true", "", "-3"]


def test_no_text_is_a_formula_in_xlsx_and_none_is_changed() -> None:
    content = as_xlsx_file([table_of(*((text, -1.5, True, None, -3) for text in HOSTILE))])
    with zipfile.ZipFile(io.BytesIO(content)) as parts:
        assert b"<f>" not in parts.read("xl/worksheets/sheet1.xml")
    for text, row in zip(HOSTILE, read_xlsx(content)[2:], strict=True):
        assert row == [text.replace("\r", "\n"), -1.5, True, None, -3]  # XML knows one end of a line


def test_names_of_columns_are_text_too_and_what_xml_cannot_hold_is_seen_to_be_missing() -> None:
    table = ExportTable("a/b:[c]" * 9, (ExportColumn("=1+1", "@x"),), (("a\x00b\x1b[31m",), ("x" * 40_000,)))
    assert read_csv(as_csv_file(table))[:2] == [["'=1+1"], ["'@x"]]
    rows = read_xlsx(as_xlsx_file([table]))
    assert rows[:3] == [["=1+1"], ["@x"], ["a\ufffdb\ufffd[31m"]]
    assert len(rows[3][0]) == 32_767
    assert rows[3][0].endswith("(cut)")
    with zipfile.ZipFile(io.BytesIO(as_xlsx_file([table]))) as parts:
        assert b"<f>" not in parts.read("xl/worksheets/sheet1.xml")


def test_what_is_no_fact_is_not_exported() -> None:
    for wrong in (math.nan, math.inf):
        for write in (as_csv_file, lambda table: as_xlsx_file([table])):
            with pytest.raises(ExportError):
                write(table_of((wrong,)))
    with pytest.raises(ExportError, match="no delimiter"):
        as_csv(table_of((1.0,)), "|")
    with pytest.raises(ValueError, match="as many cells"):
        table_of((1.0,), (1.0, 2.0))


@pytest.mark.parametrize(
    ("name", "unit"),
    [
        *(("readings_m", "m"), ("joints_rad", "rad"), ("speed_rad_s", "rad/s"), ("value_rad_per_m", "rad/m")),
        *(("temperature_c", "°C"), ("settle_s", "s"), ("m", ""), ("step", ""), ("team", ""), ("axis", "")),
    ],
)
def test_units_are_what_names_say(name: str, unit: str) -> None:
    assert unit_of(name) == unit


def lived_in(folder: Path) -> tuple[CellConfig, str]:
    config = cell_config(folder)
    run_id = asyncio.run(run_in(config, user_frame_scene(), "three_point_frame")).run_id
    issue_certificate(config, run_id)
    values = (Parameter("a1", "m", 1e-4 / 3, 1e-5), Parameter("alpha1", "rad", -0.1 - 0.2))
    draft = ParameterSet("F-1", "m", "0", "2026-01-01T00:00:00Z", "=anna()", "test", values)
    sets = ParameterSets(folder / "parameter_sets")
    sets.save_draft(draft)
    sets.roll_back("F-1", 1, made_by="b", made_at="2026-01-02T00:00:00+00:00")
    return config, run_id


def test_every_number_of_the_journal_is_in_the_tables(tmp_path: Path) -> None:
    config, run_id = lived_in(tmp_path)
    with open_journal(config) as journal:
        taken = list_readings(journal.list_events(run_id), {})
    table_rows = read_csv(as_csv_file(points_table(config, "last")))
    assert len(table_rows) == 2 + len(taken) > 4
    for reading, row in zip(taken, table_rows[2:], strict=True):
        assert row[0] == reading["step"]
        written = sorted(float(cell) for cell in row[4:] if cell and cell[-1].isdecimal())
        assert written == sorted(_numbers_in(reading["value"]))
    assert {"m", "rad"} <= set(table_rows[1])
    run = dict(zip(*[read_csv(as_csv_file(runs_table(config)))[k] for k in (0, 2)], strict=True))
    assert (run["run_id"], run["state"], run["robot_serial"]) == (run_id, "passed", "F-1")
    assert run["begun_by"] == "anna"
    figures = read_csv(as_csv_file(history_table(config)))
    assert float(figures[2][6]) >= 0.0
    sets = read_xlsx(as_xlsx_file([parameters_table(config, "F-1")]))
    assert [row[1] for row in sets[2:]] == [1, 1, 2, 2]
    assert [row[10] for row in sets[2:4]] == [1e-4 / 3, -0.1 - 0.2]
    assert sets[2][3] == "=anna()"
    assert len(parameters_table(config, "F-1", 2).rows) == 2
    for wrong in (lambda: points_table(config, "none"), lambda: parameters_table(config, "x")):
        with pytest.raises(CellError):
            wrong()


def test_a_run_that_goes_on_in_another_process_is_running(tmp_path: Path) -> None:
    config, run_id = lived_in(tmp_path)
    with open_journal(config) as journal:
        started = next(event for event in journal.list_events(run_id) if event.kind == EventKind.STARTED)
        journal.append("open-1", EventKind.STARTED, parse_json(started.body))
    assert [row[6] for row in runs_table(config).rows] == ["passed", "interrupted"]
    with acquire_lease(lease_folder(config), "F-1", "a run (open-1)"):
        assert [row[6] for row in runs_table(config).rows] == ["passed", "running"]


def _numbers_in(value: Any) -> list[float]:
    """Return every number of a JSON value."""
    if isinstance(value, dict | list):
        parts = value.values() if isinstance(value, dict) else value
        return [number for part in parts for number in _numbers_in(part)]
    return [float(value)] if isinstance(value, int | float) and not isinstance(value, bool) else []


def test_the_command(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    config, _ = lived_in(tmp_path)
    cell, out = str(config.path), tmp_path / "points.xlsx"
    assert run_command_line(["export", "points", cell, "--out", str(out)]) == 0
    assert read_xlsx(out.read_bytes())[0][:2] == ["step", "at_utc"]
    capsys.readouterr()
    assert run_command_line(["export", "runs", cell, "--delimiter", ";"]) == 0
    assert capsys.readouterr().out.startswith("run_id;procedure;")
    assert run_command_line(["export", "history", cell, "--out", str(tmp_path / "h.csv")]) == 0
    assert read_csv((tmp_path / "h.csv").read_bytes())[0][4] == "figure"
    assert (
        run_command_line(["export", "parameters", cell, "F-1", "-o", str(tmp_path / "p.txt")])
        == ExitCode.USAGE
    )


def test_without_its_library_mcap_is_refused_with_the_cure(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    config, _ = lived_in(tmp_path)
    monkeypatch.setitem(sys.modules, "mcap.writer", None)  # as where the extra is not installed
    out = tmp_path / "run.mcap"
    assert run_command_line(["export", "mcap", str(config.path), "--out", str(out)]) == ExitCode.USAGE
    assert "cellcal[mcap]" in capsys.readouterr().err
    assert not out.exists()


def test_with_its_library_a_run_is_read_back_from_mcap(tmp_path: Path) -> None:
    if importlib.util.find_spec("mcap") is None:
        print("mcap is not installed here: reading a run back from MCAP was not tried.")
        return
    config, run_id = lived_in(tmp_path)
    out = tmp_path / "run.mcap"
    assert run_command_line(["export", "mcap", str(config.path), "--out", str(out)]) == 0
    with open_journal(config) as journal:
        events = journal.list_events(run_id)
    with out.open("rb") as file:
        reader = importlib.import_module("mcap.reader").make_reader(file, validate_crcs=True)
        messages = [
            (channel.topic, message.log_time, json.loads(message.data))
            for _, channel, message in reader.iter_messages()
        ]
    assert [body["seq"] for topic, _, body in messages if topic == "/events"] == [
        event.seq for event in events
    ]
    assert [body["body"] for topic, _, body in messages if topic == "/events"] == [
        json.loads(e.body) for e in events
    ]
    taken = list_readings(events, {})
    assert [body["value"] for topic, _, body in messages if topic == "/readings"] == [
        one["value"] for one in taken
    ]
    times = [time_ns for _, time_ns, _ in messages]
    assert times == sorted(times)
    first = datetime.fromisoformat(events[0].wall_utc)
    assert abs(times[0] / 1e9 - first.timestamp()) < 1e-3


async def test_the_routes(tmp_path: Path) -> None:
    async with open_service_client(tmp_path, people=False) as service_client:
        await service_client.from_console()
        for path, kind in (("runs.csv", "text/csv"), ("history.xlsx", "spreadsheetml")):
            answer = await service_client.client.get(f"/api/exports/{path}")
            assert answer.status_code == 200
            assert kind in answer.headers["content-type"]
            assert answer.headers["content-disposition"] == f'attachment; filename="{path}"'
        assert (await service_client.client.get("/api/exports/runs.pdf")).status_code in (404, 422)
        for missing in ("runs/none/points.csv", "parameters/none.csv", "parameters/..%2f..%2fx.csv"):
            assert (await service_client.client.get(f"/api/exports/{missing}")).status_code in (404, 422)
