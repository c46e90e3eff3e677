"""Files as instruments, controllers and spreadsheets of many makers and countries write them, by the command."""

import json
from pathlib import Path

import numpy as np
import pytest

from cellcal.calibration.orientation import values_from
from cellcal.service.cli.app import run_command_line
from cellcal.service.engineering.measured.table import read_table
from cellcal.service.engineering.measured.usable_rows import UNREAD
from cellcal.service.exit_codes import ExitCode
from tests.unit.helpers.simulated_arm import tracker_poses

FIELD = Path(__file__).resolve().parents[1] / "data" / "foreign_files"
POSES = tracker_poses("abb_irb120", 40)
DEG = np.rad2deg(POSES.observations.joints_rad)
MM = POSES.observations.positions_m * 1e3
QUATERNIONS = values_from("abb_quaternion", POSES.observations.rotations)  # w first
WRONG = np.random.default_rng(4).normal(0.0, 3.0, MM.shape)
J = [f"J{i}" for i in range(1, 7)]


def identify_file_as(path, capsys, *options, robot="abb_irb120", level="1"):
    """Return the exit code, the report as an object, and what was said on standard error."""
    code = run_command_line(["identify", str(path), "--robot", robot, "--level", level, "--json", *options])
    captured = capsys.readouterr()
    return code, json.loads(captured.out) if captured.out.strip() else {}, " ".join(captured.err.split())


def file_of(folder, lines, encoding="utf-8", name="rows.csv"):
    path = folder / name
    path.write_bytes("\r\n".join(lines).encode(encoding) + b"\r\n")
    return path


def text_rows(*blocks, separator=",", comma=False, digits=4):
    def format_cell(value):
        text = value if isinstance(value, str) else f"{value:.{digits}f}"
        return text.replace(".", ",") if comma else text

    table = [
        [format_cell for block in blocks for format_cell in np.atleast_1d(block[i])]
        for i in range(len(blocks[0]))
    ]
    return [separator.join(format_cell(value) for value in row) for row in table]


@pytest.mark.parametrize("name", ["v02_nomact.csv", "v11_inch.csv", "v17_gbk.csv"])
def test_field_files_are_read_to_their_hundredths(name, capsys):
    code, report, _ = identify_file_as(FIELD / name, capsys, level="2")
    assert code == ExitCode.PASS
    assert report["held_out"]["rmse_m"] < 5e-5


def test_an_expanded_uncertainty_is_no_position_of_the_controller(capsys):
    code, report, _ = identify_file_as(FIELD / "leica_u.csv", capsys)
    assert code == ExitCode.PASS
    assert not [guess for guess in report["guesses"] if "U(95)" in guess]
    assert any("abb_quaternion" in guess for guess in report["guesses"])


@pytest.mark.parametrize(
    ("name", "robot", "cure"),
    [
        ("v10_mirror.csv", "abb_irb120", "position=X,-Y,Z"),
        ("v23_home.csv", "abb_irb120", "joints=J1,J2+90,J3,J4,J5,J6"),
        ("m6_geo.csv", "fanuc_m6ib", "--joint-coupling geometric"),
    ],
)
def test_field_files_that_do_not_fit_are_refused_with_a_cure_that_works(name, robot, cure, capsys, tmp_path):
    save = ["--save", str(tmp_path / "sets"), "--serial", "1", "--by", "me"]
    code, report, message = identify_file_as(FIELD / name, capsys, *save, robot=robot)
    assert (code, report) == (ExitCode.REFUSED, {})
    assert cure in message
    assert "wider range" not in message
    assert not (tmp_path / "sets").exists()
    option = ["--columns", cure] if "=" in cure else cure.split()
    code, report, _ = identify_file_as(FIELD / name, capsys, *option, robot=robot, level="2")
    assert code == ExitCode.PASS
    assert report["held_out"]["rmse_m"] < 1e-4


def test_the_good_twin_of_a_coupled_robot_passes(capsys):
    code, report, _ = identify_file_as(FIELD / "m6_ctl.csv", capsys, robot="fanuc_m6ib", level="2")
    assert code == ExitCode.PASS
    assert report["held_out"]["rmse_m"] < 1e-4


