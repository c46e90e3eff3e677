"""Measurements that do not fit their robot are refused with the cause that does, by every way in."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from cellcal.calibration.arm.kinematics import load_model, model_names
from cellcal.calibration.errors import CalibrationError
from cellcal.calibration.identification.misfit import refuse_gross_misfit, refuse_misfit
from cellcal.calibration.identification.misfit_error import MisfitError
from cellcal.calibration.identification.misfit_fit import fit_quickly
from cellcal.calibration.identification.misfit_hypotheses import FileNames, home_reading, with_zeros
from cellcal.calibration.identification.observations import PointObservations
from cellcal.calibration.points.tag_points import TagPath, match_tags
from cellcal.calibration.points.tag_robot import calibrate_simulated_robot
from cellcal.service.cli.app import run_command_line
from cellcal.service.exit_codes import ExitCode
from tests.soak.misfits import WAYS, SpoiltRows, answer_to, is_named, measure_rows
from tests.unit.helpers.simulated_arm import tracker_points, wire_lengths

J = [f"J{i}" for i in range(1, 7)]
CELLS = Path(__file__).resolve().parents[2] / "deploy" / "layouts" / "cells"


@pytest.mark.parametrize(("number", "way"), list(enumerate(WAYS)))
def test_the_cause_is_named(number, way):
    """One robot for each cause; `make soak ARGS=misfits` takes every robot and twenty seeds."""
    robots = model_names()
    spoilt = WAYS[way](measure_rows(robots[number % len(robots)], 100))
    refused = answer_to(spoilt)
    assert is_named(spoilt, refused), refused


@pytest.mark.parametrize("robot", ["abb_irb120", "fanuc_m6ib", "kuka_kr6_r900", "ur10e"])
def test_good_measurements_pass(robot):
    true = measure_rows(robot, 101)
    assert answer_to(SpoiltRows(true.model, true.rows, "", ())) is None


def test_a_misfit_with_two_causes_names_both():
    simulated = tracker_points("abb_irb120", 50)
    observations = simulated.observations
    spoilt = replace(observations, positions_m=observations.positions_m * [1.0, 1.0, -1.0] / 25.4)
    with pytest.raises(MisfitError) as refused:
        refuse_misfit(simulated.model, spoilt, FileNames(tuple(J), length_unit="mm"))
    assert refused.value.causes[0].kinds == ("unit", "mirror")
    assert "position=inch" in refused.value.remedy


def test_a_sign_with_a_zero_is_named_before_mirror_images_beyond_the_limits():
    """An arm whose sign and zero differ fits as well as its mirror image, the first joints counted elsewhere."""
    simulated = tracker_points("abb_irb120", 50)
    quarter = np.array([0.0, np.pi / 2, 0.0, 0.0, 0.0, 0.0])
    joints = simulated.observations.joints_rad * [1, 1, 1, -1, 1, 1] - quarter
    spoilt = replace(simulated.observations, joints_rad=joints)
    with pytest.raises(MisfitError) as refused:
        refuse_misfit(simulated.model, spoilt, FileNames(tuple(J)), search_models=False)
    assert refused.value.causes[0].kinds == ("sign", "home")
    assert "joints=J1,J2+90,J3,-J4,J5,J6`" in refused.value.remedy
    assert "mirror image" in refused.value.remedy
    assert str(refused.value).count("that of J2 by +90") == 1


@pytest.mark.parametrize(
    ("change", "kind", "says"),
    [
        (lambda q: q * [1, 1, -1, 1, 1, 1], "sign", "J3 counts the other way"),
        (lambda q: q - np.array([0, 0, np.pi / 2, 0, 0, 0]), "home", "J3 by +90"),
        (lambda q: q[:, [0, 2, 1, 3, 4, 5]], "order", "J1, J3, J2"),
        (np.rad2deg, "angle unit", "in deg"),
    ],
)
def test_lengths_of_a_wire_are_no_exception(change, kind, says):
    simulated = wire_lengths("abb_irb120", 80)
    spoilt = replace(simulated.observations, joints_rad=change(simulated.observations.joints_rad))
    with pytest.raises(MisfitError) as refused:
        refuse_misfit(simulated.model, spoilt, FileNames(tuple(J)))
    assert refused.value.causes[0].kinds == (kind,)
    assert says in refused.value.message


def test_lengths_in_inches_and_good_ones():
    simulated = wire_lengths("ur5", 80)
    refuse_misfit(simulated.model, simulated.observations)
    spoilt = replace(simulated.observations, lengths_m=simulated.observations.lengths_m / 25.4)
    with pytest.raises(MisfitError) as refused:
        refuse_misfit(simulated.model, spoilt, FileNames(tuple(J), length_unit="mm"))
    assert "--units length=inch" in refused.value.remedy


def test_a_misfit_without_a_known_cause_is_refused_too():
    simulated = tracker_points("ur10", 40)
    rng = np.random.default_rng(0)
    noise = replace(simulated.observations, positions_m=rng.uniform(-1, 1, (40, 3)))
    with pytest.raises(MisfitError, match="no known cause fits"):
        refuse_misfit(simulated.model, noise)
    noise_scores_m = np.full(40, fit_quickly(simulated.model, noise).score_m)
    with pytest.raises(MisfitError, match="no known cause fits"):
        refuse_gross_misfit(simulated.model, noise, noise_scores_m)
    refuse_gross_misfit(simulated.model, noise, np.full(40, 0.004))


def test_a_zero_that_the_fit_took_back_is_not_cured():
    simulated = tracker_points("abb_irb120", 40)
    names = FileNames(tuple(J))
    turned = home_reading(simulated.observations.joints_rad, {3: np.deg2rad(15.0)}, names)
    none = with_zeros(turned, {}, names)
    assert (none.says, none.cure, none.parts) == ("", "", 0)


@pytest.mark.parametrize(
    ("taken", "change", "says"),
    [
        ("deg", {2: 57.29578}, "J3 is in deg and the other joints are in rad"),
        ("rad", {2: 57.29578}, "J3 is in deg and the other joints are in rad"),
        ("deg", {3: 1 / 57.29578}, "J4 is in rad and the other joints are in deg"),
    ],
)
def test_one_joint_in_another_unit_than_the_others(taken, change, says):
    simulated = tracker_points("abb_irb120", 40)
    true = simulated.observations
    factors = np.array([change.get(joint, 1.0) for joint in range(6)])
    read = true.joints_rad * factors
    if "other joints are in rad" in says and taken == "deg":
        read = read / 57.29578
    with pytest.raises(MisfitError) as refused:
        refuse_misfit(simulated.model, replace(true, joints_rad=read), FileNames(tuple(J), angle_unit=taken))
    assert says in refused.value.message


def test_targets_measured_in_turn_are_distinguished_from_unknown_causes():
    simulated = tracker_points("ur10", 40)
    observations = simulated.observations
    flanges = simulated.model.base_flange(observations.joints_rad)
    other = flanges[:, :3, 3] + flanges[:, :3, :3] @ [0.2, -0.1, 0.3]
    first = flanges[:, :3, 3] + flanges[:, :3, :3] @ [-0.1, 0.2, 0.1]
    both = PointObservations(
        np.repeat(observations.joints_rad, 2, axis=0),
        np.stack([first, other], axis=1).reshape(-1, 3),
        np.repeat(observations.sigma_m, 2),
        np.zeros(2 * len(observations), dtype=np.intp),
    )
    with pytest.raises(MisfitError) as refused:
        refuse_misfit(simulated.model, both)
    assert "if two targets" in str(refused.value)
    assert "Say which target each row is of" in refused.value.remedy


def test_a_device_that_was_moved_far_is_no_misfit():
    simulated = tracker_points("ur10", 80)
    places = simulated.observations.positions_m.copy()
    places[40:] += [0.5, -0.3, 0.2]
    refuse_misfit(simulated.model, replace(simulated.observations, positions_m=places))


def write_table(path, names, table):
    lines = [
        ",".join(names),
        *(",".join(v if isinstance(v, str) else f"{v:.5f}" for v in row) for row in table),
    ]
    path.write_text("\n".join(lines), encoding="utf-8")
    return path


def test_numbers_of_dice_never_end_well_at_the_command(tmp_path, capsys):
    rng = np.random.default_rng(3)
    table = np.column_stack([rng.uniform(-90, 90, (40, 6)), rng.uniform(-900, 900, (40, 3))])
    path = write_table(tmp_path / "dice.csv", [*J, "X", "Y", "Z"], table)
    sets = tmp_path / "sets"
    options = ["--save", str(sets), "--serial", "1", "--by", "me", "--json"]
    code = run_command_line(["identify", str(path), "--robot", "abb_irb120", *options])
    captured = capsys.readouterr()
    assert code == ExitCode.REFUSED
    assert "no known cause fits" in " ".join(captured.err.split())
    assert not captured.out.strip()
    assert not sets.exists()


def test_a_check_file_of_another_frame_of_mind_is_refused(tmp_path, capsys):
    observations = tracker_points("ur10", 60).observations
    good = np.column_stack([np.rad2deg(observations.joints_rad), observations.positions_m * 1e3])
    bad = good * np.array([1.0] * 7 + [-1.0, 1.0])
    fitted = write_table(tmp_path / "a.csv", [*J, "X", "Y", "Z"], good)
    check = write_table(tmp_path / "b.csv", [*J, "X", "Y", "Z"], bad)
    code = run_command_line(
        ["identify", str(fitted), "--robot", "ur10", "--level", "1", "--check", str(check)]
    )
    assert code == ExitCode.REFUSED
    assert "mirror image" in capsys.readouterr().err


LAYOUT = """
[columns]
joints = ["J1", "J2", "J3", "J4", "J5", "J6"]
[[reading]]
name = "tracker"
kind = "point"
columns = ["X", "Y", "Z"]
device = "tracker"
target = "ball"
sigma_mm = 0.05
"""


def test_a_cell_of_a_layout_is_refused_with_the_words_of_a_layout(tmp_path, capsys):
    observations = tracker_points("ur10", 60).observations
    table = np.column_stack(
        [np.rad2deg(observations.joints_rad) * [1, -1, 1, 1, 1, 1], observations.positions_m * 1e3]
    )
    path = write_table(tmp_path / "a.csv", [*J, "X", "Y", "Z"], table)
    layout = tmp_path / "cell.toml"
    layout.write_text(LAYOUT, encoding="utf-8")
    command = ["identify", str(path), "--robot", "ur10", "--layout", str(layout), "--level", "1", "--json"]
    code = run_command_line(command)
    captured = capsys.readouterr()
    assert (code, captured.out.strip()) == (ExitCode.REFUSED, "")
    message = " ".join(captured.err.split())
    assert "series 'tracker'" in message
    assert '"J1", "-J2", "J3"' in message
    layout.write_text(LAYOUT.replace('"J2"', '"-J2"'), encoding="utf-8")
    assert run_command_line(command) == ExitCode.PASS
    assert json.loads(capsys.readouterr().out)["series"][0]["held_out"]["rmse_m"] < 1e-3


def test_a_simulated_robot_is_refused_too():
    observations = tracker_points("ur10e", 40).observations
    joints = observations.joints_rad * [1, 1, 1, -1, 1, 1]
    robot = TagPath("robot", tuple(map(tuple, np.zeros((40, 3)))), joints_rad=tuple(map(tuple, joints)))
    device = TagPath("device", tuple(map(tuple, observations.positions_m)))
    with pytest.raises(CalibrationError, match="wrist_1_joint counts the other way"):
        calibrate_simulated_robot(load_model("ur10e"), match_tags(robot, device))
