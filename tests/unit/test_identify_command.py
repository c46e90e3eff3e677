"""``cellcal identify`` as people call it: verdicts and exit codes, subsets, points asked for, files that lie."""

import csv
import json

import numpy as np
import pytest

from cellcal.calibration.arm.kinematics import load_model
from cellcal.service.cli.app import run_command_line
from cellcal.service.engineering.measured.measurements import ReadOptions, read_measurements
from tests.unit.helpers.simulated_arm import tracker_points, wire_lengths
from tests.unit.test_identify_report import file_of


@pytest.fixture(scope="module")
def points_file(tmp_path_factory):
    return file_of(tracker_points("ur10", 120), tmp_path_factory.mktemp("points") / "points.csv")


def run_identify(capsys, path, *options):
    code = run_command_line(["identify", str(path), "--robot", "ur10", *options])
    return code, capsys.readouterr()


def predict_at(capsys, path, *options):
    code, output = run_identify(capsys, path, *options, "--json")
    return code, json.loads(output.out)


@pytest.mark.parametrize(
    ("limit", "verdict", "code"), [("0.5mm", "pass", 0), ("20um", "fail", 3), ("0.00012m", "undecided", 3)]
)
def test_held_out_errors_are_judged_with_a_guard_band(points_file, capsys, limit, verdict, code):
    ended, found = predict_at(capsys, points_file, "--level", "2", "--train-rows", "100", "--limit", limit)
    error = found["verdicts"]["error"]
    if verdict == "undecided":
        # Whatever the figure is, a limit beside it proves nothing.
        beside = f"{error['value'] * 1e3:.6f}mm"
        ended, found = predict_at(
            capsys, points_file, "--level", "2", "--train-rows", "100", "--limit", beside
        )
        error = found["verdicts"]["error"]
    assert error["verdict"] == verdict
    assert ended == code
    assert error["guard_band"] > error["standard_uncertainty"] > 0


def test_offsets_are_accepted_or_the_refusal_states_what_is_missing(points_file, capsys):
    options = ("--level", "2", "--accept-offset-sd", "0.02deg")
    ended, output = run_identify(capsys, points_file, *options, "--accept-offsets", "J2 offset")
    assert ended == 0
    assert "PASS standard deviations of joint offsets" in output.out
    ended, output = run_identify(capsys, points_file, *options)
    assert ended == 3
    assert "not reachable with this set-up" in output.out


@pytest.mark.parametrize(
    "options",
    [
        ("--level", "9"),
        ("--free", "J9 offset"),
        ("--limit", "0.5"),
        ("--limit=-1mm",),
        ("--accept-offset-sd", "nan deg"),
        ("--start", "nowhere.toml"),
        ("--start", "previous"),
        ("--residual-model", "--level", "17"),
    ],
)
def test_wrong_words_end_with_usage_and_what_to_do(points_file, capsys, options):
    ended, output = run_identify(capsys, points_file, *options)
    assert ended == 2
    assert "What to do" in output.err


def test_an_earlier_report_lets_one_offset_be_found_again_from_few_rows(points_file, tmp_path, capsys):
    _, before = predict_at(capsys, points_file, "--level", "2")
    report = tmp_path / "before.json"
    report.write_text(json.dumps(before), encoding="utf-8")
    few = file_of(tracker_points("ur10", 120), tmp_path / "few.csv", slice(0, 5))
    ended, found = predict_at(capsys, few, "--start", str(report), "--free", "J2 offset")
    assert ended == 0
    free = [p["name"] for p in found["parameters"] if not p["held"]]
    assert free == ["J2 offset"]
    values = [{p["name"]: p["value"] for p in document["parameters"]} for document in (before, found)]
    assert values[0].keys() == values[1].keys()
    assert values[1]["J2 offset"] == pytest.approx(values[0]["J2 offset"], abs=1e-4)
    assert values[1]["J3 a"] == values[0]["J3 a"]
    assert found["start"] == "the report before.json"


def test_a_stored_set_is_the_start_and_its_held_values_go_into_the_next_version(
    points_file, tmp_path, capsys
):
    store = ("--save", str(tmp_path / "sets"), "--serial", "U1", "--by", "me")
    assert run_identify(capsys, points_file, "--level", "2", *store)[0] == 0
    ended, found = predict_at(capsys, points_file, "--start", "previous", "--free", "offsets", *store)
    assert ended == 0
    assert "places" in {lint["code"] for lint in found["lints"]}
    assert found["start"] == "version 1 of robot U1"
    second = (tmp_path / "sets" / "U1" / "v0002.toml").read_text(encoding="utf-8")
    assert "J3 a" in second


