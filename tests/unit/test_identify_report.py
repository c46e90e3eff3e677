"""The whole use case on small files: what is split, what is refused, what is drawn."""

import json

import numpy as np
import pytest

from cellcal.calibration.errors import CellError
from cellcal.service.cli.app import run_command_line
from cellcal.service.engineering.identification.identify import identify_file
from cellcal.service.engineering.identification.row_fit import IdentifyOptions
from cellcal.service.engineering.measured.table import MeasurementError
from tests.unit.helpers.simulated_arm import tracker_points, wire_lengths


def file_of(simulated, path, rows=slice(None)):
    observations = simulated.observations
    wire = observations.kind == "length"
    values = observations.lengths_m[:, None] if wire else observations.positions_m
    names = [*(f"q{i}" for i in range(1, 7)), *(["L"] if wire else ["x", "y", "z"])]
    table = np.concatenate([np.rad2deg(observations.joints_rad), values * 1e3], axis=1)[rows]
    lines = [",".join(names), *(",".join(f"{v:.7f}" for v in row) for row in table)]
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")
    return path


@pytest.fixture(scope="module")
def points_file(tmp_path_factory):
    return file_of(tracker_points("ur10", 160), tmp_path_factory.mktemp("points") / "points.csv")


def test_held_out_rows_are_exactly_the_others(points_file):
    report = identify_file(points_file, "ur10", IdentifyOptions(level=2, train_rows=100, seed=4))
    trained = set(np.sort(np.random.default_rng(4).permutation(160)[:100]))
    assert set(report.held_out_rows) == set(range(160)) - trained
    assert report.held_out.n == report.before.n == 60
    assert report.fit.n + len(report.rejected) == 100
    assert report.held_out.mean_m < 2e-4 < report.before.mean_m


@pytest.mark.parametrize("train_rows", [0, 160, 999])
def test_a_split_that_holds_nothing_out_is_refused(points_file, train_rows):
    with pytest.raises(MeasurementError, match="hold out"):
        identify_file(points_file, "ur10", IdentifyOptions(train_rows=train_rows))


def test_a_check_file_is_evaluated_with_frames_and_leakage_is_named(points_file, tmp_path):
    other = file_of(tracker_points("ur10", 160), tmp_path / "check.csv", slice(100, None))
    report = identify_file(points_file, "ur10", IdentifyOptions(level=2, check=other))
    assert report.check is not None
    assert report.check.n == 60
    assert report.check.mean_m < 2e-4
    assert "leakage" in {lint.code for lint in report.lints}


def test_check_rows_of_a_moved_device_are_named(points_file, tmp_path):
    simulated = tracker_points("ur10", 160, seed=1)
    simulated.observations.positions_m[:] += [0.0, 0.02, 0.0]
    report = identify_file(
        points_file, "ur10", IdentifyOptions(level=2, check=file_of(simulated, tmp_path / "c.csv"))
    )
    assert report.check is not None
    assert report.check.mean_m > 0.015
    assert "check_moved" in {lint.code for lint in report.lints}


def test_a_check_by_another_instrument_is_refused(points_file, tmp_path):
    other = file_of(wire_lengths("ur10", 40), tmp_path / "wire.csv")
    with pytest.raises(MeasurementError, match="not points"):
        identify_file(points_file, "ur10", IdentifyOptions(level=0, check=other))


def test_the_command_prints_one_object_and_draws(points_file, tmp_path, capsys):
    plots = tmp_path / "plots"
    code = run_command_line(
        ["identify", str(points_file), "--robot", "ur10", "--level", "2", "--plot", str(plots), "--json"]
    )
    assert code == 0
    found = json.loads(capsys.readouterr().out)
    assert found["level"] == 2
    assert found["rows"] == 160
    assert set(found["held_out"]) == {"n", "rmse_m", "mean_m", "p95_m", "max_m"}
    assert {item["parameter"] for item in found["not_identified"]} >= {"J1 offset"}
    assert {"overview.png", "workspace.svg", "correlations.png"} <= {path.name for path in plots.iterdir()}


def test_the_command_says_before_and_after_in_words(points_file, capsys):
    assert run_command_line(["identify", str(points_file), "--robot", "ur10", "--level", "1"]) == 0
    printed = capsys.readouterr().out
    assert "before" in printed
    assert "held out" in printed
    assert "not identified" in printed


@pytest.mark.parametrize(
    ("arguments", "code"),
    [
        (["nowhere.csv", "--robot", "ur10"], 2),
        (["{points}", "--robot", "ur99"], 2),
        (["{points}", "--robot", "ur10", "--columns", "joints"], 2),
        (["{points}", "--robot", "ur10", "--level", "7"], 2),
    ],
)
def test_what_cannot_be_done_ends_in_a_sentence_and_an_exit_code(points_file, arguments, code, capsys):
    assert run_command_line(["identify", *(a.format(points=points_file) for a in arguments)]) == code
    assert "What to do" in capsys.readouterr().err


@pytest.mark.parametrize("rows", [1, 4, 9])
@pytest.mark.parametrize("simulate", [tracker_points, wire_lengths])
def test_short_files_are_identified_or_refused_but_never_break(simulate, rows, tmp_path):
    path = file_of(simulate("ur10", 40), tmp_path / "short.csv", slice(0, rows))
    assert report_of(path)


def test_a_wire_with_as_many_rows_as_unknowns_is_identified(tmp_path):
    assert (
        json.loads(report_of(file_of(wire_lengths("ur10", 40), tmp_path / "short.csv", slice(0, 24))))["rows"]
        == 24
    )


def report_of(path):
    """The report as JSON, which knows no NaN, or what to do."""
    try:
        return json.dumps(identify_file(path, "ur10").as_document(), allow_nan=False)
    except CellError as error:
        return error.remedy


@pytest.mark.parametrize("spoil", ["constant", "same_rows", "one_joint", "garbage"])
def test_poor_data_never_breaks(spoil, tmp_path):
    simulated = tracker_points("ur10", 50)
    joints, positions = simulated.observations.joints_rad, simulated.observations.positions_m
    if spoil == "constant":
        positions[:] = 1.0
    if spoil == "same_rows":
        joints[:], positions[:] = joints[0], positions[0]
    if spoil == "one_joint":
        joints[:, 1:] = joints[0, 1:]
    if spoil == "garbage":
        positions[:] = np.random.default_rng(0).uniform(-1, 1, positions.shape)
    path = file_of(simulated, tmp_path / "poor.csv", slice(0, 9))
    assert report_of(path)
