"""Attitudes in every order of turns, inverted, and under a convention that was stated wrongly."""

from pathlib import Path

import numpy as np
import pytest

from cellcal.calibration.arm.kinematics import load_model
from cellcal.calibration.geometry import quaternion_from_rotation
from cellcal.calibration.identification.observations import PointObservations, PoseObservations
from cellcal.calibration.orientation import euler_angles, values_from
from cellcal.service.engineering.measured.measurements import Measurements, ReadOptions, read_measurements
from cellcal.service.engineering.measured.table import MeasurementError
from tests.unit.helpers.simulated_arm import tracker_poses

MODEL = load_model("abb_irb120")
POSES = tracker_poses("abb_irb120", 40)
DEG = np.rad2deg(POSES.observations.joints_rad)
MM = POSES.observations.positions_m * 1e3
TURNS = POSES.observations.rotations


def read_attitudes(
    folder: Path, names: str, values: np.ndarray, convention: str = "", position_mm: np.ndarray = MM
) -> Measurements:
    heading = ",".join([*(f"J{i}" for i in range(1, 7)), "X", "Y", "Z", *names.split()])
    rows = [
        ",".join(f"{number:.6f}" for number in row) for row in np.column_stack([DEG, position_mm, values])
    ]
    path = folder / "rows.csv"
    path.write_text("\n".join([heading, *rows, ""]), encoding="utf-8")
    return read_measurements(path, MODEL, ReadOptions(convention=convention))


def assert_turns(found: Measurements, convention: str) -> None:
    assert found.convention == convention
    assert isinstance(found.observations, PoseObservations)
    assert np.allclose(found.observations.rotations, TURNS, atol=1e-4)


@pytest.mark.parametrize("axes", ["xzy", "yxz", "yzx", "zxy"])
def test_angles_by_axis_in_every_order_of_turns(tmp_path: Path, axes: str) -> None:
    angles = np.rad2deg(euler_angles(axes, TURNS))[:, [axes.index(axis) for axis in "xyz"]]
    assert_turns(read_attitudes(tmp_path, "rx ry rz", angles), f"instrument_{axes}")


def test_angles_about_z_x_z(tmp_path: Path) -> None:
    assert_turns(read_attitudes(tmp_path, "rx ry rz", np.rad2deg(euler_angles("zxz", TURNS))), "euler_zxz")


def test_attitudes_of_the_device_in_the_target_are_inverted(tmp_path: Path) -> None:
    conjugate = quaternion_from_rotation(np.swapaxes(TURNS, 1, 2))
    assert_turns(read_attitudes(tmp_path, "qw qx qy qz", conjugate), "abb_quaternion_inverse")
    turned = -values_from("ur_rotation_vector", TURNS)
    assert_turns(read_attitudes(tmp_path, "rx ry rz", turned), "ur_rotation_vector_inverse")
    named = read_attitudes(tmp_path, "rx ry rz", turned, "ur_rotation_vector_inverse")
    assert_turns(named, "ur_rotation_vector_inverse")


INVERSE_MM = -np.einsum("nji,nj->ni", TURNS, MM)


@pytest.mark.parametrize(
    ("written", "names"),
    [
        ("abb_quaternion", "qw qx qy qz"),
        ("ros_quaternion", "qx qy qz qw"),
        ("ur_rotation_vector", "rx ry rz"),
        ("instrument_xyz", "rx ry rz"),
    ],
)
def test_poses_of_the_device_in_the_target_are_inverted_as_a_whole(
    tmp_path: Path, written: str, names: str
) -> None:
    back = np.swapaxes(TURNS, 1, 2)
    if names.startswith("q"):
        values = quaternion_from_rotation(back)[:, [0, 1, 2, 3] if names == "qw qx qy qz" else [1, 2, 3, 0]]
    else:
        values = values_from(written, back) * (1.0 if written == "ur_rotation_vector" else 180.0 / np.pi)
    found = read_attitudes(tmp_path, names, values, position_mm=INVERSE_MM)
    assert found.convention.endswith("_inverse_pose")
    assert isinstance(found.observations, PoseObservations)
    assert np.allclose(found.observations.rotations, TURNS, atol=1e-4)
    assert np.allclose(found.observations.positions_m, POSES.observations.positions_m, atol=2e-4)
    again = read_attitudes(tmp_path, names, values, found.convention, position_mm=INVERSE_MM)
    assert np.array_equal(again.observations.positions_m, found.observations.positions_m)


