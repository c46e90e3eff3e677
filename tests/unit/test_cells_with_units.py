"""Cells of a table that hold more than a number: units, marks of thousands, copies of a row; and lists of points."""

import re
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
import pytest
from openpyxl import Workbook

from cellcal.calibration.arm.kinematics import load_model
from cellcal.calibration.identification.misfit import refuse_misfit
from cellcal.calibration.identification.misfit_error import MisfitError
from cellcal.service.engineering.identification.at_points import AtOptions, read_points
from cellcal.service.engineering.identification.identify_check import file_names
from cellcal.service.engineering.measured.cell_numbers import parse_cell
from cellcal.service.engineering.measured.measurements import ReadOptions, read_measurements
from cellcal.service.engineering.measured.table import MeasurementError, read_table
from cellcal.service.engineering.measured.usable_rows import REPEAT

MODEL = load_model("fanuc_m6ib")
HEADING = ("J1", "J2", "J3", "J4", "J5", "J6", "X", "Y", "Z")
GERMAN = str.maketrans(",.", ".,")

Written = Callable[[int, float], str]


def true_rows() -> np.ndarray:
    """Return joints [deg] and positions [mm] of thirty postures, in a device's frame far from the base."""
    random = np.random.default_rng(8)
    joints = random.uniform(-0.9, 0.9, (30, 6))
    places = np.array([1.5, -0.7, 0.3]) + MODEL.tip_positions(joints, np.array([0.03, 0.02, 0.15]))
    return np.column_stack([np.rad2deg(joints), places * 1e3])


def write_table(path: Path, write: Written, separator: str = ",", heading: tuple[str, ...] = HEADING) -> Path:
    lines = [separator.join(heading)] if heading else []
    lines += [separator.join(write(at, value) for at, value in enumerate(row)) for row in true_rows()]
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")
    return path


def degrees_minutes(value: float) -> str:
    size = abs(value)
    minutes = (size - int(size)) * 60
    seconds = min((minutes - int(minutes)) * 60, 59.9999)
    return f"{'-' if value < 0 else ''}{int(size)}°{int(minutes):02d}'{seconds:07.4f}\""


@pytest.mark.parametrize(
    ("write", "separator"),
    [
        (lambda at, v: f"{v:.5f}°" if at < 6 else f"{v:.4f} mm", ","),
        (lambda at, v: f"{v:.5f} deg" if at < 6 else f'"{v:,.4f} mm"', ","),
        (lambda at, v: f"{v:.5f}" if at < 6 else f'"{v:,.4f}"', ","),
        (lambda at, v: f"{np.deg2rad(v):.8f} rad" if at < 6 else f"{v / 1e3:.7f} m", ","),
        (lambda at, v: (f"{v:.5f}°" if at < 6 else f"{v:,.4f} mm").translate(GERMAN), ";"),
        (lambda at, v: f"{v:.5f} deg" if at < 6 else f"{v:.4f} mm", " "),
        (lambda at, v: f"{v:.5f} °" if at < 6 else f"{v:.4f} mm", "\t"),
        (lambda at, v: degrees_minutes(v) if at < 6 else f"{v:.4f}", ";"),
        (
            lambda at, v: f"{v:.5f}°" if at < 3 else f"{np.deg2rad(v):.8f} rad" if at < 6 else f"{v:.4f} mm",
            ",",
        ),
    ],
)
def test_cells_are_read_with_their_units_and_marks(write, separator, tmp_path):
    found = read_measurements(write_table(tmp_path / "m.csv", write, separator), MODEL)
    joints, places = np.split(true_rows(), [6], axis=1)
    assert np.abs(found.observations.joints_rad - np.deg2rad(joints)).max() < 2e-7
    assert np.abs(found.observations.positions_m - places * 1e-3).max() < 1e-7


@pytest.mark.parametrize(
    ("write", "says"),
    [
        (lambda at, v: f"{v:.3f} qq", "'-?[0-9.]+ qq' is no number"),
        (
            lambda at, v: f"{v:.3f}" if at < 6 else f"{v:.3f} {'m' if v > 2000 else 'mm'}",
            "their units differ",
        ),
        (
            lambda at, v: f"{v:.3f}" if at < 6 else f"{v:.3f}{' mm' if v > 2000 else ''}",
            "one of them has no unit",
        ),
    ],
)
def test_a_cell_without_one_meaning_is_named(write, says, tmp_path):
    with pytest.raises(MeasurementError, match=says) as refused:
        read_measurements(write_table(tmp_path / "m.csv", write), MODEL)
    assert "decimal point" in refused.value.remedy