def test_point_lists_of_spatialanalyzer_place_a_base(capsys):
    code = run_command_line(
        ["simulate-cell", "base", str(FIELD / "sa_a.txt"), str(FIELD / "sa_b.txt"), "--json"]
    )
    found = json.loads(capsys.readouterr().out)["result"]["found"]
    assert code == ExitCode.PASS
    assert found["tags"][0] == "P0"
    assert max(np.linalg.norm(found["residuals_m"], axis=1)) < 1e-4


def test_a_point_list_is_no_identification_and_the_hint_speaks_of_it(capsys):
    code, _, message = identify_file_as(FIELD / "sa_a.txt", capsys)
    assert code == ExitCode.USAGE
    assert "list of points" in message
    assert "q1" not in message


HEADINGS = {
    "Chinese": (["轴1", "轴2", "轴3", "轴4", "轴5", "轴6"], ["实测X", "实测Y", "实测Z"]),
    "Chinese with units": (
        [f"关节{i}\uff08度\uff09" for i in range(1, 7)],
        [f"测量值{axis}\uff08毫米\uff09" for axis in "XYZ"],
    ),
    "Chinese ordinals": ([f"第{i}轴" for i in range(1, 7)], ["X坐标", "Y坐标", "Z坐标"]),
    "Japanese": ([f"{i}軸[度]" for i in range(1, 7)], ["実測X[mm]", "実測Y[mm]", "実測Z[mm]"]),
    "German": ([f"Achse {i} [Grad]" for i in range(1, 7)], ["Ist X [mm]", "Ist Y [mm]", "Ist Z [mm]"]),
    "Spanish": ([f"eje {i} (grados)" for i in range(1, 7)], ["X medido", "Y medido", "Z medido"]),
    "KUKA": ([f"A{i} (deg)" for i in range(1, 7)], ["X", "Y", "Z"]),
    "Yaskawa": (["S", "L", "U", "R", "B", "T"], ["X [mm]", "Y [mm]", "Z [mm]"]),
    "Korean": ([f"축{i}" for i in range(1, 7)], ["측정X", "측정Y", "측정Z"]),
    "Yaskawa axes": ([f"{a}-axis" for a in "SLURBT"], ["Tx", "Ty", "Tz"]),
    "theta": ([f"theta{i}" for i in range(1, 7)], ["Pos.X", "Pos.Y", "Pos.Z"]),
    "Joint1": ([f"Joint{i}" for i in range(1, 7)], ["X_mm", "Y_mm", "Z_mm"]),
}


@pytest.mark.parametrize(
    ("language", "encoding"),
    [
        ("Chinese", "gb18030"),
        ("Chinese", "utf-16"),
        ("Chinese with units", "gbk"),
        ("Chinese ordinals", "utf-8-sig"),
        ("Japanese", "cp932"),
        ("German", "cp1252"),
        ("Spanish", "cp1252"),
        ("Korean", "cp949"),
        ("KUKA", "utf-8"),
        ("Yaskawa axes", "utf-8"),
        ("Yaskawa", "utf-8"),
        ("theta", "utf-8"),
        ("Joint1", "utf-8"),
    ],
)
def test_headings_of_many_languages_and_encodings(language, encoding, tmp_path, capsys):
    joints, position = HEADINGS[language]
    path = file_of(tmp_path, [",".join([*joints, *position]), *text_rows(DEG, MM)], encoding)
    code, report, _ = identify_file_as(path, capsys)
    assert code == ExitCode.PASS
    assert report["held_out"]["rmse_m"] < 3e-3


@pytest.mark.parametrize("comma", [False, True])
def test_thousands_marks(comma, tmp_path, capsys):
    def format_thousands(value):
        text = f"{value:,.3f}"
        return text.translate(str.maketrans(",.", ".,")) if comma else f'"{text}"'

    lines = [
        (";" if comma else ",").join(format_thousands(v) for v in (*d, *m))
        for d, m in zip(DEG, MM * 1.0, strict=True)
    ]
    head = (";" if comma else ",").join([*J, "X", "Y", "Z"])
    _, report, _ = identify_file_as(file_of(tmp_path, [head, *lines]), capsys)
    assert report["held_out"]["rmse_m"] < 3e-3


def test_fixed_widths_with_units_beside_the_names(tmp_path, capsys):
    head = "  ".join([*(f"{j} [deg]" for j in J), *(f"{a} (mm)" for a in "XYZ")])
    body = ["".join(f"{v:12.4f}" for v in (*d, *m)) for d, m in zip(DEG, MM, strict=True)]
    _, report, _ = identify_file_as(file_of(tmp_path, [head, *body]), capsys)
    assert report["held_out"]["rmse_m"] < 3e-3
    assert len(report["guesses"]) == 1