def test_a_report_of_another_robot_is_no_start(points_file, tmp_path, capsys):
    _, before = predict_at(capsys, points_file, "--level", "1")
    report = tmp_path / "before.json"
    report.write_text(json.dumps({**before, "robot": "ur5"}), encoding="utf-8")
    assert run_identify(capsys, points_file, "--start", str(report))[0] == 2
    report.write_text("[]", encoding="utf-8")
    assert run_identify(capsys, points_file, "--start", str(report))[0] == 2


def test_points_that_are_asked_for_come_with_their_uncertainty(points_file, tmp_path, capsys):
    where, out = tmp_path / "where.csv", tmp_path / "out.csv"
    where.write_text(
        "q1_deg,q2_deg,q3_deg,q4_deg,q5_deg,q6_deg\n0,-60,60,10,20,30\n300,-60,60,10,20,30\n",
        encoding="utf-8",
    )
    options = ("--level", "2", "--at", str(where), "--at-csv", str(out), "--dh")
    ended, found = predict_at(capsys, points_file, *options)
    assert ended == 0
    inside, beyond = found["at"]["points"]
    assert 0 < inside["sigma_m"] < 2e-4
    # A radius in space: 2.80 deviations of a coordinate for three alike, where each of them alone has 1.96.
    assert inside["expanded_m"] == pytest.approx(2.8 * max(inside["sigmas_m"]), rel=0.15)
    assert inside["expanded_m"] > 2 * inside["parameters_expanded_m"] > 0
    statement = " ".join(found["at"]["statement"])
    assert "in space" in statement
    assert "Not covered: another payload, another temperature" in statement
    assert beyond["extrapolated"]
    assert not inside["extrapolated"]
    with out.open(encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    assert float(rows[0]["sigma_mm"]) == pytest.approx(inside["sigma_m"] * 1e3, abs=1e-4)
    assert [row["extrapolated"] for row in rows] == ["no", "yes"]
    assert [row["far_from_rows"] for row in rows] == ["no", "yes"]
    assert {"J2 beta", "J4 d"} <= {entry["name"] for entry in found["dh"]["entries"]}
    assert run_identify(capsys, points_file, *options)[0] == 2  # no file is written over


def spoil_column(simulated, path, column, number):
    lines = file_of(simulated, path).read_text(encoding="utf-8").splitlines()
    cells = lines[7].split(",")
    cells[column] = number
    lines[7] = ",".join(cells)
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")
    return path


@pytest.mark.parametrize("number", ["1e308", "-1e308", "1e20", "1e12", "nan", "inf"])
@pytest.mark.parametrize("column", [2, -1])
@pytest.mark.parametrize("simulate", [tracker_points, wire_lengths])
def test_numbers_that_were_not_measured_never_reach_a_fit(simulate, column, number, tmp_path):
    path = spoil_column(simulate("ur10", 40), tmp_path / "wild.csv", column, number)
    found = read_measurements(path, load_model("ur10"), ReadOptions())
    assert 6 not in found.rows
    assert [row.row for row in found.rejected] == [6]
    assert len(found.observations) == 39


def test_a_number_that_was_not_measured_is_listed_with_its_row(tmp_path, capsys):
    path = spoil_column(tracker_points("ur10", 40), tmp_path / "wild.csv", -1, "1e308")
    ended, found = predict_at(capsys, path, "--level", "0")
    assert ended == 0
    (rejected,) = (row for row in found["rejected"] if row["row"] == 6)
    assert "marks a missing measurement" in rejected["reason"]
    assert np.isfinite(found["fit"]["rmse_m"])


def test_the_report_fits_a_narrow_terminal_and_shows_dh(points_file, capsys, monkeypatch):
    monkeypatch.setenv("COLUMNS", "80")
    ended, output = run_identify(capsys, points_file, "--level", "2", "--dh")
    assert ended == 0
    assert max(len(line) for line in output.out.splitlines()) <= 80
    assert "beta stands for d" in output.out
    assert "% is 2.0" in output.out or "% is 1.9" in output.out
