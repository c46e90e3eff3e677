"""Files as instruments, controllers and spreadsheets write them: read right, with nothing told but the robot."""

import datetime

import numpy as np
import openpyxl
import pytest

from cellcal.calibration.arm.kinematics import load_model
from cellcal.calibration.orientation import values_from
from cellcal.service.engineering.measured.measurements import ReadOptions, read_measurements
from cellcal.service.engineering.measured.table import MeasurementError
from tests.unit.helpers.simulated_arm import tracker_poses, wire_lengths

UR10 = load_model("ur10")
POSES = tracker_poses("ur10", 36).observations
Q, P = POSES.joints_rad, POSES.positions_m
DEG, MM = np.rad2deg(Q), P * 1e3
STAMPS = [f"2024-03-05T10:{i:02d}:07.250" for i in range(36)]


def text_lines(*columns, separator=",", form="{:.6f}", comma=False):
    """Return text rows of arrays (N, k) and lists of words side by side."""

    def format_cells(column, row):
        if isinstance(column, np.ndarray):
            written = [form.format(value) for value in np.atleast_1d(column[row])]
            return [w.replace(",", " ").replace(".", ",") if comma else w for w in written]
        return [column[row]]

    return [separator.join(c for column in columns for c in format_cells(column, i)) for i in range(36)]


def spatial_analyzer():
    head = [
        "SpatialAnalyzer 2023.2.0714.8",
        "Job File: cell 7.xit64",
        "Collection: A, Frame: Instrument 0, Units: Millimeters",
        "",
        "Collection, Group, Point Name, X [mm], Y [mm], Z [mm], Ux, Uy, Uz, A1, A2, A3, A4, A5, A6",
    ]
    words = [f"A, robot, p{i}" for i in range(36)]
    return head + text_lines(words, MM, np.full((36, 3), 0.021), DEG, separator=", ")


def leica_file():
    head = ["Nr\tDatum\tX (mm)\tY (mm)\tZ (mm)\t" + "\t".join(f"Joint {i} (deg)" for i in range(1, 7))]
    return head + text_lines([str(i + 1) for i in range(36)], STAMPS, MM, DEG, separator="\t")


def robodk_file():
    head = ["ID,J1 (deg),J2 (deg),J3 (deg),J4 (deg),J5 (deg),J6 (deg),X (mm),Y (mm),Z (mm)"]
    return head + text_lines([str(i) for i in range(36)], DEG, MM)


def german_file():
    head = ["Messprotokoll", "Datum;05.03.2024", ""]
    head += ["Nr;Achse 1;Achse 2;Achse 3;Achse 4;Achse 5;Achse 6;X;Y;Z"]
    head += [";°;°;°;°;°;°;mm;mm;mm"]
    return head + text_lines([str(i) for i in range(36)], DEG, MM, separator=";", comma=True)


def thousands_english():
    body = [",".join([*(f"{v:.6f}" for v in DEG[i]), *(f'"{v:,.4f}"' for v in MM[i])]) for i in range(36)]
    return ["q1,q2,q3,q4,q5,q6,x,y,z", *body]


def thousands_german():
    def format_thousands(value):
        return f"{value:,.4f}".translate(str.maketrans(",.", ".,"))

    body = [";".join(format_thousands(v) for v in (*DEG[i], *MM[i])) for i in range(36)]
    return ["q1;q2;q3;q4;q5;q6;x;y;z", *body]


def thousands_blank():
    body = [";".join(f"{v:,.4f}".replace(",", "\u202f") for v in (*DEG[i], *MM[i])) for i in range(36)]
    return ["q1;q2;q3;q4;q5;q6;x;y;z", *body]


def commented_file():
    head = ["# robot: 7", "# operator: A. B.", "# q1 q2 q3 q4 q5 q6 x y z"]
    body = text_lines(Q, P, separator=" ", form="{:.8f}")
    return [*head, *body[:10], "# pause, 10 minutes", *body[10:], "# end"]


def block_file():
    body = text_lines(Q, P, form="{:.8f}")
    return ["q1,q2,q3,q4,q5,q6,x,y,z", *body[:12], "", "", *body[12:24], ",,,,,,,,", *body[24:]]