def test_poses_that_are_not_inverse_are_not_inverted_on_demand(tmp_path: Path) -> None:
    values = quaternion_from_rotation(TURNS)
    found = read_attitudes(tmp_path, "qw qx qy qz", values, "abb_quaternion_inverse_pose")
    assert not isinstance(found.observations, PoseObservations)
    assert np.allclose(found.observations.positions_m, POSES.observations.positions_m, atol=1e-6)
    assert any("attitudes left out" in guess for guess in found.guesses)


@pytest.mark.parametrize(
    ("written", "names", "stated"),
    [
        ("ur_rotation_vector", "rx ry rz", "ros_rpy"),
        ("instrument_xyz", "rx ry rz", "instrument_zyx"),
        ("ros_quaternion", "q1 q2 q3 q4", "abb_quaternion"),
    ],
)
def test_a_convention_that_was_stated_wrongly_is_named_with_the_right_one(
    tmp_path: Path, written: str, names: str, stated: str
) -> None:
    values = values_from(written, TURNS)
    found = read_attitudes(tmp_path, names, values, stated)
    assert isinstance(found.observations, PointObservations)
    assert any(f"`--convention {written}` fits" in guess for guess in found.guesses)


def test_a_quaternion_called_a_b_c_d_is_no_length(tmp_path: Path) -> None:
    assert_turns(read_attitudes(tmp_path, "a b c d", quaternion_from_rotation(TURNS)), "abb_quaternion")


def test_an_attitude_with_words_beside_a_place_without(tmp_path: Path) -> None:
    names = "pose.orientation.x pose.orientation.y pose.orientation.z pose.orientation.w"
    assert_turns(read_attitudes(tmp_path, names, values_from("ros_quaternion", TURNS)), "abb_quaternion")


@pytest.mark.parametrize("quaternion_first", [True, False])
def test_a_quaternion_called_as_the_joints_is_told_by_its_length(
    tmp_path: Path, quaternion_first: bool
) -> None:
    joints, turn = [f"q{at}" for at in range(1, 7)], ["q1", "q2", "q3", "q4"]
    parts = [(joints, DEG), (["x", "y", "z"], MM), (turn, quaternion_from_rotation(TURNS))]
    parts = parts[::-1] if quaternion_first else parts
    rows = np.column_stack([values for _, values in parts])
    lines = [",".join(f"{number:.6f}" for number in row) for row in rows]
    path = tmp_path / "rows.csv"
    path.write_text(
        "\n".join([",".join(name for names, _ in parts for name in names), *lines, ""]), encoding="utf-8"
    )
    found = read_measurements(path, MODEL)
    assert_turns(found, "abb_quaternion")
    assert np.allclose(np.rad2deg(found.observations.joints_rad), DEG, atol=1e-4)


def test_names_that_occur_twice_without_a_quaternion_are_refused(tmp_path: Path) -> None:
    heading = ",".join([*(f"q{at}" for at in range(1, 7)), "x", "y", "z", "q1", "q2", "q3", "q4"])
    lines = [",".join(f"{n:.6f}" for n in row) for row in np.column_stack([DEG, MM, DEG[:, :4]])]
    path = tmp_path / "rows.csv"
    path.write_text("\n".join([heading, *lines, ""]), encoding="utf-8")
    with pytest.raises(MeasurementError, match="occurs twice"):
        read_measurements(path, MODEL)