def test_a_heading_that_contradicts_its_cells_is_refused(tmp_path):
    heading = (*HEADING[:6], "X [m]", "Y [m]", "Z [m]")
    path = write_table(
        tmp_path / "m.csv", lambda at, v: f"{v:.3f}" if at < 6 else f"{v:.3f} mm", ",", heading
    )
    with pytest.raises(MeasurementError, match="its heading says m"):
        read_measurements(path, MODEL)


@pytest.mark.parametrize(
    ("cells", "says"),
    [
        (("1,234", "987", "1,001", "875"), "the comma may be a mark of thousands"),
        (("1,2345", "987.25", "1,0015", "875.5"), "cannot both be the decimal mark"),
    ],
)
def test_a_comma_that_may_be_of_thousands_is_refused(cells, says, tmp_path):
    rows = [f"{i};2{i},5;3,25;1,5;2,{i}5;3,5;{x};0,5;0,25" for i, x in enumerate(cells * 3)]
    path = tmp_path / "m.csv"
    path.write_text("\n".join([";".join(HEADING), *rows]) + "\n", encoding="utf-8")
    with pytest.raises(MeasurementError, match=says):
        read_measurements(path, MODEL)


def values_of_x(path: Path) -> np.ndarray:
    table = read_table(path)
    return table.column_values(table.names[6])


def write_cells(path: Path, joint: str, x: Sequence[object], y: object, z: object = "3") -> Path:
    """Write joints that differ in their first cell, and positions, with semicolons or as a sheet of texts."""
    rows = [[joint.replace("0", str(i), 1), *[joint] * 5, x[i % len(x)], y, z] for i in range(12)]
    if path.suffix == ".xlsx":
        book = Workbook()
        for row in [HEADING, *rows]:
            book.active.append(list(row))
        book.save(path)
    else:
        path.write_text(
            "\n".join(";".join(map(str, row)) for row in [HEADING, *rows]) + "\n", encoding="utf-8"
        )
    return path


@pytest.mark.parametrize("name", ["m.csv", "m.xlsx"])
@pytest.mark.parametrize(
    ("joint", "x", "y", "says"),
    [
        # A file of decimal commas, and 1.204 that is 1204 there.
        (
            "0,5",
            ("1.204", "1.310"),
            "1.234,5",
            "'1.204' in line 2, and column 'J1' holds '0,5' in line 2: the point",
        ),
        (
            "0",
            ("1.204", "1.310"),
            "1.234,5",
            "'1.204' in line 2, and column 'Y' holds '1.234,5' in line 2: the point",
        ),
        (
            "0,5",
            ("987", "1.204"),
            "1,5",
            "'1.204' in line 3, and column 'J1' holds '0,5' in line 2: the point",
        ),
        (
            "0",
            ("1.204 mm", "1.310 mm"),
            "1,5",
            "'1.204 mm' in line 2, and column 'Y' holds '1,5' in line 2: the point",
        ),
        (
            "0.5",
            ("1.204", "1.310"),
            "1.234,5",
            "'1.204' in line 2, and column 'Y' holds '1.234,5' in line 2: the point",
        ),
        # A file of decimal points, and 1,204 that is 1204 there.
        (
            "0.5",
            ("1,204", "1,310"),
            "98.5",
            "'1,204' in line 2, and column 'J1' holds '0.5' in line 2: the comma",
        ),
        (
            "0",
            ("1,204", "-1,310"),
            "98.25",
            "'1,204' in line 2, and column 'Y' holds '98.25' in line 2: the comma",
        ),
        ("0.5", ("1,234", "987.6"), "1.5", "'1,234' in line 2 and '987.6' in line 3: a comma and a point"),
    ],
)
def test_a_mark_that_other_columns_make_doubtful_is_refused(name, joint, x, y, says, tmp_path):
    path = write_cells(tmp_path / name, joint, x, y)
    with pytest.raises(MeasurementError, match=re.escape(says)) as refused:
        values_of_x(path)
    assert "decimal point" in refused.value.remedy


