"""Rows of several robots, targets, headings and units in one file are refused with what divides them."""

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from cellcal.calibration.arm.kinematics import RobotModel
from cellcal.calibration.identification.misfit import FileNames, refuse_misfit
from cellcal.calibration.identification.misfit_error import MisfitCause, MisfitError
from cellcal.calibration.identification.observations import PointObservations
from cellcal.calibration.identification.target_change import (
    TargetChange,
    find_target_change,
    refuse_target_change,
    series_columns,
)
from cellcal.service.cli.app import run_command_line
from cellcal.service.engineering.identification import row_fit
from cellcal.service.engineering.identification.identify_check import prepare_measurements
from cellcal.service.engineering.measured.cell_numbers import parse_cell
from cellcal.service.engineering.measured.measurements import ReadOptions, read_measurements
from cellcal.service.engineering.measured.table import MeasurementError
from cellcal.service.exit_codes import ExitCode
from tests.unit.helpers.simulated_arm import tracker_points

ROBOT = "abb_irb120"
HEADING = ["J1", "J2", "J3", "J4", "J5", "J6", "X", "Y", "Z"]


def target_change_of(model: RobotModel, rows: PointObservations) -> TargetChange | None:
    return find_target_change(series_columns(model, rows))


def with_other_target(true, first: int, moved_m, *, until: int | None = None) -> PointObservations:
    """Return the rows with the target moved in the flange from one row on."""
    rows: PointObservations = true.observations
    places = rows.positions_m.copy()
    frames = true.truth.seen_from(0).base_flange(rows.joints_rad)[:, :3, :3]
    places[first:until] += (frames @ np.asarray(moved_m))[first:until]
    return replace(rows, positions_m=places)


def cells_of(rows: PointObservations) -> list[list[str]]:
    joints, places = np.rad2deg(rows.joints_rad), rows.positions_m * 1e3
    return [[f"{value:.4f}" for value in (*a, *b)] for a, b in zip(joints, places, strict=True)]


def write(path: Path, *lines: list[str]) -> Path:
    path.write_text("\n".join(",".join(line) for line in lines) + "\n", encoding="utf-8")
    return path


@pytest.mark.parametrize("robot", [ROBOT, "ur10", "fanuc_m6ib"])
@pytest.mark.parametrize("moved_mm", [1.0, 8.0, 60.0])
@pytest.mark.parametrize("first", [20, 40, 66])
def test_a_target_that_changed_is_found_with_row_and_distance(robot: str, moved_mm: float, first: int):
    for seed in range(3):
        true = tracker_points(robot, 80, seed=seed)
        rows = with_other_target(true, first, [0.0, 0.6 * moved_mm * 1e-3, 0.8 * moved_mm * 1e-3])
        found = target_change_of(true.model, rows)
        assert found is not None
        assert abs(found.row - first) <= (0 if moved_mm > 5.0 else 2)
        assert found.moved_m == pytest.approx(moved_mm * 1e-3, rel=0.15, abs=2e-4)


@pytest.mark.parametrize("robot", [ROBOT, "ur10", "fanuc_m6ib", "kuka_kr6_r900"])
def test_one_target_a_moved_device_and_a_slow_drift_are_no_other_target(robot: str) -> None:
    for seed in range(6):
        true = tracker_points(robot, 60, seed=seed)
        rows: PointObservations = true.observations
        assert target_change_of(true.model, rows) is None
        moved, drifted = rows.positions_m.copy(), rows.positions_m.copy()
        moved[30:] += [0.02, -0.01, 0.005]
        drifted += np.linspace(0.0, 1e-3, 60)[:, None] * [1.0, 0.0, 0.0]
        assert target_change_of(true.model, replace(rows, positions_m=moved)) is None
        assert target_change_of(true.model, replace(rows, positions_m=drifted)) is None


def test_the_refusal_names_the_row_of_the_file() -> None:
    true = tracker_points(ROBOT, 60)
    found = target_change_of(true.model, with_other_target(true, 30, [0.0, 0.0, 0.005]))
    with pytest.raises(MisfitError, match=r"5\.0\d mm elsewhere on the flange from row 34") as refused:
        refuse_target_change(true.model, found, np.arange(60) + 4)
    assert refused.value.causes[0].kinds == ("target",)
    assert "Divide the file there" in refused.value.remedy


