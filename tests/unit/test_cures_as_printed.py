"""Options that a refusal of `cellcal identify` prints can be copied into a terminal as they stand, and cure."""

import re
import shlex
from dataclasses import replace

import numpy as np
import pytest

from cellcal.calibration.identification.column_options import TypedColumn, columns_option
from cellcal.calibration.identification.misfit import refuse_misfit
from cellcal.calibration.identification.misfit_error import MisfitError
from cellcal.calibration.identification.misfit_hypotheses import FileNames
from cellcal.service.cli.app import run_command_line
from cellcal.service.engineering.measured.typed_columns import parse_columns, written_as
from cellcal.service.exit_codes import ExitCode
from tests.unit.helpers.simulated_arm import tracker_points, tracker_poses

POSES = tracker_poses("abb_irb120", 40)
DEG = np.rad2deg(POSES.observations.joints_rad)
MM = POSES.observations.positions_m * 1e3
PLAIN = [*(f"J{i}" for i in range(1, 7)), "X", "Y", "Z"]
HEADINGS = {
    "plain": PLAIN,
    "units": [*(f"J{i} (deg)" for i in range(1, 7)), "X [mm]", "Y [mm]", "Z [mm]"],
    "spaces": [*(f"Axis {i}" for i in range(1, 7)), "Point X", "Point Y", "Point Z"],
    "commas": [*(f"J{i}, deg" for i in range(1, 7)), "X, mm", "Y, mm", "Z, mm"],
    "dollars": [*(f"$A{i}" for i in range(1, 7)), "$X", "$Y", "$Z"],
    "numbers": [str(i) for i in range(9)],
    "doubled": ["J1 (deg)", "J1 (rad)", *(f"q{i}-1+2" for i in range(3, 7)), "X [mm]", "X [m]", "-X"],
    "foreign": [*(f"关节{i}(°)" for i in range(1, 7)), "测量X(mm)", "测量Y(mm)", "测量Z(mm)"],
}  # fmt: skip


@pytest.mark.parametrize("names", HEADINGS.values(), ids=HEADINGS)
def test_columns_are_read_back_as_a_terminal_hands_them_on(names):
    chosen = [TypedColumn(name, written=written_as(names, name)) for name in names]
    changed = [*chosen[:3], *(column.turned().with_zero(90.0) for column in chosen[3:6]), *chosen[6:]]
    option, word = shlex.split(columns_option("joints", changed).strip("`"))
    assert option == "--columns"
    found = parse_columns(names, word.removeprefix("joints=").split(","))
    assert [(c.name, c.sign, c.zero_deg) for c in found] == [(c.name, c.sign, c.zero_deg) for c in changed]


def test_a_column_turned_twice_is_the_column():
    column = TypedColumn("J2", -1.0, 90.0)
    assert column.turned() == TypedColumn("J2", 1.0, -90.0)  # -(90 - J2)
    assert column.turned().turned() == column


def follow_cures(path, capsys, *options):
    """Return the exit code and the options after everything that is printed was typed, at most four times."""
    for _ in range(4):
        code = run_command_line(["identify", str(path), "--robot", "abb_irb120", "--level", "1", *options])
        if code == ExitCode.PASS:
            break
        said = " ".join(capsys.readouterr().err.split()).partition("It fits as well")[0]
        cures = [shlex.split(text) for text in re.findall(r"`(--[^`]*)`", said)]
        assert cures, said
        new = {(option, word.partition("=")[0]): word for option, word in cures}
        old = {(o, w.partition("=")[0]): w for o, w in zip(options[::2], options[1::2], strict=True)}
        options = tuple(text for (option, _), word in {**old, **new}.items() for text in (option, word))
    return code, options


@pytest.mark.parametrize("kind", ["plain", "units", "spaces", "commas", "dollars", "foreign"])
@pytest.mark.parametrize(
    "spoil",
    [
        lambda q, p: (q * [1, 1, 1, -1, -1, 1], p),
        lambda q, p: (q - np.array([0, 0, 90, 0, 0, 0]), p * [1, -1, 1]),
        lambda q, p: (q[:, [0, 1, 2, 4, 3, 5]], p[:, [1, 0, 2]]),
    ],
    ids=["signs", "zero and mirror", "orders"],
)
def test_what_is_printed_cures(kind, spoil, tmp_path, capsys):
    joints, places = spoil(DEG, MM)
    path = tmp_path / "rows.csv"
    rows = [";".join(f"{value:.5f}" for value in row) for row in np.column_stack([joints, places])]
    path.write_text("\n".join([";".join(HEADINGS[kind]), *rows]), encoding="utf-8")
    code, options = follow_cures(path, capsys)
    assert code == ExitCode.PASS, options
    assert options


