"""Measurement files are read as instruments write them, and refused with the option that helps."""

import numpy as np
import openpyxl
import pytest

from cellcal.calibration.arm.kinematics import load_model
from cellcal.calibration.orientation import values_from
from cellcal.service.engineering.measured.columns import detect_layout
from cellcal.service.engineering.measured.measurements import ReadOptions, read_measurements
from cellcal.service.engineering.measured.table import MeasurementError, read_table
from cellcal.service.engineering.measured.units import to_celsius
from tests.unit.helpers.simulated_arm import tracker_poses

JOINTS = (
    "shoulder_pan_joint",
    "shoulder_lift_joint",
    "elbow_joint",
    "wrist_1_joint",
    "wrist_2_joint",
    "wrist_3_joint",
)
UR10 = load_model("ur10")
POSES = tracker_poses("ur10", 40)
ANGLES = POSES.observations.joints_rad
POINTS = POSES.observations.positions_m


def file_text(names, columns, separator=",", comma=False, digits=9):
    def format_cell(value):
        written = value if isinstance(value, str) else f"{value:.{digits}g}"
        return written.replace(".", ",") if comma else written

    lines = [separator.join(names), *(separator.join(format_cell(v) for v in row) for row in columns)]
    return "\n".join(lines) + "\n"


def write_file(tmp_path, content, name="measured.csv", encoding="utf-8"):
    path = tmp_path / name
    path.write_bytes(content.encode(encoding))
    return path


def table_of(joints=ANGLES, points=POINTS):
    return np.concatenate([joints, points], axis=1)


Q = [f"q{i}" for i in range(1, 7)]


@pytest.mark.parametrize(
    ("separator", "comma"),
    [(",", False), (";", False), (";", True), ("\t", False), ("\t", True), (" ", False), ("|", True)],
)
def test_separators_and_decimal_commas(tmp_path, separator, comma):
    path = write_file(tmp_path, file_text([*Q, "x", "y", "z"], table_of(), separator, comma))
    found = read_measurements(path, UR10)
    assert np.allclose(found.observations.joints_rad, ANGLES, atol=1e-8)
    assert np.allclose(found.observations.positions_m, POINTS, atol=1e-8)


@pytest.mark.parametrize("encoding", ["utf-8-sig", "utf-16", "cp1252"])
def test_encodings_of_instruments(tmp_path, encoding):
    names = [*(f"{q} [°]" for q in Q), "X [mm]", "Y [mm]", "Z [mm]"]
    path = write_file(
        tmp_path, file_text(names, table_of(np.rad2deg(ANGLES), POINTS * 1e3)), encoding=encoding
    )
    found = read_measurements(path, UR10)
    assert np.allclose(found.observations.joints_rad, ANGLES, atol=1e-7)
    assert np.allclose(found.observations.positions_m, POINTS, atol=1e-7)


@pytest.mark.parametrize("angle", ["deg", "rad"])
@pytest.mark.parametrize("length", ["mm", "m"])
@pytest.mark.parametrize("stated", [True, False])
def test_units_are_read_from_names_or_guessed_and_reported(tmp_path, angle, length, stated):
    joints = np.rad2deg(ANGLES) if angle == "deg" else ANGLES
    points = POINTS * (1e3 if length == "mm" else 1.0)
    names = [*Q, "x", "y", "z"]
    if stated:
        names = [*(f"{q} ({angle})" for q in Q), *(f"{axis}_{length}" for axis in "xyz")]
    found = read_measurements(write_file(tmp_path, file_text(names, table_of(joints, points))), UR10)
    assert np.allclose(found.observations.joints_rad, ANGLES, atol=1e-7)
    assert np.allclose(found.observations.positions_m, POINTS, atol=1e-7)
    assert any(f"taken as {angle}" in guess for guess in found.guesses) is not stated


