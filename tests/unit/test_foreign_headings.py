"""Headings, summaries and forms of tables of further countries and programs."""

from pathlib import Path

import numpy as np
import pytest

from cellcal.calibration.arm.kinematics import load_model
from cellcal.calibration.identification.last_joint import last_joint_note
from cellcal.calibration.identification.observations import PointObservations
from cellcal.service.engineering.measured.columns import detect_layout
from cellcal.service.engineering.measured.measurements import read_measurements
from cellcal.service.engineering.measured.table import MeasurementError, read_table
from tests.unit.helpers.simulated_arm import tracker_poses

MODEL = load_model("abb_irb120")
POSES = tracker_poses("abb_irb120", 40)
DEG = np.rad2deg(POSES.observations.joints_rad)
MM = POSES.observations.positions_m * 1e3
ROWS = np.column_stack([DEG, MM])
HEADING = [*(f"J{i}" for i in range(1, 7)), "X", "Y", "Z"]


def write_table(path: Path, lines: list[str], encoding: str = "utf-8") -> Path:
    path.write_bytes("\n".join([*lines, ""]).encode(encoding))
    return path


def text_rows(rows: np.ndarray, separator: str = ",", mark: str = ".", digits: int = 4) -> list[str]:
    return [separator.join(f"{cell:.{digits}f}".replace(".", mark) for cell in row) for row in rows]


@pytest.mark.parametrize(
    ("joint", "place", "encoding"),
    [
        ("Ось {}, град", "{}, мм", "cp1251"),
        ("Сустав{}", "Измеренное {}", "cp1251"),
        ("ось {} [град]", "Измерено {} [мм]", "koi8_r"),
        ("Ось {}", "{} изм", "cp866"),
        ("oś {}", "zmierzony {}", "cp1250"),
        ("Giunto {}", "{} misurato", "cp1252"),
        ("Asse{}", "{}", "utf-8"),
        ("Junta {} (graus)", "{} medido", "cp1252"),
        ("Eixo {}", "{} (mm)", "utf-8"),
        ("Articulation {}", "{} mesuré", "cp1252"),
        ("J{}, deg", "{}, mm", "utf-8"),
        ("j{}deg", "{}mm", "utf-8"),
    ],
)
def test_headings_of_further_languages(tmp_path: Path, joint: str, place: str, encoding: str) -> None:
    heading = [*(joint.format(i) for i in range(1, 7)), *(place.format(axis) for axis in "XYZ")]
    path = write_table(tmp_path / "rows.csv", [";".join(heading), *text_rows(ROWS, ";", ",")], encoding)
    found = read_measurements(path, MODEL)
    assert found.layout.joints == tuple(heading[:6])
    assert np.allclose(found.observations.positions_m * 1e3, MM, atol=1e-3)


@pytest.mark.parametrize(
    ("joint", "counts", "place", "per_mm"),
    [
        ("J{} [arcmin]", 60.0, "{} [mm]", 1.0),
        ("J{} (arcsec)", 3600.0, "{} (mm)", 1.0),
        ("J{} [0.001 deg]", 1e3, "{} [0.001mm]", 1e3),
        ("J{} [0.001°]", 1e3, "{} [1/1000 m]", 1.0),
        ("J{} [0.0001 deg]", 1e4, "{} [1e-6 m]", 1e3),
        ("J{} (1/100 °)", 1e2, "{} [mm]", 1.0),
        ("J{} [0.1 deg]", 1e1, "{} [1/100 mm]", 1e2),
        ("J{} [deg]", 1.0, "{} [0.1mm]", 1e1),
    ],
)
def test_parts_of_degrees_and_thousandths(
    tmp_path: Path, joint: str, counts: float, place: str, per_mm: float
) -> None:
    heading = [*(joint.format(at) for at in range(1, 7)), *(place.format(axis) for axis in "XYZ")]
    rows = np.column_stack([DEG * counts, MM * per_mm])
    path = write_table(tmp_path / "rows.csv", [",".join(heading), *text_rows(rows)])
    found = read_measurements(path, MODEL).observations
    assert np.allclose(np.rad2deg(found.joints_rad), DEG, atol=1e-4)
    assert np.allclose(found.positions_m * 1e3, MM, atol=1e-3)