def test_numbered_quaternions_that_end_with_the_scalar(tmp_path, capsys):
    names = [*J, "X", "Y", "Z", "q1", "q2", "q3", "q4"]
    path = file_of(tmp_path, [",".join(names), *text_rows(DEG, MM, QUATERNIONS[:, [1, 2, 3, 0]], digits=6)])
    _, report, _ = identify_file_as(path, capsys)
    assert any("read as ros_quaternion" in guess for guess in report["guesses"])


def test_a_degree_sign_in_a_western_file_is_not_chinese(tmp_path):
    names = [*(f"Größe J{i} [°]" for i in range(1, 7)), "X", "Y", "Z"]
    path = file_of(tmp_path, [",".join(names), *text_rows(DEG, MM)], "cp1252")
    assert read_table(path).names[0] == "Größe J1 [°]"


@pytest.mark.parametrize(
    "triples",
    [
        ("Nominal {}", "Actual {}", "Delta {}"),
        ("{}_Nom", "{}_Act", "{}_Dev"),
        ("Nom {} [mm]", "Meas {} [mm]", "Deviation {} [mm]"),
        ("Soll {}", "Ist {}", "Abweichung {}"),
        ("理论{}", "实测{}", "偏差{}"),
        ("Theoretical {}", "{}", "Error {}"),
        ("{}Nom", "{}Act", "{}Dev"),
        ("Nom{}", "Meas{}", "d{}"),
    ],
)
def test_nominal_actual_and_deviation_are_distinguished(triples, tmp_path, capsys):
    names = [pattern.format(axis) for pattern in triples for axis in "XYZ"]
    path = file_of(tmp_path, [",".join([*J, *names]), *text_rows(DEG, MM + WRONG, MM, -WRONG)])
    code, report, _ = identify_file_as(path, capsys)
    assert code == ExitCode.PASS
    assert report["held_out"]["rmse_m"] < 3e-3


def test_groups_of_columns_over_x_y_and_z(tmp_path, capsys):
    head = [",,,,,,Nominal,,,Actual,,", ",".join([*J, *"XYZXYZ"])]
    path = file_of(tmp_path, [*head, *text_rows(DEG, MM + WRONG, MM)])
    _, report, _ = identify_file_as(path, capsys)
    assert report["held_out"]["rmse_m"] < 3e-3


@pytest.mark.parametrize(
    ("names", "order"),
    [
        (["rot_x", "rot_y", "rot_z", "rot_w"], [1, 2, 3, 0]),
        (["rot_w", "rot_x", "rot_y", "rot_z"], [0, 1, 2, 3]),
        (["qx", "qy", "qz", "qw"], [1, 2, 3, 0]),
        (["orientation.x", "orientation.y", "orientation.z", "orientation.w"], [1, 2, 3, 0]),
        (["Quat W", "Quat X", "Quat Y", "Quat Z"], [0, 1, 2, 3]),
        (["Q0", "Q1", "Q2", "Q3"], [0, 1, 2, 3]),
        (["e0", "e1", "e2", "e3"], [1, 2, 3, 0]),
        (["Q0", "Qx", "Qy", "Qz"], [0, 1, 2, 3]),
    ],
)
def test_quaternions_by_name_in_either_order(names, order, tmp_path, capsys):
    path = file_of(
        tmp_path,
        [",".join([*J, "X", "Y", "Z", *names]), *text_rows(DEG, MM, QUATERNIONS[:, order], digits=6)],
    )
    _, report, _ = identify_file_as(path, capsys)
    assert any("quaternion: " in guess for guess in report["guesses"]), report["guesses"]
    assert not any("left out" in guess or "controller" in guess for guess in report["guesses"])