def repeated_header():
    body = text_lines(Q, P, form="{:.8f}")
    return ["q1,q2,q3,q4,q5,q6,x,y,z", *body[:12], "q1,q2,q3,q4,q5,q6,x,y,z", *body[12:]]


def trailing_file():
    body = text_lines(DEG, MM)
    return [
        "q1,q2,q3,q4,q5,q6,x,y,z",
        *body,
        "deg,deg,deg,deg,deg,deg,mm,mm,mm",
        "Mean,,,,,,1.0,2.0,3.0",
        "36 points measured",
    ]


def with_index():
    head = [",timestamp,axis_1,axis_2,axis_3,axis_4,axis_5,axis_6,pos_x_mm,pos_y_mm,pos_z_mm,residual"]
    stamps = [f"{1.7e9 + 3 * i:.3f}" for i in range(36)]
    return head + text_lines([str(i) for i in range(36)], stamps, DEG, MM, np.full((36, 1), 0.013))


def both_frames():
    """The controller's own position beside the tracker's."""
    flange = UR10.base_flange(Q)[:, :3, 3]
    names = ",".join([*(f"J{i}[deg]" for i in range(1, 7)), "X_robot", "Y_robot", "Z_robot", "X_tracker"])
    return [f"{names},Y_tracker,Z_tracker", *text_lines(DEG, flange * 1e3, MM)]


def inches_file():
    head = [",".join([*(f"J{i} (deg)" for i in range(1, 7)), "X (in)", "Y (in)", "Z (in)"])]
    return head + text_lines(DEG, P / 0.0254)


def spaces_in_columns():
    head = ["   J1        J2        J3        J4        J5        J6          X          Y          Z"]
    return head + ["  " + line for line in text_lines(DEG, MM, separator="   ")]


def joints_after_position():
    head = ["point;X/mm;Y/mm;Z/mm;q1/deg;q2/deg;q3/deg;q4/deg;q5/deg;q6/deg"]
    return head + text_lines([f"P{i:03d}" for i in range(36)], MM, DEG, separator=";")


FILES = [
    spatial_analyzer, leica_file, robodk_file, german_file, thousands_english, thousands_german,
    thousands_blank, commented_file,
    block_file, repeated_header, trailing_file, with_index, both_frames, inches_file, spaces_in_columns,
    joints_after_position,
]  # fmt: skip


@pytest.mark.parametrize("encoding", ["utf-8", "utf-8-sig", "utf-16", "utf-16-le"])
@pytest.mark.parametrize("make", FILES)
def test_is_read_right(tmp_path, make, encoding):
    path = tmp_path / f"{make.__name__}.csv"
    path.write_bytes("\r\n".join([*make(), ""]).encode(encoding))
    found = read_measurements(path, UR10)
    assert len(found.rows) == 36
    assert np.allclose(found.observations.joints_rad, Q, atol=2e-6)
    assert np.allclose(found.observations.positions_m, P, atol=2e-6)
    assert len(found.rejected) <= 3


def test_numbers_in_names_between_tabs_do_not_make_blanks_separators(tmp_path):
    path = tmp_path / "polyworks.txt"
    heads = [f"{axis} {word}" for word in ("Nominal", "Measured") for axis in "XYZ"]
    rows = ["\t".join(["point 7", "", "", "", *map(str, row)]) for row in np.column_stack([MM, DEG])]
    path.write_text(
        "\n".join(["\t".join(["Name", *heads, *(f"J{at}" for at in range(1, 7))]), *rows]), encoding="utf-8"
    )
    found = read_measurements(path, UR10)
    assert found.layout.position == ("X Measured", "Y Measured", "Z Measured")
    assert np.allclose(found.observations.positions_m, P, atol=2e-6)


def test_quaternions_in_either_order_of_names(tmp_path):
    quaternions = values_from("abb_quaternion", POSES.rotations)  # w x y z
    orders = {"qx,qy,qz,qw": [1, 2, 3, 0], "qw,qx,qy,qz": [0, 1, 2, 3], "RX,RY,RZ,RW": [1, 2, 3, 0]}
    for names, order in orders.items():
        path = tmp_path / "q.csv"
        head = [f"j1,j2,j3,j4,j5,j6,x,y,z,{names}"]
        path.write_text("\n".join(head + text_lines(DEG, MM, quaternions[:, order])), encoding="utf-8")
        found = read_measurements(path, UR10).observations
        assert found.kind == "pose"
        assert np.allclose(found.rotations, POSES.rotations, atol=1e-5)