@pytest.mark.parametrize(
    ("x", "y", "says"),
    [
        (("1,234", 987.6), 1.5, "'1,234' in line 2 and '987.6' in line 3: the comma may"),
        (("1,234", 987), 1.5, "'1,234' in line 2 and '987' in line 3: the comma may"),
        (("1,234",), 1.5, "'1,234' in line 2, and column 'Y' holds '1.5' in line 2: the comma may"),
        (("1,234",), "1,234.5", "'1,234' in line 2, and column 'Y' holds '1,234.5' in line 2: the comma may"),
        (("1.204",), "1.234,5", "'1.204' in line 2, and column 'Y' holds '1.234,5' in line 2: the point may"),
    ],
)
def test_texts_of_a_sheet_that_may_have_thousands_are_refused(x, y, says, tmp_path):
    path = write_cells(tmp_path / "m.xlsx", "0", x, y, 3)
    with pytest.raises(MeasurementError, match=re.escape(says)):
        values_of_x(path)


@pytest.mark.parametrize(
    ("name", "row", "read"),
    [
        ("m.csv", ("0.5", ("1.204", "1.310"), "2.125", "3"), (1.204, 1.310)),  # metres
        ("m.csv", ("0", ("1.204", "987"), "2.125", "1200"), (1.204, 987.0)),
        ("m.csv", ("0,5", ("1,204", "1,310"), "2,125", "3"), (1.204, 1.310)),
        ("m.csv", ("0", ("1,204", "1,310"), "2,125", "1200"), (1.204, 1.310)),
        ("m.csv", ("0,5", ("1.204,5", "987"), "2,125", "1200"), (1204.5, 987.0)),
        # Both marks, and each column has one for certain.
        ("m.csv", ("0,5", ("1,204", "0,310"), "2.5", "3"), (1.204, 0.310)),
        ("m.csv", ("0,5", ("1.204", "0.310"), "2,5", "3"), (1.204, 0.310)),
        # One column has another mark than several: a name, or a time.
        ("m.csv", ("0,5", ("812,345", "913,250"), "23,5", "1.1"), (812.345, 913.25)),
        ("m.csv", ("0.5", ("812.345", "913.250"), "23.5", "21,5"), (812.345, 913.25)),
        ("m.xlsx", ("0.5", ("1.204", 1.310), 2.125, 1200), (1.204, 1.310)),
        ("m.xlsx", ("0,5", ("1,204", "1,310"), "2,125", 1200), (1.204, 1.310)),
        ("m.xlsx", ("0", ("12,5", 987.6), 2.125, 1200), (12.5, 987.6)),
        ("m.xlsx", ("0.5", ("1,204.5", "987.6"), "2.125", 3.5), (1204.5, 987.6)),
        ("m.xlsx", ("0,5", ("1.204,5", "987,6"), "2,125", 3.5), (1204.5, 987.6)),
    ],
)
def test_a_file_with_one_mark_is_read(name, row, read, tmp_path):
    table = read_table(write_cells(tmp_path / name, *row))
    assert tuple(table.column_values("X")[:2]) == read
    assert not table.doubts


@pytest.mark.parametrize(
    ("text", "comma", "value"),
    [
        ("1,234.5", False, 1234.5),
        ("1.234,5", True, 1234.5),
        ("1,234.5", True, "1,234.5"),  # a decimal comma and a point behind it are no number
        ("1,234", False, "1,234"),
        ("-0°30'", False, -0.5),
        ('365"', False, 365.0),  # quotation marks of a file
        ("365'", False, "365'"),  # feet or minutes
        ("12.3 nan", False, "12.3 nan"),
        ("5 %", False, "5 %"),
    ],
)
def test_a_cell_is_a_number_only_with_one_meaning(text, comma, value):
    assert parse_cell(text, comma=comma) == value


@pytest.mark.parametrize("in_rad", [(3, 4, 5), (0, 1), (2,), (1, 2), (0, 2, 4)])
def test_joints_in_different_units_are_named_with_a_cure_that_fits(in_rad, tmp_path):
    path = write_table(
        tmp_path / "m.csv", lambda at, v: f"{np.deg2rad(v):.7f}" if at in in_rad else f"{v:.5f}"
    )
    found = read_measurements(path, MODEL)
    with pytest.raises(MisfitError) as refused:
        refuse_misfit(MODEL, found.observations, file_names(found), search_models=False)
    units = ",".join("rad" if at in in_rad else "deg" for at in range(6))
    assert f"`--units joints={units}`" in refused.value.remedy
    cured = read_measurements(path, MODEL, ReadOptions(units={"joints": units}))
    assert np.abs(cured.observations.joints_rad - np.deg2rad(true_rows()[:, :6])).max() < 2e-7
    refuse_misfit(MODEL, cured.observations, file_names(cured), search_models=False)