@pytest.mark.parametrize(
    ("unit", "factor"),
    [
        ("inch", 25.4),
        ("in", 25.4),
        ('"', 25.4),
        ("in.", 25.4),
        ("mils", 0.0254),
        ("ft", 304.8),
        ("cm", 10.0),
        ("m", 1e3),
    ],
)
def test_a_unit_in_the_heading_wins(unit, factor, tmp_path, capsys):
    names = [*J, *(f"{axis} ({unit})" for axis in "XYZ")]
    path = file_of(tmp_path, [",".join(names), *text_rows(DEG, MM / factor, digits=7)])
    code, report, _ = identify_file_as(path, capsys)
    assert code == ExitCode.PASS
    assert report["held_out"]["rmse_m"] < 3e-3
    assert not any("position" in guess for guess in report["guesses"])


@pytest.mark.parametrize("factor", [25.4, 10.0, 1.0, 1e3, 304.8])
def test_an_unstated_unit_is_determined_by_the_fit(factor, tmp_path, capsys):
    path = file_of(tmp_path, [",".join([*J, "X", "Y", "Z"]), *text_rows(DEG, MM / factor, digits=7)])
    code, report, _ = identify_file_as(path, capsys)
    assert code == ExitCode.PASS
    assert report["held_out"]["rmse_m"] < 3e-3


def test_columns_of_two_units_are_refused(tmp_path, capsys):
    names = [*J, "X [mm]", "Y [mm]", "Z [m]"]
    code, _, message = identify_file_as(file_of(tmp_path, [",".join(names), *text_rows(DEG, MM)]), capsys)
    assert code == ExitCode.USAGE
    assert "different units" in message


def test_a_file_without_heading_is_read_by_the_numbers_of_its_columns(tmp_path, capsys):
    few = file_of(tmp_path, ["// exported", *text_rows(DEG, MM)[:10]])
    code, _, message = identify_file_as(few, capsys)
    assert code == ExitCode.USAGE
    assert "--columns joints=1,2,3,4,5,6" in message
    path = file_of(tmp_path, ["// exported", *text_rows(MM, DEG)])
    column_options = ["--columns", "joints=4,5,6,7,8,9", "--columns", "position=1,2,3"]
    for options in ([], column_options):
        code, report, _ = identify_file_as(path, capsys, *options)
        assert code == ExitCode.PASS
        assert report["held_out"]["rmse_m"] < 3e-3


def test_remarks_between_the_rows_are_no_rows(tmp_path, capsys):
    lines = [",".join([*J, "X", "Y", "Z"]), *text_rows(DEG, MM)]
    lines[20:20] = ["# station moved?", "// shot again,,,,,,,,"]
    _, report, _ = identify_file_as(file_of(tmp_path, lines), capsys)
    assert (report["rows"], report["usable"]) == (40, 40)


def test_units_below_the_heading_and_decimal_commas(tmp_path, capsys):
    lines = [";".join([*J, "X", "Y", "Z"]), ";".join(["[°]"] * 6 + ["[mm]"] * 3)]
    path = file_of(tmp_path, [*lines, *text_rows(DEG, MM, separator=";", comma=True)], "cp1252")
    _, report, _ = identify_file_as(path, capsys)
    assert report["held_out"]["rmse_m"] < 3e-3
    assert len(report["guesses"]) == 1


def test_rows_without_a_reading_are_distinguished_from_rejected_ones(tmp_path, capsys):
    positions_mm = MM.copy()
    positions_mm[3] = 0.0
    positions_mm[7] = -9999.0
    positions_mm[11] = 9999.0
    positions_mm[15] = positions_mm[14]  # the instrument stood still
    positions_mm[25] += 30.0
    lines = [",".join([*J, "X", "Y", "Z"]), *text_rows(DEG, positions_mm)]
    lines[30] = lines[30].rsplit(",", 1)[0] + ",NaN"
    path = file_of(tmp_path, lines)
    _, report, _ = identify_file_as(path, capsys)
    unread = [row["row"] for row in report["rejected"] if row["kind"] == UNREAD]
    assert unread == [3, 7, 11, 14, 15, 29]
    assert [row["row"] for row in report["rejected"] if row["kind"] != UNREAD] == [25]
    assert (report["rows"], report["usable"], report["held_out"]["n"]) == (40, 34, 34)
    run_command_line(["identify", str(path), "--robot", "abb_irb120", "--level", "1"])
    output = capsys.readouterr().out
    assert "34 usable rows of 40" in output
    assert "6 rows hold no reading" in output
    assert "1 rows rejected" in output