@pytest.mark.parametrize("joint", ["{}轴", "第{}关节(°)", "轴{}", "関節{}"])
def test_chinese_numbers_and_wide_digits(tmp_path: Path, joint: str) -> None:
    heading = [*(joint.format("一二三四五六"[at]) for at in range(6)), "测量X", "测量Y", "测量Z"]
    wide = {ord(sign): chr(ord(sign) + 0xFEE0) for sign in "0123456789.-"}
    lines = [",".join(heading), *(row.translate(wide) for row in text_rows(ROWS))]
    found = read_measurements(write_table(tmp_path / "rows.csv", lines, "gb18030"), MODEL)
    assert found.layout.joints == tuple(heading[:6])
    assert np.allclose(found.observations.positions_m * 1e3, MM, atol=1e-3)


def test_easting_northing_and_height_are_a_place_in_this_order(tmp_path: Path) -> None:
    heading = ["Northing", "Easting", "Hz", "V", "Height", *HEADING[:6]]
    rows = np.column_stack([MM[:, [1, 0]], MM[:, :2], MM[:, 2], DEG])
    path = write_table(tmp_path / "rows.csv", [",".join(heading), *text_rows(rows)])
    found = read_measurements(path, MODEL)
    assert found.layout.position == ("Easting", "Northing", "Height")


@pytest.mark.parametrize(
    "word",
    ["Ecart-type", "ecart type", "Среднее", "Максимум", "平均値", "標準偏差", "평균", "Média", "Massimo"],
)
def test_summaries_of_further_languages_are_no_readings(tmp_path: Path, word: str) -> None:
    rows = [f"P{i}," + text for i, text in enumerate(text_rows(ROWS))]
    numbers = text_rows(np.full((1, 9), 3.0))[0]
    table = read_table(
        write_table(tmp_path / "rows.csv", [",".join(["Point", *HEADING]), *rows, f"{word},{numbers}"])
    )
    assert len(table) == len(ROWS)
    assert word in table.dialect


@pytest.mark.parametrize(
    "statistics",
    [
        [np.mean],
        [np.mean, lambda rows, axis: np.std(rows, axis=axis, ddof=1)],
        [np.min, np.max, np.mean, np.std],
        [np.median, np.ptp],
    ],
)
@pytest.mark.parametrize("digits", [2, 4])
def test_rows_that_nothing_names_but_sum_others_up_are_no_readings(
    tmp_path: Path, statistics, digits: int
) -> None:
    last = np.array([of(ROWS, axis=0) for of in statistics])
    lines = [",".join(HEADING), *text_rows(ROWS), *text_rows(last, digits=digits)]
    table = read_table(write_table(tmp_path / "rows.csv", lines))
    assert len(table) == len(ROWS)
    assert "summaries of rows left out" in table.dialect


def test_a_posture_in_the_middle_of_all_joints_is_a_reading(tmp_path: Path) -> None:
    middle = np.concatenate([DEG.mean(axis=0), MM[3]])
    lines = [",".join(HEADING), *text_rows(ROWS), *text_rows(middle[None])]
    assert len(read_table(write_table(tmp_path / "rows.csv", lines))) == len(ROWS) + 1


def test_decimal_commas_among_commas_are_reported(tmp_path: Path) -> None:
    path = write_table(tmp_path / "rows.csv", [",".join(HEADING), *text_rows(ROWS, ",", ",")])
    with pytest.raises(MeasurementError, match="line 1 names 9 columns, and the rows hold 18") as refused:
        read_measurements(path, MODEL)
    assert "semicolons" in refused.value.remedy


def test_a_table_that_lies_on_its_side_is_reported(tmp_path: Path) -> None:
    lines = [f"{name},{text}" for name, text in zip(HEADING, text_rows(ROWS.T), strict=True)]
    with pytest.raises(MeasurementError, match="first column") as refused:
        read_measurements(write_table(tmp_path / "rows.csv", lines), MODEL)
    assert "transposed" in refused.value.remedy


SEVEN = [f"joint{at}" for at in range(1, 8)]