@pytest.mark.parametrize(
    "joints",
    [
        JOINTS,
        [f"J{i}" for i in range(1, 7)],
        [f"joint_{i}" for i in range(6)],
        [f"Axis {i}" for i in range(1, 7)],
        [f"A{i}" for i in range(1, 7)],
        [f"actual_q_{i}" for i in range(6)],
        [f"theta{i} [rad]" for i in range(1, 7)],
        ["Base", "Shoulder", "Elbow", "Wrist 1", "Wrist 2", "Wrist 3"],
    ],
)
@pytest.mark.parametrize(
    "position",
    [
        ("x", "y", "z"),
        ("X [m]", "Y [m]", "Z [m]"),
        ("meas_x", "meas_y", "meas_z"),
        ("pos_x", "pos_y", "pos_z"),
        ("x1", "y1", "z1"),
    ],
)
def test_names_of_columns(tmp_path, joints, position):
    found = read_measurements(write_file(tmp_path, file_text([*joints, *position], table_of())), UR10)
    assert np.allclose(found.observations.joints_rad, ANGLES, atol=1e-8)
    assert np.allclose(found.observations.positions_m, POINTS, atol=1e-8)


def test_measured_columns_are_distinguished_from_commanded_ones():
    names = [
        "Timestamp",
        "Goal x",
        "Goal y",
        "Goal z",
        *JOINTS,
        "tracker x",
        "tracker y",
        "tracker z",
        "tracker_std_x",
        "tracker_std_y",
        "tracker_std_z",
        "temperature",
    ]
    layout = detect_layout(names, JOINTS)
    assert layout.position == ("tracker x", "tracker y", "tracker z")
    assert layout.controller == ("Goal x", "Goal y", "Goal z")
    assert layout.spread == ("tracker_std_x", "tracker_std_y", "tracker_std_z")
    assert layout.temperature == "temperature"


def test_actual_joints_are_preferred_to_commanded_ones():
    names = [
        *(f"target_q_{i}" for i in range(6)),
        *(f"actual_q_{i}" for i in range(6)),
        *(f"actual_qd_{i}" for i in range(6)),
        "x",
        "y",
        "z",
    ]
    assert detect_layout(names, JOINTS).joints == tuple(f"actual_q_{i}" for i in range(6))


def test_beside_a_length_positions_are_the_controllers():
    layout = detect_layout(["x", "y", "z", *Q, "L"], JOINTS)
    assert layout.length == "L"
    assert layout.position == ()
    assert layout.controller == ("x", "y", "z")


def test_options_name_what_guessing_cannot(tmp_path):
    names = [*"abcdef", "u", "v", "w"]
    path = write_file(tmp_path, file_text(names, table_of(np.rad2deg(ANGLES), POINTS * 1e3)))
    with pytest.raises(MeasurementError) as caught:
        read_measurements(path, UR10)
    assert "--columns joints=" in caught.value.remedy
    options = ReadOptions(
        {"joints": tuple("abcdef"), "position": ("u", "v", "w")}, {"joints": "deg", "position": "mm"}
    )
    found = read_measurements(path, UR10, options)
    assert np.allclose(found.observations.positions_m, POINTS, atol=1e-7)


@pytest.mark.parametrize(
    ("options", "says"),
    [
        (ReadOptions({"joints": ("nothing",)}), "no column"),
        (ReadOptions({"sensor": ("x",)}), "knows no"),
        (ReadOptions(units={"joints": "furlong"}), "furlong"),
    ],
)
def test_wrong_options_are_refused(tmp_path, options, says):
    path = write_file(tmp_path, file_text([*Q, "x", "y", "z"], table_of()))
    with pytest.raises(MeasurementError, match=says):
        read_measurements(path, UR10, options)


