"""Tables as recordings of messages, programs, Markdown and spreadsheets with merged cells write them."""

from pathlib import Path

import numpy as np
import openpyxl
import pytest

from cellcal.calibration.arm.kinematics import load_model
from cellcal.calibration.geometry import quaternion_from_rotation
from cellcal.calibration.identification.observations import PoseObservations
from cellcal.service.engineering.measured.measurements import read_measurements
from cellcal.service.engineering.measured.table import MeasurementError, read_table
from tests.unit.helpers.simulated_arm import tracker_poses

MODEL = load_model("abb_irb120")
UR = load_model("ur10e")
POSES = tracker_poses("abb_irb120", 40)
DEG = np.rad2deg(POSES.observations.joints_rad)
MM = POSES.observations.positions_m * 1e3
TURNS = POSES.observations.rotations
HEADING = [*(f"J{i}" for i in range(1, 7)), "X", "Y", "Z"]


def write_table(path: Path, heading: list[str], lines: list[str]) -> Path:
    path.write_text("\n".join([*heading, *lines, ""]), encoding="utf-8")
    return path


def joined(row: np.ndarray, separator: str = ",", form: str = "{:.4f}") -> str:
    return separator.join(form.format(number) for number in row)


def assert_read(path: Path, heading: tuple[str, ...] | None = None) -> None:
    found = read_measurements(path, MODEL)
    assert np.allclose(np.rad2deg(found.observations.joints_rad), DEG, atol=1e-3)
    assert np.allclose(found.observations.positions_m * 1e3, MM, atol=1e-3)
    assert heading is None or found.layout.joints == heading


@pytest.mark.parametrize("letter", ["D", "d"])
def test_exponents_of_fortran_are_numbers(tmp_path: Path, letter: str) -> None:
    rows = [joined(row, " ", "{:.9E}").replace("E", letter) for row in np.column_stack([DEG, MM])]
    assert_read(write_table(tmp_path / "rows.txt", [" ".join(HEADING)], rows))


@pytest.mark.parametrize(
    "joint",
    [
        "field.position{}",
        "/joint_states/position[{}]",
        "Joint angles [deg] {}",
        "robot.joints_{}",
        "jointtarget{}",
    ],
)
def test_joints_of_recorded_messages(tmp_path: Path, joint: str) -> None:
    first = 0 if "position" in joint else 1
    joints = [joint.format(first + i) for i in range(6)]
    names = [*joints, *(name.replace("position", "velocity") + "_vel" for name in joints), "X", "Y", "Z"]
    rows = [joined(row) for row in np.column_stack([DEG, DEG * 0.1, MM])]
    assert_read(write_table(tmp_path / "rows.csv", [",".join(names)], rows), tuple(joints))


def test_joints_are_found_among_other_words_in_the_robots_order(tmp_path: Path) -> None:
    # ROS writes the joints of a message by the alphabet.
    order = [UR.joint_names.index(name) for name in sorted(UR.joint_names)]
    kinds = ("effort", "position", "velocity")
    names = [f"/joint_states/{UR.joint_names[at]}/{kind}" for kind in kinds for at in order]
    rows = [joined(row) for row in np.column_stack([DEG[:, order] * 7, DEG[:, order], DEG[:, order] * 3, MM])]
    path = write_table(tmp_path / "rows.csv", [",".join([*names, "x", "y", "z"])], rows)
    found = read_measurements(path, UR)
    assert found.layout.joints == tuple(f"/joint_states/{name}/position" for name in UR.joint_names)
    assert np.allclose(np.rad2deg(found.observations.joints_rad), DEG, atol=1e-3)


@pytest.mark.parametrize(
    ("cell", "heading"),
    [
        ("[[{}],[9E9,9E9,9E9,9E9,9E9,9E9]]", "jointtarget"),
        ("[{}]", "q"),
        ("({})", "axes"),
        ("{{A1 {}}}", "axis"),
    ],
)
@pytest.mark.parametrize("separator", [";", "\t", ","])
def test_lists_in_cells_become_columns(tmp_path: Path, cell: str, heading: str, separator: str) -> None:
    rows = []
    for joints, place in zip(DEG, MM, strict=True):
        inside = joined(joints, ", ")
        if "A1" in cell:
            inside = ",A".join(f"{i} {joint:.4f}" for i, joint in enumerate(joints, start=1))[2:]
        text = cell.format(inside)
        rows.append(
            separator.join(["P1", f'"{text}"' if separator == "," else text, joined(place, separator)])
        )
    names = separator.join(["name", heading, "X", "Y", "Z"])
    assert_read(write_table(tmp_path / "rows.csv", [names], rows))


