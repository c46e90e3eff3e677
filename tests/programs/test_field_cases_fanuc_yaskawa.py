"""Inputs from the field, as people move them: ``cellcal program move FILE --project project.toml --offset …``."""

import json
from pathlib import Path
from typing import Any

import pytest

from cellcal.service.cli.program import program

CASES = Path(__file__).parents[1] / "data" / "field_cases"
OFFSET = "30,-20,5,0,0,30"


def move_file(name: str, out: Path, *options: str) -> tuple[int, dict[str, Any], bytes, bytes]:
    """Return the exit code, the report, and the file before and after."""
    file = CASES / name
    report = out / "report.json"
    words = ["move", str(file), "--project", str(file.parent / "project.toml"), "--offset", OFFSET]
    with pytest.raises(SystemExit) as ended:
        program([*words, "--out", str(out), "--json", str(report), *options])
    (program_report,) = json.loads(report.read_text(encoding="utf-8"))["programs"]
    code = ended.value.code
    assert isinstance(code, int)
    return code, program_report, file.read_bytes(), (out / file.name).read_bytes()


def record_text(data: bytes, name: str) -> bytes:
    """Return a position's record, or a job's row."""
    start = data.index(name.encode())
    return data[start : data.index(b"};" if name.startswith("P[") else b"\n", start)]


def test_an_increment_is_left_and_the_place_before_it_moves(tmp_path: Path) -> None:
    code, program_report, before, after = move_file("fanuc/inc_lift.LS", tmp_path)

    assert code == 4
    assert [point["status"] for point in program_report["points"]] == ["changed", "left"]
    assert "increment" in program_report["points"][1]["reason"]
    assert record_text(after, "P[2]{") == record_text(before, "P[2]{")


def test_an_offset_register_under_a_turn_is_a_finding_with_angle_and_distance(tmp_path: Path) -> None:
    code, program_report, _, _ = move_file("fanuc/offset_pr.LS", tmp_path)

    assert code == 4
    (finding,) = program_report["findings"]
    assert (finding["point"], finding["what"], finding["line"]) == ("P[1]", "Offset", 13)
    assert finding["angle_deg"] == pytest.approx(30.0)
    assert "30.00 deg" in finding["text"]
    assert "51.76 mm" in finding["text"]


@pytest.mark.parametrize(("joints", "status"), [("keep", "unchanged"), ("move", "changed")])
def test_joint_angles_stay_or_move_as_the_option_says(joints: str, status: str, tmp_path: Path) -> None:
    code, program_report, before, after = move_file("fanuc/joint_home.LS", tmp_path, "--joints", joints)

    assert code == 0
    assert [point["status"] for point in program_report["points"]] == [status, "changed"]
    assert (record_text(after, "P[1:") == record_text(before, "P[1:")) is (joints == "keep")


def test_no_half_of_a_rails_program_is_moved(tmp_path: Path) -> None:
    code, program_report, before, after = move_file("fanuc/track_e1.LS", tmp_path)

    assert code == 4
    assert [point["status"] for point in program_report["points"]] == ["left", "left"]
    assert after == before


def test_one_position_of_a_job_does_not_refuse_the_others(tmp_path: Path) -> None:
    code, program_report, before, after = move_file("yaskawa/one_point_refuses_all.JBI", tmp_path)

    assert code == 4
    assert {point["point"]: point["status"] for point in program_report["points"]} == {
        "P00000": "left",
        "P00001": "changed",
    }
    assert record_text(after, "P00000=") == record_text(before, "P00000=")