@pytest.mark.parametrize("units", ["deg,rad", "deg,deg,deg,rad,rad,ell"])
def test_units_of_joints_that_do_not_fit_are_refused(units, tmp_path):
    path = write_table(tmp_path / "m.csv", lambda _at, v: f"{v:.5f}")
    with pytest.raises(MeasurementError):
        read_measurements(path, MODEL, ReadOptions(units={"joints": units}))


def test_headings_may_name_a_unit_for_each_joint(tmp_path):
    heading = (*(f"J{i} [deg]" for i in (1, 2, 3)), *(f"J{i} [rad]" for i in (4, 5, 6)), *HEADING[6:])
    path = write_table(
        tmp_path / "m.csv", lambda at, v: f"{np.deg2rad(v):.7f}" if 2 < at < 6 else f"{v:.5f}", ",", heading
    )
    found = read_measurements(path, MODEL)
    assert np.abs(found.observations.joints_rad - np.deg2rad(true_rows()[:, :6])).max() < 2e-7


def test_copies_of_a_row_count_once(tmp_path):
    path = write_table(tmp_path / "m.csv", lambda _at, v: f"{v:.5f}")
    line = path.read_text(encoding="utf-8").splitlines()[3]
    path.write_text(path.read_text(encoding="utf-8") + f"{line}\n" * 10, encoding="utf-8")
    found = read_measurements(path, MODEL)
    assert (found.read, len(found.rows)) == (40, 30)
    assert [row.kind for row in found.rejected] == [REPEAT] * 10
    assert found.rejected[0].reason == "line 32 repeats line 4 to the last digit: it counts once"


@pytest.mark.parametrize(
    "text",
    [
        "// SpatialAnalyzer\n// AXES = CARTESIAN: X,  Y,  Z (mm)\nA, Main, P0, 1.5, 2.5, 3.5, 02/12/25\nA, Main, P1, 4.5, 2.5, 1.5, 02/12/25\n",
        "Collection,Group,Point,X,Y,Z,Time,Note,Ux,Uy,Uz\nA,B,P0,1.5,2.5,3.5,9:00,a,1,1,1\nA,B,P1,4,5,6,9:01,b,1,1,1\n",
    ],
)
def test_a_list_of_points_is_called_one(text, tmp_path):
    path = tmp_path / "points.txt"
    path.write_text(text, encoding="utf-8")
    with pytest.raises(MeasurementError) as refused:
        read_measurements(path, MODEL)
    assert "a list of points without the joints" in refused.value.remedy


@pytest.mark.parametrize(
    ("row", "says"),
    [
        ("A::Main::P0  1.5 2.5 3.5", "3 columns of numbers without a heading: too few for the 6 joints"),
        ("-90.5,-90,0,10.5,90,90", "6 columns of numbers without a heading: too few for the 6 joints"),
        ("1,4.7,-0.7,-2.2,4.7,0.8,-5.2", "`--columns joints=1,2,3,4,5,6` `--columns length=7`"),
        ("1,2,3,4,5,6,7.5,8.5,9.5", "`--columns position=7,8,9`"),
    ],
)
def test_a_hint_names_columns_that_the_file_has(row, says, tmp_path):
    path = tmp_path / "rows.txt"
    path.write_text(f"{row}\n{row}\n", encoding="utf-8")
    with pytest.raises(MeasurementError) as refused:
        read_measurements(path, MODEL)
    assert says in refused.value.remedy


def test_points_of_at_are_read_with_units_or_the_cell_is_named(tmp_path):
    path = tmp_path / "at.csv"
    heading = ",".join(f"q{i}_deg" for i in range(1, 7))
    path.write_text(f"{heading}\n12.5°,0,0,0.1 rad,0,0\n", encoding="utf-8")
    joints = read_points(AtOptions(path), 6).joints_rad
    assert np.abs(joints - [[np.deg2rad(12.5), 0, 0, 0.1, 0, 0]]).max() < 1e-12
    for cell, says in (("12 mm", "'12 mm' is not in deg"), ('"1,5"', "'1,5' cannot be read as a number")):
        path.write_text(f"{heading}\n0,0,0,0,0,0\n{cell},0,0,0,0,0\n", encoding="utf-8")
        with pytest.raises(MeasurementError, match=f"point 2 .*q1_deg: {says}"):
            read_points(AtOptions(path), 6)