def test_a_pose_in_a_cell_is_read_as_place_and_attitude(tmp_path: Path) -> None:
    quaternions = quaternion_from_rotation(TURNS)
    rows = [
        f"[{joined(q)}];[[{joined(p)}],[{joined(w, form='{:.7f}')}]]"
        for q, p, w in zip(DEG, MM, quaternions, strict=True)
    ]
    found = read_measurements(write_table(tmp_path / "rows.csv", ["q;tool pose"], rows), MODEL)
    assert found.convention == "abb_quaternion"
    assert np.allclose(found.observations.positions_m * 1e3, MM, atol=1e-3)


def test_a_robtarget_beside_the_joints_is_the_controllers(tmp_path: Path) -> None:
    quaternions = quaternion_from_rotation(TURNS)
    rows = [
        f"[[{joined(p + 30.0)}],[{joined(w)}],[0,0,0,0],[9E9,9E9,9E9,9E9,9E9,9E9]];{joined(q, ';')};{joined(p, ';')}"
        for q, p, w in zip(DEG, MM, quaternions, strict=True)
    ]
    assert_read(write_table(tmp_path / "rows.csv", [";".join(["robtarget", *HEADING])], rows))


def test_positions_of_a_program_are_no_measurements(tmp_path: Path) -> None:
    rows = [
        f"  CONST jointtarget p{i}:=[[{joined(q)}],[9E9,9E9,9E9,9E9,9E9,9E9]];" for i, q in enumerate(DEG)
    ]
    with pytest.raises(MeasurementError, match="positions of a program") as refused:
        read_table(write_table(tmp_path / "points.mod", ["MODULE points"], [*rows, "ENDMODULE"]))
    assert "column of its own" in str(refused.value.remedy)


def test_lists_with_semicolons_have_decimal_commas(tmp_path: Path) -> None:
    rows = [
        f"[{joined(q, '; ').replace('.', ',')}]\t[{joined(p, '; ').replace('.', ',')}]"
        for q, p in zip(DEG, MM, strict=True)
    ]
    assert_read(write_table(tmp_path / "rows.csv", ["q\tmeasured"], rows))


def test_lists_of_different_lengths_are_refused_with_their_line(tmp_path: Path) -> None:
    rows = [
        f"[{joined(q[: 6 - i % 2])}];{joined(p, ';')}" for i, (q, p) in enumerate(zip(DEG, MM, strict=True))
    ]
    with pytest.raises(MeasurementError, match="line 2 holds a list"):
        read_table(write_table(tmp_path / "rows.csv", ["q;X;Y;Z"], rows))


@pytest.mark.parametrize("rule", ["|" + "---|" * 9, "|" + " :---: |" * 9, "+" + "=====+" * 9])
def test_rules_of_markdown_are_no_part_of_a_heading(tmp_path: Path, rule: str) -> None:
    rows = [f"| {joined(row, ' | ')} |" for row in np.column_stack([DEG, MM])]
    assert_read(
        write_table(tmp_path / "rows.md", [f"| {' | '.join(HEADING)} |", rule], rows), tuple(HEADING[:6])
    )


def test_joints_counted_below_a_merged_heading(tmp_path: Path) -> None:
    above = ["Pose,Joint angles [deg],,,,,,Measured [mm],,", ",1,2,3,4,5,6,X,Y,Z"]
    rows = [f"{i},{joined(row)}" for i, row in enumerate(np.column_stack([DEG, MM]))]
    assert_read(write_table(tmp_path / "rows.csv", above, rows))


def test_a_first_posture_of_zeros_without_a_reading_is_no_heading(tmp_path: Path) -> None:
    rows = [joined(row) for row in np.column_stack([DEG, MM])]
    path = write_table(tmp_path / "rows.csv", [",".join(HEADING), "0,0,0,0,0,0,lost,lost,lost"], rows)
    assert_read(path, tuple(HEADING[:6]))
    assert len(read_table(path)) == len(DEG) + 1


def merged(count: int) -> list[str]:
    rows = []
    for joints, place in zip(DEG, MM, strict=True):
        for sample in range(count):
            shown = joined(joints) if sample == 0 else "," * 5
            rows.append(f"{shown},{joined(place + 0.01 * sample)}")
    return rows


def test_joints_in_merged_cells_belong_to_each_reading(tmp_path: Path) -> None:
    found = read_measurements(write_table(tmp_path / "rows.csv", [",".join(HEADING)], merged(4)), MODEL)
    assert len(found.observations) == 160
    assert np.allclose(np.rad2deg(found.observations.joints_rad), np.repeat(DEG, 4, axis=0), atol=1e-3)
    assert any("4 readings a posture" in guess for guess in found.guesses)


