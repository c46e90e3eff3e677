"""What a page is told of a file's columns when its measurements fit no robot: how they were read."""

import json
from pathlib import Path

import numpy as np
import pytest

from cellcal.calibration.errors import CellError
from cellcal.service.engineering.identification.jobs import work
from cellcal.service.engineering.measured.measurements import ReadOptions

HEADINGS = ["J1_deg", "J2_deg", "J3_deg", "J4_deg", "J5_deg", "J6_deg", "x_mm", "y_mm", "z_mm"]


def _write_rows(path: Path) -> None:
    rows = np.random.default_rng(3).uniform(-60.0, 60.0, (12, 9))
    np.savetxt(path, rows, delimiter=",", fmt="%.3f", header=",".join(HEADINGS), comments="")


def test_columns_of_a_file_that_does_not_fit_are_told(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    _write_rows(tmp_path / "rows.csv")
    work._write_understood(tmp_path / "rows.csv", "fanuc_m6ib", ReadOptions())
    understood = json.loads(capsys.readouterr().out)["understood"]
    assert understood["columns"] == {"joints": HEADINGS[:6], "position": HEADINGS[6:]}
    assert understood["units"]["joints"] == "deg"


def test_a_file_that_cannot_be_read_adds_nothing_to_its_fault(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "rows.csv").write_text("one,two\n1,2\n", encoding="utf-8")
    work._write_understood(tmp_path / "rows.csv", "fanuc_m6ib", ReadOptions())
    assert capsys.readouterr().out == ""


def test_the_fault_stays_the_fault(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(*_: object) -> None:
        raise CellError("they do not fit")

    sources = tmp_path / work.SOURCES
    sources.mkdir()
    _write_rows(sources / "rows.csv")
    written: list[dict[str, object]] = []
    monkeypatch.setattr(work, "identify_file", refuse)
    monkeypatch.setattr(work, "write_message", lambda **words: written.append(words))
    request = work.JobRequest.model_validate(
        {"file": "rows.csv", "model": "fanuc_m6ib", "wishes": {}, "described": False}
        | dict.fromkeys(("joints", "check", "layout", "serial", "who", "at_utc"), "")
    )
    with pytest.raises(CellError, match="do not fit"):
        work._identify_one_device(tmp_path, request, None)  # type: ignore[arg-type]
    assert [list(each) for each in written] == [["headings"], ["understood"]]