def test_q1_to_q4_beside_joints_are_a_quaternion(tmp_path):
    quaternions = values_from("abb_quaternion", POSES.rotations)
    path = tmp_path / "abb.csv"
    head = ["rax_1,rax_2,rax_3,rax_4,rax_5,rax_6,x,y,z,q1,q2,q3,q4"]
    path.write_text("\n".join(head + text_lines(DEG, MM, quaternions)), encoding="utf-8")
    found = read_measurements(path, UR10).observations
    assert found.kind == "pose"
    assert np.allclose(found.joints_rad, Q, atol=1e-6)
    assert np.allclose(found.rotations, POSES.rotations, atol=1e-5)


def test_a_workbook_with_a_cover_a_title_and_dates(tmp_path):
    book = openpyxl.Workbook()
    book.active.title = "Cover"
    book.active.append(["Acceptance of cell 7", None, 3])
    sheet = book.create_sheet("Points")
    sheet.append(["Calibration of robot 7"])
    sheet.append([])
    sheet.append(["No.", "When", *(f"A{i} [°]" for i in range(1, 7)), "X [mm]", "Y [mm]", "Z [mm]", "Remark"])
    for i in range(36):
        when = datetime.datetime(2024, 3, 5, 10, i, tzinfo=datetime.UTC).replace(tzinfo=None)
        sheet.append([i + 1, when, *map(float, DEG[i]), *map(float, MM[i]), None])
    path = tmp_path / "points.xlsx"
    book.save(path)
    found = read_measurements(path, UR10)
    assert np.allclose(found.observations.joints_rad, Q, atol=1e-9)
    assert np.allclose(found.observations.positions_m, P, atol=1e-9)


def test_a_draw_wire_beside_the_controllers_position(tmp_path):
    observations = wire_lengths("ur10", 36).observations
    flange = UR10.base_flange(observations.joints_rad)[:, :3, 3]
    head = ["time [s],q1,q2,q3,q4,q5,q6,X,Y,Z,wire length [mm]"]
    times = np.arange(36.0)[:, None]
    body = text_lines(
        times, np.rad2deg(observations.joints_rad), flange * 1e3, observations.lengths_m[:, None] * 1e3
    )
    path = tmp_path / "wire.csv"
    path.write_text("\n".join(head + body), encoding="utf-8")
    found = read_measurements(path, UR10)
    assert np.allclose(found.observations.lengths_m, observations.lengths_m, atol=1e-8)
    assert found.controller_m is not None
    assert np.allclose(found.controller_m, flange, atol=1e-8)


@pytest.mark.parametrize(
    ("head", "columns", "message"),
    [
        ("a,b,c,d,e,f,x,y,z", (DEG, MM), "--columns joints="),
        ("q1,q2,q3,q4,q5,q6,u,v,w1", (DEG, MM), "--columns position="),
        ("q1,q2,q3,q4,q5,x,y,z,more", (DEG, MM), "--columns joints="),
    ],
)
def test_what_is_not_found_is_named_with_the_option_that_cures_it(tmp_path, head, columns, message):
    path = tmp_path / "odd.csv"
    path.write_text("\n".join([head, *text_lines(*columns)]), encoding="utf-8")
    with pytest.raises(MeasurementError) as refused:
        read_measurements(path, UR10, ReadOptions())
    assert message in refused.value.remedy
    assert head.split(",")[0] in refused.value.message


def test_a_file_that_is_mostly_unreadable_is_refused_rather_than_fitted_to_the_rest(tmp_path):
    body = text_lines(DEG, MM)
    body[4:] = [line.replace("-", "~") for line in body[4:]]
    path = tmp_path / "odd.csv"
    path.write_text("\n".join(["q1,q2,q3,q4,q5,q6,x,y,z", *body]), encoding="utf-8")
    with pytest.raises(MeasurementError, match=r"rows of .* cannot be read; line"):
        read_measurements(path, UR10)