@pytest.mark.parametrize("between", [1, 3])
def test_a_device_that_reads_more_often_than_the_controller_while_the_arm_moves(
    tmp_path: Path, between: int
) -> None:
    way = np.linspace(0.0, 1.0, 41 * (between + 1))[:, None]
    places = np.array([400.0, -200.0, 900.0]) + way * [60.0, 25.0, -40.0]
    joints = np.array([10.0, -70.0, 80.0, 15.0, 40.0, -20.0]) + way * [12.0, 8.0, -15.0, 20.0, 9.0, 30.0]
    rows = [
        f"{joined(q) if i % (between + 1) == 0 else ',' * 5},{joined(p)}"
        for i, (q, p) in enumerate(zip(joints, places, strict=True))
    ]
    found = read_measurements(write_table(tmp_path / "rows.csv", [",".join(HEADING)], rows), MODEL)
    assert len(found.observations) == 41
    assert not any("readings a posture" in guess for guess in found.guesses)


def test_rows_whose_joints_were_not_recorded_are_not_filled(tmp_path: Path) -> None:
    rows = [
        f"{',' * 5 if i % 9 == 4 else joined(q)},{joined(p)}"
        for i, (q, p) in enumerate(zip(DEG, MM, strict=True))
    ]
    found = read_measurements(write_table(tmp_path / "rows.csv", [",".join(HEADING)], rows), MODEL)
    assert len(found.observations) == 36
    assert len(found.rejected) == 4


@pytest.mark.parametrize(
    ("joint", "place"),
    [("As {} (graden)", "Gemeten {}"), ("Axel {} (grader)", "Uppmätt {}"), ("Akse {}", "Målt {}")],
)
def test_headings_of_the_north(tmp_path: Path, joint: str, place: str) -> None:
    names = [*(joint.format(i) for i in range(1, 7)), *(place.format(axis) for axis in "XYZ")]
    rows = [joined(row, ";") for row in np.column_stack([DEG, MM])]
    assert_read(write_table(tmp_path / "rows.csv", [";".join(names)], rows), tuple(names[:6]))


@pytest.mark.parametrize("separator", [",", ";", "\t"])
def test_lists_in_quotes_without_brackets(tmp_path: Path, separator: str) -> None:
    rows = [
        separator.join([f'"{joined(joints, ", ")}"', *(f"{number:.4f}" for number in place), '"ok"'])
        for joints, place in zip(DEG, MM, strict=True)
    ]
    heading = separator.join(["Joints", "X", "Y", "Z", "State"])
    assert_read(
        write_table(tmp_path / "rows.csv", [heading], rows), tuple(f"Joints_{at}" for at in range(1, 7))
    )


def test_numbers_between_quoted_words_are_no_list(tmp_path: Path) -> None:
    rows = ['"a"\t' + joined(row, "\t") + '\t"b"' for row in np.column_stack([DEG, MM])]
    assert_read(write_table(tmp_path / "rows.csv", ["\t".join(["Name", *HEADING, "State"])], rows))


def test_quoted_marks_of_thousands_are_no_list(tmp_path: Path) -> None:
    rows = [";".join(f'"{number:,.4f}"' for number in row) for row in np.column_stack([DEG, MM * 1e3])]
    found = read_measurements(write_table(tmp_path / "rows.csv", [";".join(HEADING)], rows), MODEL)
    assert found.layout.joints == tuple(HEADING[:6])


@pytest.mark.parametrize(
    ("mean", "spread"), [("Mean", "Std"), ("P{} average", "P{} range"), ("P{} Mittelwert", "P{} Spannweite")]
)
def test_summaries_of_each_posture_are_no_readings(tmp_path: Path, mean: str, spread: str) -> None:
    lines, rng = [], np.random.default_rng(0)
    for at, (joints, place) in enumerate(zip(DEG, MM, strict=True), 1):
        readings = place + 0.03 * rng.standard_normal((3, 3))
        lines += [f"P{at}.{i},{joined(joints)},{joined(row)}" for i, row in enumerate(readings, 1)]
        lines.append(f"{mean.format(at)},{joined(joints)},{joined(readings.mean(axis=0))}")
        of = np.std(readings, axis=0, ddof=1) if spread == "Std" else np.ptp(readings, axis=0)
        lines.append(f"{spread.format(at)},{joined(0.0 * joints)},{joined(of)}")
    found = read_measurements(
        write_table(tmp_path / "rows.csv", [",".join(["Name", *HEADING])], lines), MODEL
    )
    assert len(found.observations) == found.read == 3 * len(MM)
    assert "and 74 more" in found.guesses[0]


