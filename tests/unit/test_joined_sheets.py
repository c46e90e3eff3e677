"""Joints on one sheet and readings on another are joined where a column proves the pairs, and else refused with the reason."""

from pathlib import Path

import numpy as np
import openpyxl
import pytest

from cellcal.calibration.arm.kinematics import load_model
from cellcal.service.engineering.identification.identify import identify_file
from cellcal.service.engineering.identification.row_fit import IdentifyOptions
from cellcal.service.engineering.measured.measurements import ReadOptions, read_measurements
from cellcal.service.engineering.measured.table import MeasurementError

ROBOT, COUNT = "abb_irb120", 12
JOINTS = [f"J{i}" for i in range(1, 7)]
NAMES = [f"P{i + 1}" for i in range(COUNT)]


@pytest.fixture(scope="module")
def series():
    """Return joints [deg] and readings [mm] of the same rows."""
    model, dice = load_model(ROBOT), np.random.default_rng(5)
    joints = dice.uniform(0.7 * model.lower_rad, 0.7 * model.upper_rad, (COUNT, 6))
    places = model.tip_positions(joints, np.array([0.05, 0.03, 0.1])) + np.array([1.0, 2.0, 0.5])
    return np.degrees(joints).round(4), (places * 1e3).round(4)


def write_book(path: Path, *sheets):
    book = openpyxl.Workbook()
    book.remove(book.active)
    for name, heading, rows in sheets:
        sheet = book.create_sheet(name)
        for row in (heading, *rows):
            sheet.append(list(row))
    book.save(path)
    return path


def keyed(keys, rows):
    return [
        [*(key if isinstance(key, tuple) else (key,)), *map(float, row)]
        for key, row in zip(keys, rows, strict=True)
    ]


def read(path: Path):
    return read_measurements(path, load_model(ROBOT))


@pytest.mark.parametrize(("mine", "theirs"), [("Point", "Point"), ("Pose", "Label of the ball")])
def test_rows_are_paired_by_the_names_of_their_points(tmp_path, series, mine, theirs):
    joints, places = series
    order = np.random.default_rng(1).permutation(COUNT)[: COUNT - 2]
    shuffled = keyed([NAMES[at].lower() for at in order], places[order])
    path = write_book(
        tmp_path / "m.xlsx",
        ("Joints", [mine, *JOINTS], keyed(NAMES, joints)),
        ("Tracker", [theirs, "X [mm]", "Y [mm]", "Z [mm]"], shuffled),
    )
    found = read(path)
    rows = sorted(order)
    assert np.allclose(np.degrees(found.observations.joints_rad), joints[rows])
    assert np.allclose(found.observations.positions_m * 1e3, places[rows])
    assert any("2 rows of 'Joints' have no partner" in guess for guess in found.guesses)


def test_readings_of_several_rounds_share_the_joints_of_their_point(tmp_path, series):
    joints, places = series
    path = write_book(
        tmp_path / "m.xlsx",
        ("Joints", ["Point", *JOINTS], keyed(NAMES, joints)),
        ("Tracker", ["Point", "X", "Y", "Z"], keyed(NAMES, places) + keyed(NAMES, places + 0.01)),
    )
    assert np.allclose(np.degrees(read(path).observations.joints_rad), np.vstack([joints, joints]))


def test_places_of_the_controller_are_no_reading_where_a_device_has_a_sheet(tmp_path, series):
    joints, places = series
    own = load_model(ROBOT).base_flange(np.radians(joints))[:, :3, 3] * 1e3
    path = write_book(
        tmp_path / "m.xlsx",
        ("Robot", ["Point", *JOINTS, "X", "Y", "Z"], keyed(NAMES, np.hstack([joints, own]))),
        ("Tracker", ["Point", "X", "Y", "Z"], keyed(NAMES, places)),
    )
    assert read(path).layout.position == ("Tracker X", "Tracker Y", "Tracker Z")


def test_another_day_is_not_joined(tmp_path, series):
    joints, places = series
    day = keyed(range(1, COUNT + 1), np.hstack([joints, places]))
    path = write_book(
        tmp_path / "m.xlsx",
        ("Day 1", ["No", *JOINTS, "X", "Y", "Z"], day),
        ("Day 2", ["No", *JOINTS, "X", "Y", "Z"], day[::-1]),
    )
    assert read(path).layout.joints == tuple(JOINTS)