def test_a_cure_on_top_of_columns_that_were_named_keeps_them(tmp_path, capsys):
    path = tmp_path / "rows.csv"
    joints = DEG + np.array([0, 90, 0, 0, 0, 0])
    rows = [",".join(f"{value:.5f}" for value in row) for row in np.column_stack([joints, MM])]
    path.write_text("\n".join([",".join(PLAIN), *rows]))
    code, options = follow_cures(path, capsys, "--columns", "joints=J1,-J2+30,J3,J4,J5,J6")
    assert code == ExitCode.PASS, options
    assert options[1].split(",")[1] == "J2-90"


@pytest.mark.parametrize("share", [0.0, 0.2])
@pytest.mark.parametrize("robot", ["kuka_kr16_2", "staubli_tx2_90l"])
def test_a_half_turn_of_a_wrist_is_told_with_the_sign_that_moves_alike(robot, share):
    """The tool takes the half turn of the last joint: rows do not tell the two, a person does."""
    simulated = tracker_points(robot, 60)
    rng = np.random.default_rng(3)
    places = simulated.observations.positions_m.copy()
    strays = rng.choice(60, int(share * 60), replace=False)
    places[strays] += rng.normal(0.0, 0.2, (len(strays), 3))
    for turned, added in ((np.array([1, 1, 1, 1, -1, 1]), 0.0), (np.ones(6), np.pi)):
        joints = simulated.observations.joints_rad * turned + added * np.eye(6)[3]
        spoilt = replace(simulated.observations, joints_rad=joints, positions_m=places)
        with pytest.raises(MisfitError) as refused:
            refuse_misfit(simulated.model, spoilt, FileNames(tuple(PLAIN[:6])), search_models=False)
        assert "joints=J1,J2,J3,J4,-J5,J6" in refused.value.remedy
        assert re.search(r"joints=J1,J2,J3,J4[+-]180,J5,J6", refused.value.remedy)


def refusal_of(tmp_path, capsys, rows, names, *options, robot="abb_irb120"):
    path = tmp_path / "rows.csv"
    lines = [",".join(f"{value:.5f}" for value in row) for row in rows]
    path.write_text("\n".join([",".join(names), *lines]))
    code = run_command_line(["identify", str(path), "--robot", robot, "--level", "1", *options])
    return code, " ".join(capsys.readouterr().err.split())


@pytest.mark.parametrize("robot", ["abb_irb120", "kuka_kr16_2"])
def test_parts_of_degrees_that_are_called_pulses_are_read_as_the_cure_says(robot, tmp_path, capsys):
    simulated = tracker_points(robot, 40)
    names = [*(f"J{i} [pulses]" for i in range(1, 7)), "X", "Y", "Z"]
    millidegrees = np.rad2deg(simulated.observations.joints_rad) * 1000
    rows = np.column_stack([millidegrees, simulated.observations.positions_m * 1e3])
    code, said = refusal_of(tmp_path, capsys, rows, names, robot=robot)
    assert code == ExitCode.USAGE
    options = dict(text.split(" ") for text in reversed(re.findall(r"`(--[^`]*)`", said)))
    typed = [word for option in options.items() for word in option]
    code, said = refusal_of(tmp_path, capsys, rows, names, *typed, robot=robot)
    assert code == ExitCode.PASS, said


def test_a_coupling_that_is_in_force_is_no_cure(tmp_path, capsys):
    """Without an option joints are those of the controller: to say so changes nothing."""
    simulated = tracker_points("abb_irb2400", 40)
    joints = np.rad2deg(simulated.observations.joints_rad)
    joints[:, 2] += joints[:, 1]
    rows = np.column_stack([joints, simulated.observations.positions_m * 1e3])
    code, said = refusal_of(tmp_path, capsys, rows, PLAIN, robot="abb_irb2400")
    assert code == ExitCode.REFUSED
    assert "Subtract J2 from J3" in said
    assert "--joint-coupling" not in said


@pytest.mark.parametrize(
    ("option", "says"),
    [
        ("--units pos=mm", "--units knows no 'pos'"),
        ("--convention fanuc", "no orientation is called 'fanuc'"),
        ("--columns position=7,8", "position has 2 columns, and needs 3"),
        ("--columns joints=1,2,3,4,5,6,7", "joints has 7 columns, and needs 6"),
        ("--columns joints=1,1,2,3,4,5", "joints names column 'J1' twice"),
    ],
)
def test_an_option_that_names_nothing_is_refused(option, says, tmp_path, capsys):
    code, said = refusal_of(tmp_path, capsys, np.column_stack([DEG, MM]), PLAIN, *option.split())
    assert code == ExitCode.USAGE
    assert says in said


def test_columns_are_suggested_where_there_is_no_choice(tmp_path, capsys):
    rows = np.column_stack([DEG, MM])[:9]
    _, said = refusal_of(tmp_path, capsys, rows, [*PLAIN[:6], "a", "b", "c"])
    assert "`--columns position=a,b,c`" in said
    _, said = refusal_of(
        tmp_path, capsys, np.column_stack([rows, rows[:, 0]]), [*PLAIN[:6], "u", "v", "w", "s"]
    )
    assert "position=…" in said
