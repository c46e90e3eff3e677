"""Causes of a misfit beyond signs and zeros: parallel axes counted together, screws, tracks, tools, other robots."""

from dataclasses import replace

import numpy as np
import pytest

from cellcal.calibration.arm.kinematics import load_model
from cellcal.calibration.arm.urdf import bare_urdf
from cellcal.calibration.geometry import exp_twist, inverse_transform
from cellcal.calibration.identification.misfit import refuse_misfit
from cellcal.calibration.identification.misfit_couplings import parallel_runs
from cellcal.calibration.identification.misfit_error import MisfitError
from cellcal.calibration.identification.misfit_hypotheses import FileNames
from cellcal.calibration.identification.observations import LengthObservations, PointObservations

ROWS = 48
DEVICE = exp_twist(np.array([1.9, -0.8, 0.4, 0.1, -0.2, 1.3]))
TIP = np.array([0.06, 0.03, 0.11, 1.0])
SCARA, SEVEN, SIX = "mitsubishi_rh6frh5520", "yaskawa_sia20d", "yaskawa_gp7"


def joints_of(robot, seed=0):
    """Return joints of a robot of the catalogue, within its limits and two radians."""
    model, rng = load_model(robot), np.random.default_rng(seed)
    low, high = np.maximum(model.lower_rad, -2.0), np.minimum(model.upper_rad, 2.0)
    return model, rng.uniform(low, high, (ROWS, model.axis_count)), rng


def points(model, joints, rng, places=None):
    """Return rows with some noise."""
    if places is None:
        places = (DEVICE @ model.base_flange(joints) @ TIP)[:, :3]
    noise = 1e-4 * rng.standard_normal((ROWS, 3))
    return PointObservations(joints, places + noise, np.full(ROWS, 3e-4), np.zeros(ROWS, dtype=np.intp))


def refusal(model, rows, **names):
    with pytest.raises(MisfitError) as refused:
        refuse_misfit(model, rows, FileNames(tuple(f"J{i + 1}" for i in range(model.axis_count)), **names))
    return refused.value


@pytest.mark.parametrize(
    ("shown", "says", "cure"),
    [
        (
            lambda q: q + q[:, [0]] * [0, 1, 0, 0],
            "J2 holds the angle of the joint plus",
            "Subtract J1 from J2",
        ),
        (lambda q: q + q[:, [0]] * [0, 0, 0, 1] + q[:, [1]] * [0, 0, 0, 1], "J4 counts", "J4 = J4 - J1 - J2"),
        (
            lambda q: q + q[:, [0]] * [0, 1, 0, 1] + q[:, [1]] * [0, 0, 0, 1],
            "J2 and J4 count against",
            "J2 = J2 - J1; J4 = J4 - J2",
        ),
    ],
)
def test_absolute_angles_of_parallel_axes_are_named(shown, says, cure):
    model, joints, rng = joints_of(SCARA)
    assert parallel_runs(model) == [(0, 1, 3)]
    rows = replace(points(model, joints, rng), joints_rad=shown(joints))
    refused = refusal(model, rows)
    assert says in refused.message
    assert cure in refused.remedy


@pytest.mark.parametrize("pitch_m", [0.02, -0.005])
def test_a_screw_that_moves_the_quill_is_named_with_its_pitch(pitch_m):
    model, joints, rng = joints_of(SCARA)
    true = joints.copy()
    true[:, 2] += pitch_m * joints[:, 3] / (2 * np.pi)
    refused = refusal(model, replace(points(model, true, rng), joints_rad=joints))
    assert refused.causes[0].kinds == ("screw",)
    told_mm = float(refused.message.partition("about ")[2].split()[0])
    assert told_mm == pytest.approx(pitch_m * 1e3, abs=0.4)


def test_a_sound_scara_passes():
    model, joints, rng = joints_of(SCARA)
    refuse_misfit(model, points(model, joints, rng))


def test_a_redundant_joint_that_stands_last_in_the_file_is_put_in_its_place():
    model, joints, rng = joints_of(SEVEN)
    rows = replace(points(model, joints, rng), joints_rad=joints[:, [0, 1, 3, 4, 5, 6, 2]])
    assert "joints=J1,J2,J7,J3,J4,J5,J6" in refusal(model, rows).remedy


def test_a_robot_of_the_catalogue_that_fits_is_named():
    model, joints, rng = joints_of(SIX)
    assert f"--robot {SIX}" in refusal(load_model("yaskawa_gp12"), points(model, joints, rng)).remedy


def test_a_device_on_the_flange_is_told_from_unknown_causes():
    model, joints, rng = joints_of(SIX)
    tip = exp_twist(np.array([0.1, 0.0, 0.05, 0.3, 0.2, -0.4]))
    places = (inverse_transform(model.base_flange(joints) @ tip) @ [0.6, 0.2, 0.1, 1.0])[:, :3]
    assert "rides on the flange" in refusal(model, points(model, joints, rng, places)).message