def test_the_command_refuses_a_file_of_two_targets(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    true = tracker_points(ROBOT, 60)
    rows = cells_of(with_other_target(true, 30, [0.0, 0.0, 0.04]))
    file = write(tmp_path / "two.csv", HEADING, *rows)
    assert run_command_line(["identify", str(file), "--robot", ROBOT]) == ExitCode.REFUSED
    assert "elsewhere on the flange from row 30" in " ".join(capsys.readouterr().err.split())


@pytest.mark.parametrize("name", ["Robot", "robot name", "机器人", "Roboter"])
def test_a_column_of_two_robots_is_refused(tmp_path: Path, name: str) -> None:
    true = tracker_points(ROBOT, 40)
    rows = [[("R1", "R2")[at >= 20], *cells] for at, cells in enumerate(cells_of(true.observations))]
    with pytest.raises(MeasurementError, match="names 2 robots: R1, R2"):
        read_measurements(write(tmp_path / "m.csv", [name, *HEADING], *rows), true.model)


def test_one_robot_in_its_column_is_read(tmp_path: Path) -> None:
    true = tracker_points(ROBOT, 40)
    rows = [["R1", *cells] for cells in cells_of(true.observations)]
    assert (
        len(read_measurements(write(tmp_path / "m.csv", ["Robot", *HEADING], *rows), true.model).rows) == 40
    )


def test_a_column_of_targets_is_said_and_is_the_cure_where_nothing_fits(tmp_path: Path) -> None:
    true = tracker_points(ROBOT, 40)
    rows = [[("A", "B")[at % 2], *cells] for at, cells in enumerate(cells_of(true.observations))]
    prepared = prepare_measurements(
        write(tmp_path / "m.csv", ["SMR", *HEADING], *rows), true.model, ReadOptions()
    )
    (note,) = [each for each in prepared.noticed if each.code == "targets"]
    assert "'SMR' tells A, B apart" in note.message
    mixed = np.random.default_rng(1).permutation(true.observations.positions_m)
    with pytest.raises(MisfitError) as refused:
        refuse_misfit(
            true.model,
            replace(true.observations, positions_m=mixed),
            FileNames(tuple(HEADING[:6]), targets="SMR"),
            search_models=False,
        )
    assert "Column 'SMR' tells several targets" in refused.value.remedy


def test_names_of_points_are_no_targets(tmp_path: Path) -> None:
    true = tracker_points(ROBOT, 40)
    rows = [[f"P{at}", *cells] for at, cells in enumerate(cells_of(true.observations))]
    file = write(tmp_path / "m.csv", ["Target", *HEADING], *rows)
    assert read_measurements(file, true.model).targets == ("", ())


@pytest.mark.parametrize(
    "second", [[*HEADING[:6], "Z", "Y", "X"], [*HEADING[:6], "X [m]", "Y [m]", "Z [m]"], HEADING[:3][::-1] + HEADING[3:]]
)  # fmt: skip
def test_another_heading_further_down_is_refused_with_its_line(tmp_path: Path, second: list[str]) -> None:
    true = tracker_points(ROBOT, 40)
    rows = cells_of(true.observations)
    file = write(tmp_path / "m.csv", HEADING, *rows[:20], second, *rows[20:])
    with pytest.raises(MeasurementError, match="line 22 is another heading"):
        read_measurements(file, true.model)


def test_the_same_heading_further_down_and_lines_of_words_are_passed(tmp_path: Path) -> None:
    true = tracker_points(ROBOT, 40)
    rows = cells_of(true.observations)
    file = write(tmp_path / "m.csv", HEADING, *rows[:20], HEADING, ["lost"] * 9, *rows[20:])
    assert len(read_measurements(file, true.model).rows) == 40


def test_pulses_are_no_degrees(tmp_path: Path) -> None:
    true = tracker_points(ROBOT, 40)
    rows = [
        [*(f"{float(cell) * 900:.0f}" for cell in cells[:6]), *cells[6:]]
        for cells in cells_of(true.observations)
    ]
    file = write(tmp_path / "m.csv", ["S", "L", "U", "R", "B", "T", "X", "Y", "Z"], *rows)
    with pytest.raises(MeasurementError, match="no joint turns so far") as refused:
        read_measurements(file, true.model)
    assert "pulses per degree" in refused.value.remedy


@pytest.mark.parametrize(("unit", "taken", "factor"), [("gon", "deg", 0.9), ("rev", "rad", 2 * np.pi)])
def test_gon_and_revolutions_are_recognised_by_the_fit(unit: str, taken: str, factor: float) -> None:
    true = tracker_points(ROBOT, 40)
    rows = replace(true.observations, joints_rad=true.observations.joints_rad / factor)
    with pytest.raises(MisfitError) as refused:
        refuse_misfit(true.model, rows, FileNames(tuple(HEADING[:6]), angle_unit=taken), search_models=False)
    assert f"`--units joints={unit}`" in refused.value.remedy


@pytest.mark.parametrize("unit", ["rev", "revolutions", "Umdrehungen"])
def test_joints_in_revolutions_are_read_by_their_heading(tmp_path: Path, unit: str) -> None:
    true = tracker_points(ROBOT, 12)
    rows = [
        [*(f"{float(cell) / 360:.9f}" for cell in cells[:6]), *cells[6:]]
        for cells in cells_of(true.observations)
    ]
    file = write(tmp_path / "m.csv", [*(f"J{i} [{unit}]" for i in range(1, 7)), "X", "Y", "Z"], *rows)
    found = read_measurements(file, true.model).observations
    assert np.allclose(found.joints_rad, true.observations.joints_rad, rtol=0, atol=1e-5)


@pytest.mark.parametrize(
    "heading", [[f"{axis} pulse" for axis in "SLURBT"], [f"J{i} counts" for i in range(1, 7)]]
)
def test_joints_that_headings_call_pulses_are_none(tmp_path: Path, heading: list[str]) -> None:
    true = tracker_points(ROBOT, 12)
    file = write(tmp_path / "m.csv", [*heading, "X", "Y", "Z"], *cells_of(true.observations))
    with pytest.raises(MeasurementError, match="no 6 joint columns") as refused:
        read_measurements(file, true.model)
    assert "pulses per degree" in refused.value.remedy
    both = [[*cells[:6], *cells] for cells in cells_of(true.observations)]
    file = write(tmp_path / "n.csv", [*heading, *(f"J{i} [deg]" for i in range(1, 7)), "X", "Y", "Z"], *both)
    assert read_measurements(file, true.model).layout.joints[0] == "J1 [deg]"


@pytest.mark.parametrize("first", ["#", "# no", "%"])
def test_a_heading_that_begins_with_a_mark_is_one(tmp_path: Path, first: str) -> None:
    true = tracker_points(ROBOT, 40)
    rows = [
        [str(at), f"2024-05-03T10:00:{at:02d}+02:00", *cells]
        for at, cells in enumerate(cells_of(true.observations))
    ]
    file = write(tmp_path / "m.csv", [first, "Time", *HEADING], *rows)
    assert read_measurements(file, true.model).layout.joints == tuple(HEADING[:6])


@pytest.mark.parametrize(
    ("cell", "degrees"),
    [("12°30.5'", 12.508333), ("-7° 05.25\u2032", -7.0875), ("12°30'15\"", 12.504167), ("12°30'", 12.5)],
)
def test_minutes_with_decimals_are_read(cell: str, degrees: float) -> None:
    assert parse_cell(cell, comma=False) == pytest.approx(degrees, abs=1e-6)


@pytest.mark.parametrize(
    "text", ['[{"joints": [1, 2], "position": [3, 4]}]', '{"rows": 1}', "<?xml version='1.0'?><a/>"]
)
def test_a_document_that_is_no_table_is_said(tmp_path: Path, text: str) -> None:
    file = tmp_path / "m.json"
    file.write_text(text, encoding="utf-8")
    with pytest.raises(MeasurementError, match="JSON or XML"):
        read_measurements(file, tracker_points(ROBOT, 8).model)


@pytest.mark.parametrize("text", ["{E6AXIS: A1 10.0,A2 -90.0,A3 90.0};1000.0;0;0", "{X 1.0,Y 2.0,Z 3.0}"])
def test_rows_of_krl_are_named_as_such(tmp_path: Path, text: str) -> None:
    file = tmp_path / "m.csv"
    file.write_text("\n".join([text] * 3), encoding="utf-8")
    with pytest.raises(MeasurementError, match="KRL text") as refused:
        read_measurements(file, tracker_points(ROBOT, 8).model)
    assert "without braces" in refused.value.remedy


@pytest.mark.parametrize(
    ("column", "kind", "cured"), [("Target", "target", True), ("Target", "joint", False)]
)
def test_a_column_that_tells_targets_apart_is_the_cure(monkeypatch, column, kind, cured):
    def refuse(*_):
        raise MisfitError("changed", remedy="Divide.", causes=(MisfitCause((kind,), "", "", 0.0),))

    monkeypatch.setattr(row_fit, "series_columns", lambda *_: None)
    monkeypatch.setattr(row_fit, "find_series_changes", lambda *_: None)
    monkeypatch.setattr(row_fit, "refuse_series_changes", refuse)
    measured = SimpleNamespace(rows=np.arange(3), targets=(column, ("A", "B")))
    with pytest.raises(MisfitError) as refused:
        row_fit._refuse_changes(None, SimpleNamespace(observations=None, measurements=measured))
    assert ("Column 'Target' tells" in refused.value.remedy) == cured