@pytest.mark.parametrize(
    ("headings", "joints"),
    [
        ([f".position[{at}]" for at in range(9)], [f".position[{at}]" for at in range(7)]),
        ([f"field.position{at}" for at in range(8)], [f"field.position{at}" for at in range(7)]),
        ([f"q_cmd{at}" for at in range(1, 8)] + [f"q_meas{at}" for at in range(1, 8)], None),
        ([f"q_des_{at}" for at in range(1, 8)] + [f"q_{at}" for at in range(1, 8)], None),
    ],
)
def test_elements_of_an_array_and_words_beside_the_letter(
    headings: list[str], joints: list[str] | None
) -> None:
    """Fingers stand behind the arm's elements; what the arm had goes before what it was told."""
    found = detect_layout([*headings, "x", "y", "z"], SEVEN).joints
    assert found == tuple(joints or headings[-7:])


def test_columns_by_number_are_those_that_hold_numbers(tmp_path: Path) -> None:
    lines = [f"A,Main,P{i},{text}" for i, text in enumerate(text_rows(ROWS))]
    few = write_table(tmp_path / "few.txt", ["// SpatialAnalyzer", *lines[:10]])
    with pytest.raises(MeasurementError) as refused:
        read_measurements(few, MODEL)
    assert "joints=4,5,6,7,8,9" in refused.value.remedy
    assert "position=10,11,12" in refused.value.remedy
    found = read_measurements(write_table(tmp_path / "rows.txt", ["// SpatialAnalyzer", *lines]), MODEL)
    assert found.layout.joints == tuple(f"column {at}" for at in range(4, 10))
    assert found.layout.position == tuple(f"column {at}" for at in range(10, 13))


def test_attitudes_show_which_way_the_last_joint_turns() -> None:
    poses = POSES.observations
    place = MODEL.base_flange(poses.joints_rad) @ np.array([0.0, 0.0, 0.1, 1.0])
    points = PointObservations(poses.joints_rad, place[:, :3], poses.sigma_m, poses.mounting)
    assert last_joint_note(MODEL, points)
    on_axis = type(poses)(
        poses.joints_rad, place[:, :3], poses.sigma_m, poses.mounting, poses.rotations, poses.sigma_rad
    )
    assert not last_joint_note(MODEL, on_axis)


@pytest.mark.parametrize(
    ("columns", "joints", "slides", "found"),
    [
        ("rail J1 J2 J3 X Y Z", "rail a b c", (True, False, False, False), "rail J1 J2 J3"),
        ("J1 J2 J3 table X Y Z", "a b c table", (), "J1 J2 J3 table"),
        ("rax_1 rax_2 rax_3 eax_a X Y Z", "carriage a b c", (True, False, False, False), "eax_a rax_1 rax_2 rax_3"),
        ("J1 J2 J3 Track X Y Z", "carriage a b c", (True, False, False, False), "Track J1 J2 J3"),
        ("E1 E2 X Y Z", "tilt turn", (), "E1 E2"),
        ("J7 J8 X Y Z", "tilt turn", (), "J7 J8"),
    ],
)  # fmt: skip
def test_axes_outside_the_arm_by_their_names(
    columns: str, joints: str, slides: tuple[bool, ...], found: str
) -> None:
    layout = detect_layout(columns.split(), joints.split(), slides=slides)
    assert layout.joints == tuple(found.split())


@pytest.mark.parametrize("columns", ["E1 E2 E3 X Y Z", "J7 J8 J9 X Y Z", "E1 E2 J1 J2 J3 X Y Z"])
def test_axes_that_may_be_others_are_asked_for(columns: str) -> None:
    joints = ["tilt", "turn"] if "J1" not in columns else ["a", "b", "c", "tilt"]
    with pytest.raises(MeasurementError, match="joint columns"):
        detect_layout(columns.split(), joints)


@pytest.mark.parametrize(
    ("joints", "turn"),
    [
        ("q1 q2 q3 q4 q5 q6", "Q0 Q1 Q2 Q3"),
        ("Q1 Q2 Q3 Q4 Q5 Q6", "q1 q2 q3 q4"),
        ("q1 q2 q3 q4", "Q1 Q2 Q3 Q4"),
    ],
)
def test_joints_and_a_quaternion_that_differ_by_their_capitals(joints: str, turn: str) -> None:
    names = [*joints.split(), "X", "Y", "Z", *turn.split()]
    layout = detect_layout(names, [f"J{i + 1}" for i in range(len(joints.split()))])
    assert layout.joints == tuple(joints.split())
    assert layout.turn == tuple(turn.split())
    assert layout.position == ("X", "Y", "Z")