def test_rows_that_cannot_be_used_are_rejected_with_line_and_reason(tmp_path):
    lines = file_text([*Q, "x", "y", "z"], table_of()).splitlines()
    lines[3] = lines[3].rsplit(",", 1)[0] + ","
    lines[5] = lines[5].rsplit(",", 2)[0]
    lines[7] = lines[7].replace(lines[7].split(",")[0], "NaN", 1)
    lines[9] = "inf" + lines[9][lines[9].index(",") :]
    lines.insert(11, "")
    found = read_measurements(write_file(tmp_path, "\n".join(lines)), UR10)
    assert [item.row for item in found.rejected] == [2, 4, 6, 8]
    assert "line 4: column 'z' is empty" in found.rejected[0].reason
    assert "'NaN'" in found.rejected[2].reason
    assert found.read == 40
    assert len(found.rows) == len(found.observations) == 36
    assert np.allclose(found.observations.positions_m, POINTS[found.rows], atol=1e-8)


def test_a_preamble_a_comment_mark_and_a_line_of_units(tmp_path):
    body = file_text([*Q, "x", "y", "z"], table_of(np.rad2deg(ANGLES), POINTS * 1e3)).splitlines()
    units = ",".join(["deg"] * 6 + ["mm"] * 3)
    content = "\n".join(["Tracker Software 3.1", "Operator: N. N.", "", "# " + body[0], units, *body[1:]])
    found = read_measurements(write_file(tmp_path, content), UR10)
    assert np.allclose(found.observations.joints_rad, ANGLES, atol=1e-7)
    assert not [guess for guess in found.guesses if "taken as" in guess]


@pytest.mark.parametrize("convention", ["ur_rotation_vector", "ros_rpy", "instrument_xyz", "kuka_abc"])
def test_the_orientation_convention_is_the_one_in_which_the_tool_sits_still(tmp_path, convention):
    turns = values_from(convention, POSES.observations.rotations)
    path = write_file(
        tmp_path,
        file_text([*Q, "x", "y", "z", "rx", "ry", "rz"], np.concatenate([table_of(), turns], axis=1)),
    )
    found = read_measurements(path, UR10)
    assert found.observations.kind == "pose"
    assert np.allclose(found.observations.rotations, POSES.observations.rotations, atol=1e-7)


def test_quaternions_are_read_by_name(tmp_path):
    turns = values_from("abb_quaternion", POSES.observations.rotations)[:, [1, 2, 3, 0]]
    names = [*Q, "x", "y", "z", "qx", "qy", "qz", "qw"]
    found = read_measurements(
        write_file(tmp_path, file_text(names, np.concatenate([table_of(), turns], axis=1))), UR10
    )
    assert np.allclose(found.observations.rotations, POSES.observations.rotations, atol=1e-7)


def test_attitudes_that_fit_no_convention_are_left_out_with_a_remark(tmp_path):
    turns = np.random.default_rng(0).uniform(-3, 3, (40, 3))
    path = write_file(
        tmp_path,
        file_text([*Q, "x", "y", "z", "rx", "ry", "rz"], np.concatenate([table_of(), turns], axis=1)),
    )
    found = read_measurements(path, UR10)
    assert found.observations.kind == "point"
    assert any("attitudes left out" in guess for guess in found.guesses)