@pytest.mark.parametrize(
    ("keys", "others", "words"),
    [
        (range(1, COUNT + 1), range(1, COUNT - 1), "only counts the rows"),
        (zip(NAMES, range(101, 101 + COUNT), strict=True), zip(NAMES, range(100 + COUNT, 100, -1), strict=True), "differently"),
        (np.arange(COUNT) * 12.5 + 0.13, np.arange(COUNT) * 12.5 + 0.4, "no measurement found"),
    ],
    ids=["counted", "contradicting", "times that differ"],
)  # fmt: skip
def test_pairs_that_nothing_proves_are_refused(tmp_path, series, keys, others, words):
    keys, others = list(keys), list(others)
    joints, places = series
    key = ["Point", "No"][: len(keys[0]) if isinstance(keys[0], tuple) else 1]
    path = write_book(
        tmp_path / "m.xlsx",
        ("Joints", [*key, *JOINTS], keyed(keys, joints)),
        ("Tracker", [*key, "X", "Y", "Z"], keyed(others, places[: len(others)])),
    )
    with pytest.raises(MeasurementError, match=words):
        read(path)


def write_file(path: Path, heading, rows):
    lines = [",".join(heading)] if heading else []
    lines += [",".join(map(str, row)) for row in rows]
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")
    return path


def read_files(readings: Path, joints: Path):
    return read_measurements(readings, load_model(ROBOT), ReadOptions(joints_file=joints))


@pytest.mark.parametrize("heading", [True, False], ids=["named", "without headings"])
def test_two_files_are_joined_row_by_row(tmp_path, series, heading):
    joints, places = series
    found = read_files(
        write_file(tmp_path / "smr.csv", ["X", "Y", "Z"] if heading else [], places),
        write_file(tmp_path / "joints.csv", JOINTS if heading else [], joints),
    )
    assert np.allclose(np.degrees(found.observations.joints_rad), joints)
    assert np.allclose(found.observations.positions_m * 1e3, places)
    assert any("joined row by row: 12 rows" in guess for guess in found.guesses)


def test_two_files_are_joined_by_the_names_of_points(tmp_path, series):
    """The controller's places beside the joints are no reading."""
    joints, places = series
    own = load_model(ROBOT).base_flange(np.radians(joints))[:, :3, 3] * 1e3
    found = read_files(
        write_file(tmp_path / "a.csv", ["Name", "X", "Y", "Z"], keyed(NAMES[:1:-1], places[:1:-1])),
        write_file(
            tmp_path / "b.csv", ["Pose", *JOINTS, "X", "Y", "Z"], keyed(NAMES, np.hstack([joints, own]))
        ),
    )
    assert np.allclose(np.degrees(found.observations.joints_rad), joints[:1:-1])
    assert found.layout.position == ("measured X", "measured Y", "measured Z")
    assert found.layout.controller == ("robot X", "robot Y", "robot Z")
    assert any("2 rows of 'robot' have no partner: p1, p2" in guess.lower() for guess in found.guesses)


@pytest.mark.parametrize("heading", [["L [mm]"], []], ids=["named", "without headings"])
def test_one_length_a_row_is_joined_with_numbered_joints(tmp_path, series, heading):
    joints, places = series
    lengths = np.linalg.norm(places, axis=1, keepdims=True)
    numbered = np.column_stack([np.arange(1, len(joints) + 1), joints])
    found = read_files(
        write_file(tmp_path / "wire.txt", heading, lengths), write_file(tmp_path / "joints.txt", [], numbered)
    )
    assert np.allclose(np.degrees(found.observations.joints_rad), joints)
    assert np.allclose(found.observations.lengths_m * 1e3, lengths[:, 0])


def test_two_files_of_different_length_need_names(tmp_path, series):
    joints, places = series
    with pytest.raises(MeasurementError, match="10 rows of readings and 12 of joints"):
        read_files(
            write_file(tmp_path / "a.csv", ["X", "Y", "Z"], places[:10]),
            write_file(tmp_path / "b.csv", JOINTS, joints),
        )


def test_a_file_that_lacks_the_joints_is_told_how_to_name_them(tmp_path, series):
    for heading in (["X", "Y", "Z"], []):
        with pytest.raises(MeasurementError) as refused:
            read(write_file(tmp_path / "a.csv", heading, series[1]))
        assert "--joints FILE" in refused.value.remedy


def test_a_check_file_has_no_joints_of_another(tmp_path, series):
    file = write_file(tmp_path / "a.csv", JOINTS, series[0])
    options = IdentifyOptions(check=file, read=ReadOptions(joints_file=file))
    with pytest.raises(MeasurementError, match="--check is another"):
        identify_file(file, ROBOT, options)
