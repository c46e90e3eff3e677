"""Wrists that rods keep level: the model file of the README finds such an arm, and robots of other kinds are named."""

import re
from pathlib import Path

import numpy as np
import pytest

from cellcal.calibration.arm.kinematics import load_model
from cellcal.calibration.arm.robot_models.catalogue_index import catalogue_entries
from cellcal.calibration.arm.robot_models.other_kinds import other_kind
from cellcal.calibration.errors import CalibrationError
from cellcal.service.cli.app import run_command_line
from cellcal.service.engineering.identification.identify import identify_file
from cellcal.service.engineering.identification.row_fit import IdentifyOptions

README = Path(__file__).parents[2] / "calibration/arm/robot_models/README.md"
NOISE_MM, LEVER_MM = 0.05, 300.0
TARGET_MM = np.array([120.0, 60.0, -300.0])


def turned(angles, axis):
    """Return rotations (N, 3, 3) about an axis of the base."""
    c, s = np.cos(angles), np.sin(angles)
    at, to = [(1, 2), (2, 0), (0, 1)][axis]
    found = np.tile(np.eye(3), (len(angles), 1, 1))
    found[:, at, at], found[:, at, to], found[:, to, at], found[:, to, to] = c, -s, s, c
    return found


def measured_mm(joints_deg, longer_rod_mm, dice):
    """Return where the target is (N, 3) [mm]: forearm counted against the base, wrist tilted by its rod alone."""
    turn, lean, dip, flange = np.radians(joints_deg + dice.normal(0.0, 0.1, 4)).T
    height, out, upper, fore, wrist, plate = np.array([800, 350, 1100, 1250, 250, -250]) + dice.normal(
        0.0, 0.5, 6
    )
    tilt = longer_rod_mm / LEVER_MM * (1.0 / np.cos(0.8 * lean) - 0.7 / np.cos(0.8 * dip))
    hanging = turned(flange, 2) @ (TARGET_MM + np.array([0.0, 0.0, plate])) + np.array([wrist, 0.0, 0.0])
    arm = np.stack(
        [
            out + upper * np.sin(lean) + fore * np.cos(dip),
            np.zeros(len(lean)),
            height + upper * np.cos(lean) - fore * np.sin(dip),
        ],
        axis=1,
    )
    base = arm + np.einsum("nij,nj->ni", turned(tilt, 1), hanging)
    placed = np.einsum("nij,nj->ni", turned(turn + 0.3, 2), base) + np.array([900.0, -400.0, 250.0])
    return placed + dice.normal(0.0, NOISE_MM, base.shape)


@pytest.fixture(scope="module")
def model_file(tmp_path_factory):
    (text,) = re.findall(
        r"```toml\n(title = \"Palletizer.*?)```", README.read_text(encoding="utf-8"), re.DOTALL
    )
    path = tmp_path_factory.mktemp("palletizer") / "palletizer.toml"
    path.write_text(text)
    return path


def held_out_mm(model_file, longer_rod_mm):
    dice = np.random.default_rng(1)
    joints = dice.uniform([-120, -40, -20, -180], [120, 70, 60, 180], (80, 4))
    table = np.column_stack([np.insert(joints, 3, 0.0, axis=1), measured_mm(joints, longer_rod_mm, dice)])
    path = model_file.with_name(f"{longer_rod_mm:g}.csv")
    heads = "J1,J2,J3,level,J4,x_mm,y_mm,z_mm"
    np.savetxt(path, table, delimiter=",", header=heads, comments="", fmt="%.5f")
    return identify_file(path, str(model_file), IdentifyOptions()).held_out.rmse_m * 1e3


def test_a_palletizer_is_identified_to_the_noise_by_the_model_of_the_readme(model_file):
    assert held_out_mm(model_file, 0.0) < 1.1 * NOISE_MM * np.sqrt(3.0)


@pytest.mark.soak
def test_what_a_wrong_rod_leaves_is_in_the_errors_held_out(model_file):
    assert 1.3 * NOISE_MM * np.sqrt(3.0) < held_out_mm(model_file, 1.0) < 0.4


@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("abb_irb360", "parallel robot"),
        ("fanuc_m1ia", "parallel robot"),
        ("fanuc_m3ia", "parallel robot"),
        ("fanuc_m410ic", "level"),
        ("abb_irb660", "level"),
        ("kuka_kr180_2_pa", "level"),
        ("yaskawa_mpl160", "level"),
    ],
)
def test_a_robot_of_another_kind_is_not_taken_for_a_mistyped_arm(name, words):
    with pytest.raises(CalibrationError, match=words) as refused:
        load_model(name)
    assert "Did you mean" not in str(refused.value.remedy)


@pytest.mark.parametrize(
    ("words", "expected"), [("delta", "parallel robot"), ("m410", "level"), ("kr 180 pa", "level")]
)
def test_searching_for_a_robot_of_another_kind_says_so(words, expected, capsys):
    assert run_command_line(["models", *words.split()]) != 0
    assert expected in capsys.readouterr().err


def test_a_longer_number_beside_a_robot_of_another_kind_is_still_listed(capsys):
    assert run_command_line(["models", "irb", "460"]) == 0
    shown = capsys.readouterr().out
    assert "level" in shown
    assert "abb_irb4600_20_250" in shown


def test_no_robot_of_the_catalogue_is_taken_for_another_kind():
    usable = [entry for entry in catalogue_entries() if entry.usable]
    assert not [entry.name for entry in usable if other_kind(entry.name) or other_kind(entry.title)]