def test_columns_that_take_no_part_and_explain_the_rows_are_named():
    model, joints, rng = joints_of(SIX)
    flanges = DEVICE @ model.base_flange(joints)
    track = rng.uniform(0.0, 1500.0, ROWS)
    tools = rng.integers(1, 3, ROWS).astype(float)
    unused = {"E1": track, "No.": np.arange(ROWS, dtype=float), "UTOOL": tools}
    carried = (flanges @ TIP)[:, :3] + track[:, None] * 1e-3 * np.array([0.6, 0.0, 0.8])
    refused = refusal(model, points(model, joints, rng, carried), columns=unused)
    assert "column 'E1' tells moved" in refused.message
    assert "by 1 mm for 1 of it" in refused.message
    two = np.where(tools[:, None] == 1.0, (flanges @ TIP)[:, :3], (flanges @ [-0.1, 0.1, 0.3, 1.0])[:, :3])
    refused = refusal(model, points(model, joints, rng, two), columns=unused)
    assert "taken apart by column 'UTOOL'" in refused.message


def test_joints_of_another_time_than_the_positions_are_named():
    model, _, rng = joints_of(SIX)
    low, high = np.maximum(model.lower_rad, -1.5), np.minimum(model.upper_rad, 1.5)
    phase, times = rng.uniform(0, 6, (2, 6)), np.arange(ROWS)[:, None]

    def path(time):
        swing = np.sin(0.2 * time + phase[0]) + np.sin(0.31 * time + phase[1])
        return (low + high) / 2 + swing * (high - low) / 5

    rows = replace(points(model, path(times), rng), joints_rad=path(times - 0.3))
    refused = refusal(model, rows)
    assert refused.causes[0].kinds == ("lag",)
    assert "0.30 of the time between two rows earlier" in refused.message
    refuse_misfit(model, points(model, path(times), rng))


def test_the_zero_of_a_wire_that_is_far_off_is_named():
    model, joints, rng = joints_of(SIX, seed=3)
    tips = (model.base_flange(joints) @ TIP)[:, :3]
    lengths = np.linalg.norm(tips - [1.2, -0.3, 0.2], axis=1) + 1e-4 * rng.standard_normal(ROWS)
    once, sigma = np.zeros(ROWS, dtype=np.intp), np.full(ROWS, 3e-4)
    refused = refusal(model, LengthObservations(joints, lengths - 0.35, sigma, once), length_unit="mm")
    assert refused.causes[0].kinds == ("zero",)
    assert float(refused.message.partition("about ")[2].split()[0]) == pytest.approx(350, abs=10)
    refuse_misfit(model, LengthObservations(joints, lengths, sigma, once))


def arm_on_track(folder):
    """Return an arm on a track along x, by its description."""
    description = folder / "cell.urdf"
    arm = bare_urdf(load_model("kuka_kr6_r900"))
    track = (
        '<link name="world"/><joint name="track" type="prismatic"><parent link="world"/><child link="base"/>'
        '<axis xyz="1 0 0"/><limit lower="-2" upper="2" velocity="1" effort="1"/></joint>'
    )
    description.write_text(arm.replace("</robot>", f"{track}</robot>"), encoding="utf-8")
    return load_model(f"{description}?base=world&tip=flange")


@pytest.mark.parametrize(
    ("turned", "says"), [(np.pi, "joints=-E1,A1"), (np.pi / 2, "runs in another direction")]
)
def test_a_track_that_runs_elsewhere_is_told_beside_the_zero_of_the_first_axis(tmp_path, turned, says):
    """Both place the target alike: the arm on its track is one thing, turned about the first axis."""
    model = arm_on_track(tmp_path)
    rng = np.random.default_rng(5)
    joints = rng.uniform(-1.2, 1.2, (ROWS, 7))
    shown = joints.copy()
    shown[:, 1] += turned
    names = ("E1", *(f"A{i}" for i in range(1, 7)))
    with pytest.raises(MisfitError) as refused:
        refuse_misfit(model, replace(points(model, joints, rng), joints_rad=shown), FileNames(names))
    assert says in refused.value.remedy


@pytest.mark.parametrize("slide_unit", [1e-3, 1.0])
def test_a_track_in_the_last_column_is_put_first(tmp_path, slide_unit):
    """The file holds degrees of six axes, then the track; the track stands first in the description."""
    model, rng = arm_on_track(tmp_path), np.random.default_rng(6)
    joints = rng.uniform(-1.2, 1.2, (ROWS, 7))
    in_file = np.column_stack([np.rad2deg(joints[:, 1:]), joints[:, 0] / slide_unit])
    taken = np.column_stack([in_file[:, 0] * 1e-3, np.deg2rad(in_file[:, 1:])])
    refused = refusal(model, replace(points(model, joints, rng), joints_rad=taken), angle_unit="deg")
    assert "joints=J7,J1,J2,J3,J4,J5,J6" in refused.remedy
    assert f"slides={'mm' if slide_unit < 1 else 'm'}" in refused.remedy