def test_words_beside_readings_that_are_no_statistic_name_them(tmp_path: Path) -> None:
    """Payload or speed: minimum and maximum of a setting, not of the rows above."""
    words = ["half", "min", "max"]
    lines = [f"{words[at % 3]},{joined(row)}" for at, row in enumerate(np.column_stack([DEG, MM]))]
    found = read_measurements(
        write_table(tmp_path / "rows.csv", [",".join(["Speed", *HEADING])], lines), MODEL
    )
    assert found.read == len(MM)


@pytest.mark.parametrize(
    ("heading", "robot", "order"),
    [
        ("S,L,U,R,B,T,E", "yaskawa_sia20d", "S,L,E,U,R,B,T"),
        ("S,L,E,U,R,B,T", "yaskawa_sia20d", "S,L,E,U,R,B,T"),
        (
            "rax_1,rax_2,rax_3,rax_4,rax_5,rax_6,eax_a",
            "kuka_lbr_iiwa14_r820",
            "rax_1,rax_2,eax_a,rax_3,rax_4,rax_5,rax_6",
        ),
        ("A1,A2,A3,A4,A5,A6,E1", "kuka_lbr_iiwa14_r820", "A1,A2,E1,A3,A4,A5,A6"),
    ],
)
def test_the_redundant_joint_stands_third(tmp_path: Path, heading: str, robot: str, order: str) -> None:
    rows = [joined(row) for row in np.random.default_rng(1).uniform(-60, 60, (20, 10))]
    found = read_measurements(
        write_table(tmp_path / "rows.csv", [f"{heading},X,Y,Z"], rows), load_model(robot)
    )
    assert found.layout.joints == tuple(order.split(","))


@pytest.mark.parametrize(("count", "along"), [(16, "rows"), (16, "columns"), (12, "rows"), (12, "columns")])
def test_a_pose_as_a_numbered_list_is_read_along_rows_or_columns(
    tmp_path: Path, count: int, along: str
) -> None:
    poses = np.zeros((len(MM), 4, 4))
    poses[:, :3, :3], poses[:, :3, 3], poses[:, 3, 3] = TURNS, MM / 1e3, 1.0
    poses = poses[:, : count // 4]
    lists = (poses if along == "rows" else np.swapaxes(poses, 1, 2)).reshape(len(MM), count)
    names = [*HEADING[:6], *(f"T_meas[{i}]" for i in range(count))]
    rows = [joined(row, form="{:.7f}") for row in np.column_stack([DEG, lists])]
    found = read_measurements(write_table(tmp_path / "rows.csv", [",".join(names)], rows), MODEL)
    assert np.allclose(found.observations.positions_m * 1e3, MM, atol=1e-3)
    assert isinstance(found.observations, PoseObservations)
    assert np.allclose(found.observations.rotations, TURNS, atol=1e-5)


@pytest.mark.parametrize(
    ("names", "says"),
    [
        ([f"O_T_EE_{i}" for i in range(16)], "calculates from its joints"),
        (
            ["X nom", "Y nom", "Z nom", "dX", "dY", "dZ"],
            "dX, dY, dZ are differences from X nom, Y nom, Z nom",
        ),
        (["Z"], "Z tell a part of a place"),
    ],
)
def test_what_is_missing_of_a_measurement_is_said(tmp_path: Path, names: list[str], says: str) -> None:
    poses = np.tile(np.eye(4).ravel(), (len(MM), 1))[:, : len(names)] + 0.0 * MM[:, :1]
    rows = [joined(row) for row in np.column_stack([DEG, poses])]
    with pytest.raises(MeasurementError) as refused:
        read_measurements(write_table(tmp_path / "rows.csv", [",".join([*HEADING[:6], *names])], rows), MODEL)
    assert says in refused.value.remedy


def test_sheets_whose_rows_nothing_pairs_are_named(tmp_path: Path) -> None:
    book = openpyxl.Workbook()
    joints, measured = book.active, book.create_sheet("Measured")
    assert joints is not None
    joints.title = "Joints"
    for sheet, names, rows in ((joints, HEADING[:6], DEG), (measured, HEADING[6:], MM)):
        sheet.append(["Point", *names])
        for at, row in enumerate(rows, 1):
            sheet.append([f"{sheet.title} {at}", *row.tolist()])
    book.save(tmp_path / "rows.xlsx")
    with pytest.raises(MeasurementError, match="sheet 'Joints': no measurement") as refused:
        read_measurements(tmp_path / "rows.xlsx", MODEL)
    assert "'Measured'" in refused.value.remedy