def test_groups_of_the_file_are_kept(tmp_path):
    rows = [[*row, f"run {i // 8}"] for i, row in enumerate(table_of())]
    found = read_measurements(write_file(tmp_path, file_text([*Q, "x", "y", "z", "session"], rows)), UR10)
    assert list(found.groups) == [i // 8 for i in range(40)]


def test_excel_files(tmp_path):
    book = openpyxl.Workbook()
    book.active.append(["made by", "a technician"])
    sheet = book.create_sheet("data")
    sheet.append([*Q, "x", "y", "z"])
    for row in table_of():
        sheet.append([float(v) for v in row])
    sheet["C5"] = None
    path = tmp_path / "measured.xlsx"
    book.save(path)
    found = read_measurements(path, UR10)
    assert [item.row for item in found.rejected] == [3]
    assert np.allclose(found.observations.positions_m, np.delete(POINTS, 3, axis=0))
    with pytest.raises(MeasurementError, match="no sheet"):
        read_table(path, sheet="other")


@pytest.mark.parametrize(
    "content", ["", "hello\nworld\n", "1,2,3\n4,5,6\n", "a,a,b\n1,2,3\n", "q1;q2\n", "\x00\x01\x02"]
)
def test_what_is_no_table_is_refused_in_one_sentence(tmp_path, content):
    with pytest.raises(MeasurementError) as caught:
        read_measurements(write_file(tmp_path, content), UR10)
    assert caught.value.remedy


def test_a_missing_file_and_a_broken_excel_file(tmp_path):
    with pytest.raises(MeasurementError, match="there is no file"):
        read_table(tmp_path / "none.csv")
    with pytest.raises(MeasurementError, match="no Excel file"):
        read_table(write_file(tmp_path, "not a zip", "broken.xlsx"))


@pytest.mark.parametrize(
    "heads", ["Hz,V,D", "Hz [gon],V [gon],SD [m]", "Azimuth,Elevation,Range", "HA,ZE,dist"]
)
def test_directions_of_an_instrument_are_not_taken_for_a_wire(tmp_path, heads):
    file = tmp_path / "polar.csv"
    rows = [f"{k},{2 * k},{3 * k},{4 * k},{5 * k},{6 * k},120.5,88.2,{2000 + k}" for k in range(20)]
    file.write_text("\n".join([f"J1,J2,J3,J4,J5,J6,{heads}", *rows]))
    with pytest.raises(MeasurementError, match="are directions of an instrument"):
        read_measurements(file, UR10)
    distance = ReadOptions(columns={"length": ("9",)})
    assert len(read_measurements(file, UR10, distance).rows) == 20


def test_positions_of_the_controller_are_no_measurement(tmp_path):
    path = write_file(tmp_path, file_text([*Q, "goal_x", "goal_y", "goal_z"], table_of()))
    with pytest.raises(MeasurementError, match="no measurement found"):
        read_measurements(path, UR10)


@pytest.mark.parametrize(
    ("heading", "written"),
    [
        ("Temperature [°F]", 71.6),
        ("Temp (F)", 71.6),
        ("temp_F", 71.6),
        ("Temp [K]", 295.15),
        ("Temp [°C]", 22.0),
        ("Temp Ref", 22.0),
    ],
)
def test_temperatures_come_in_celsius(heading, written):
    assert to_celsius(np.array([written]), heading) == pytest.approx([22.0])


GANTRY = ["x [mm]", "y [mm]", "z [mm]", "a [deg]", "X [mm]", "Y [mm]", "Z [mm]"]


def test_joints_called_as_a_place_are_recognised_by_their_letters():
    layout = detect_layout(GANTRY, ["x", "y", "z", "a"], slides=(True, True, True, False))
    assert layout.joints == tuple(GANTRY[:4])
    assert layout.position == tuple(GANTRY[4:])
    typed = {"joints": ["x", "y", "z", "a"], "position": ["X", "Y", "Z"]}
    slides = (True, True, True, False)
    assert detect_layout(GANTRY, ["j1", "j2", "j3", "j4"], typed, slides).joints == tuple(GANTRY[:4])


def test_joints_called_as_the_only_place_are_not_the_joints():
    layout = detect_layout(["q1", "q2", "q3", "x", "y", "z"], ["x", "y", "z"])
    assert layout.joints == ("q1", "q2", "q3")
    assert layout.position == ("x", "y", "z")


def test_no_column_is_taken_for_two_joints():
    """Two joints whose names differ by a letter's case only would both be the one column."""
    with pytest.raises(MeasurementError, match="no 2 joint columns") as refused:
        detect_layout(["elbow", "wrist", "x", "y", "z", "t"], ["elbow", "Elbow"])
    assert "(elbow, Elbow) in this order" in refused.value.remedy
    assert detect_layout(["Elbow", "elbow", "x", "y", "z"], ["elbow", "Elbow"]).joints == ("elbow", "Elbow")