HOSTILE = [
    b"",
    b"\x00" * 500,
    b"\xff\xfe",
    b"\xff\xfe\x00",
    b"\xff\xfe\x00\x00",
    b"\xff\xfe\x00\xd8\x00\xd8" * 40,
    b"\x81" * 400,
    b"# 1 2 3\n# 4 5 6\n",
    b"// 1,2,3\n",
    b"1,2,3\n" * 30,
    b",,,\n,,,\n",
    b"J1,J2,J3,J4,J5,J6,X,Y,Z\n" + b"0,0,0,0,0,0,0,0,0\n" * 20,
    b"J1,J2,J3,J4,J5,J6,X,Y,Z\n" + b"1,2,3,4,5,6,9999,9999,9999\n" * 20,
    b"J1,J2,J3,J4,J5,J6,X,Y,Z\n" + b"1e300,2,3,4,5,6,7,8,9\n" * 20,
    b"J1,J2,J3,J4,J5,J6,X,Y,Z,rot_x,rot_y,rot_z,rot_w\n" + b"1,2,3,4,5,6,7,8,9,0,0,0,0\n" * 20,
    b"a,a,a\n1,2,3\n",
    "轴1".encode("gbk") * 300,
    b"Nominal,,Actual\nX,Y,X\n1,2,3\n",
]


@pytest.mark.parametrize("content", HOSTILE, ids=range(len(HOSTILE)))
def test_whatever_a_file_holds_ends_in_a_sentence(content, tmp_path, capsys):
    path = tmp_path / "rows.csv"
    path.write_bytes(content)
    for command in (
        ["identify", str(path), "--robot", "abb_irb120"],
        ["simulate-cell", "base", str(path), str(path)],
    ):
        code = run_command_line(command)
        captured = capsys.readouterr()
        assert code in (ExitCode.USAGE, ExitCode.REFUSED), (command, code)
        assert "Internal error" not in captured.err + captured.out


@pytest.mark.parametrize(
    "columns", ["name=99", "name=nothing", "position=1,1,1", "position=0,1,2", "joints=", "position=-,+,x"]
)
def test_columns_that_name_nothing_are_refused(columns, capsys):
    for command in (
        ["identify", str(FIELD / "m6_ctl.csv"), "--robot", "fanuc_m6ib"],
        ["simulate-cell", "base", str(FIELD / "sa_a.txt"), str(FIELD / "sa_b.txt")],
    ):
        code = run_command_line([*command, "--columns", columns])
        assert code != ExitCode.PASS or columns.startswith("name")
        assert "Internal error" not in "".join(capsys.readouterr())


def test_few_rows_speak_of_no_endless_number(tmp_path, capsys):
    path = file_of(tmp_path, [",".join([*J, "X", "Y", "Z"]), *text_rows(DEG, MM)])
    run_command_line(["identify", str(path), "--robot", "abb_irb120", "--level", "1"])
    shown = " ".join(capsys.readouterr().out.split())
    assert "(what few rows leave open is in the sigmas)" in shown


def test_rows_of_one_posture_are_refused(tmp_path, capsys):
    path = file_of(
        tmp_path, [",".join([*J, "X", "Y", "Z"]), *text_rows(DEG[[3] * 30], MM[[3] * 30] + WRONG[:30])]
    )
    code, _, message = identify_file_as(path, capsys)
    assert code == ExitCode.REFUSED
    assert "too few postures to identify anything and to check it: 1, in 30 usable rows" in message


@pytest.mark.parametrize("postures", [1, 4])
def test_few_postures_whose_encoders_flicker_are_refused(postures, tmp_path, capsys):
    flicker_deg = 1e-3 * np.random.default_rng(5).standard_normal((40, 6))
    rows = np.arange(40) % postures
    path = file_of(
        tmp_path,
        [",".join([*J, "X", "Y", "Z"]), *text_rows(DEG[rows] + flicker_deg, MM[rows] + flicker_deg[:, :3])],
    )
    code, _, message = identify_file_as(path, capsys)
    assert code == ExitCode.REFUSED
    assert f"to check it: {postures}, in 40 usable rows" in message


def test_a_file_with_five_of_six_joints_is_no_list_of_points(tmp_path, capsys):
    path = file_of(tmp_path, [",".join([*J[:5], "X", "Y", "Z"]), *text_rows(DEG[:, :5], MM)])
    _, _, message = identify_file_as(path, capsys)
    assert "no 6 joint columns" in message
    assert "without the joints" not in message
