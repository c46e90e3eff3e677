"""Rows with several places: which one the device read, which the controller calculated, which are other targets."""

from pathlib import Path

import numpy as np
import pytest

from cellcal.calibration.arm.kinematics import load_model
from cellcal.calibration.geometry import Array
from cellcal.calibration.identification.lints import find_calculated_positions
from cellcal.calibration.orientation import values_from
from cellcal.service.engineering.identification.identify import IdentifyOptions, identify_file
from cellcal.service.engineering.measured.errors import MeasurementError
from cellcal.service.engineering.measured.measurements import Measurements, ReadOptions, read_measurements
from tests.unit.helpers.simulated_arm import tracker_poses

MODEL = load_model("abb_irb120")
POSES = tracker_poses("abb_irb120", 40)
DEG = np.rad2deg(POSES.observations.joints_rad)
MM = POSES.observations.positions_m * 1e3
TURNS = POSES.observations.rotations
OTHER_MM = MM + TURNS @ np.array([20.0, -70.0, 35.0])
THIRD_MM = MM + TURNS @ np.array([-50.0, 10.0, 60.0])
FLANGE = MODEL.base_flange(POSES.observations.joints_rad)
CONTROLLER_MM = (FLANGE @ np.array([0.0, 0.01, 0.12, 1.0]))[:, :3] * 1e3
JOINTS = [f"J{i}" for i in range(1, 7)]


def read_columns(folder: Path, names: list[str], *blocks: Array, digits: int = 4) -> Measurements:
    """Return what is read of a file with these columns behind the joints."""
    rows = np.column_stack([DEG, *blocks])
    lines = [",".join([*JOINTS, *names]), *(",".join(f"{cell:.{digits}f}" for cell in row) for row in rows)]
    path = folder / "rows.csv"
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")
    return read_measurements(path, MODEL)


def assert_reads(found: Measurements, places_mm: Array) -> None:
    assert np.allclose(found.observations.positions_m * 1e3, places_mm, atol=1e-3)


@pytest.mark.parametrize(
    "pattern",
    ["{axis}{at}", "SMR{at}_{axis}", "T{at} {axis}", "ball{at}.{axis}", "{axis}_{at}", "{axis}_meas{at}"],
)
def test_further_targets_are_not_the_controllers_places_and_are_named(tmp_path: Path, pattern: str) -> None:
    names = [pattern.format(axis=axis, at=at) for at in (1, 2, 3) for axis in "XYZ"]
    found = read_columns(tmp_path, names, MM, OTHER_MM, THIRD_MM)
    assert_reads(found, MM)
    assert found.layout.position == tuple(names[:3])
    assert found.controller_m is None
    note = next(str(guess) for guess in found.guesses if "take no part" in guess)
    assert all(name in note for name in names[3:])
    assert "--layout" in note


def test_places_from_both_sides_are_not_the_controllers(tmp_path: Path) -> None:
    names = [f"{axis} {side}" for side in ("front", "back") for axis in "XYZ"]
    found = read_columns(tmp_path, names, MM, MM + 0.02)
    assert_reads(found, MM)
    assert found.controller_m is None


@pytest.mark.parametrize(
    "names",
    [
        ["X", "Y", "Z", "MX", "MY", "MZ"],
        ["x_r", "y_r", "z_r", "x_t", "y_t", "z_t"],
        ["X1", "Y1", "Z1", "X2", "Y2", "Z2"],
        ["R_X", "R_Y", "R_Z", "L_X", "L_Y", "L_Z"],
    ],
)
@pytest.mark.parametrize("digits", [2, 4])
def test_what_the_nominal_arm_calculates_was_not_measured(
    tmp_path: Path, names: list[str], digits: int
) -> None:
    found = read_columns(tmp_path, names, CONTROLLER_MM, MM, digits=digits)
    assert found.layout.position == tuple(names[3:])
    assert found.layout.controller == tuple(names[:3])
    assert np.allclose(found.observations.positions_m * 1e3, MM, atol=2 * 10.0**-digits)
    found = read_columns(tmp_path, names, MM, CONTROLLER_MM, digits=digits)
    assert found.layout.position == tuple(names[:3])
    assert found.layout.controller == tuple(names[3:])


def test_words_win_over_what_looks_calculated(tmp_path: Path) -> None:
    names = [f"{word} {axis}" for word in ("tracker", "spare") for axis in "XYZ"]
    found = read_columns(tmp_path, names, CONTROLLER_MM, MM)
    assert found.layout.position == tuple(names[:3])


@pytest.mark.parametrize(
    "names",
    [
        ["Xcmd", "Ycmd", "Zcmd", "Xact", "Yact", "Zact"],
        ["xnom", "ynom", "znom", "xmeas", "ymeas", "zmeas"],
        ["Xnom", "Ynom", "Znom", "Xmm", "Ymm", "Zmm"],
    ],
)
def test_words_may_be_glued_to_the_axis(tmp_path: Path, names: list[str]) -> None:
    found = read_columns(tmp_path, names, CONTROLLER_MM, MM)
    assert_reads(found, MM)
    assert found.layout.controller == tuple(names[:3])


def test_moments_beside_forces_are_no_places(tmp_path: Path) -> None:
    names = ["Fx", "Fy", "Fz", "Mx", "My", "Mz", "X", "Y", "Z"]
    noise = np.random.default_rng(0).normal(size=(len(MM), 6))
    found = read_columns(tmp_path, names, noise, MM)
    assert_reads(found, MM)
    assert not [guess for guess in found.guesses if "take no part" in guess]


def test_the_range_of_a_tracker_is_no_wire(tmp_path: Path) -> None:
    distance = np.linalg.norm(MM, axis=1)
    found = read_columns(tmp_path, ["theta", "phi", "dist", "x", "y", "z"], MM[:, :2] / 50, distance, MM)
    assert_reads(found, MM)
    assert found.layout.length == ""


def test_a_wire_beside_the_controllers_places_stays_a_wire(tmp_path: Path) -> None:
    length = np.linalg.norm(CONTROLLER_MM - [300.0, -800.0, 50.0], axis=1)
    found = read_columns(tmp_path, ["L", "x", "y", "z"], length, CONTROLLER_MM)
    assert found.layout.length == "L"
    assert found.layout.controller == ("x", "y", "z")


HOMOGENEOUS = np.concatenate([TURNS, MM[:, :, None]], axis=2)  # (N, 3, 4)
LAST_ROW = np.tile([0.0, 0.0, 0.0, 1.0], (len(MM), 1))


@pytest.mark.parametrize(
    ("names", "block"),
    [
        (
            [f"m_{row}{column}" for row in range(4) for column in range(4)],
            np.column_stack([HOMOGENEOUS.reshape(-1, 12), LAST_ROW]),
        ),
        ([f"T{row}{column}" for row in (1, 2, 3) for column in (1, 2, 3, 4)], HOMOGENEOUS.reshape(-1, 12)),
        (
            ["X", "Y", "Z", *(f"r{row}_{column}" for row in (1, 2, 3) for column in (1, 2, 3))],
            np.column_stack([MM, TURNS.reshape(-1, 9)]),
        ),
        (
            [*(f"{axis}{of}" for axis in "noa" for of in "xyz"), "px", "py", "pz"],
            np.column_stack([np.swapaxes(TURNS, 1, 2).reshape(-1, 9), MM]),
        ),
    ],
    ids=["4 x 4", "3 x 4", "place and 3 x 3", "noap"],
)
def test_poses_are_read_from_matrices(tmp_path: Path, names: list[str], block: Array) -> None:
    found = read_columns(tmp_path, names, block, digits=6)
    assert_reads(found, MM)
    assert found.convention == "rotation_matrix"
    assert np.allclose(found.observations.rotations, TURNS, atol=1e-5)


@pytest.mark.parametrize("fields", ["qi qj qk qw", "Q_i Q_j Q_k Q_w"])
def test_a_quaternion_may_be_written_with_i_j_k(tmp_path: Path, fields: str) -> None:
    scalar_last = values_from("ros_quaternion", TURNS)
    found = read_columns(tmp_path, ["X", "Y", "Z", *fields.split()], MM, scalar_last, digits=6)
    assert np.allclose(found.observations.rotations, TURNS, atol=1e-5)


def test_lists_of_joints_are_no_place_and_four_numbers_of_an_attitude_a_quaternion(tmp_path: Path) -> None:
    blocks = (np.deg2rad(DEG), MM / 1e3, values_from("ros_quaternion", TURNS))
    lines = ["joint_positions,position,orientation"]
    lines += [
        ",".join(f'"{row}"' for row in rows) for rows in zip(*(b.tolist() for b in blocks), strict=True)
    ]
    path = tmp_path / "rows.csv"
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")
    found = read_measurements(path, MODEL)
    assert_reads(found, MM)
    assert np.allclose(found.observations.rotations, TURNS, atol=1e-5)


def test_matrices_written_by_columns_are_turned_round(tmp_path: Path) -> None:
    names = ["X", "Y", "Z", *(f"R{row}{column}" for row in (1, 2, 3) for column in (1, 2, 3))]
    found = read_columns(tmp_path, names, MM, np.swapaxes(TURNS, 1, 2).reshape(-1, 9), digits=6)
    assert found.convention == "rotation_matrix_transposed"
    assert np.allclose(found.observations.rotations, TURNS, atol=1e-5)


def test_nine_numbers_that_are_no_rotation_are_left_out(tmp_path: Path) -> None:
    names = ["X", "Y", "Z", *(f"R{row}{column}" for row in (1, 2, 3) for column in (1, 2, 3))]
    found = read_columns(tmp_path, names, MM, TURNS.reshape(-1, 9) * 1.2)
    assert_reads(found, MM)
    assert found.convention == ""
    assert any("no rotation" in guess for guess in found.guesses)


def test_a_matrix_beside_euler_angles_does_not_replace_them(tmp_path: Path) -> None:
    angles = np.rad2deg(values_from("instrument_zyx", TURNS))
    names = [
        "X",
        "Y",
        "Z",
        "Rx",
        "Ry",
        "Rz",
        *(f"c{row}{column}" for row in (1, 2, 3) for column in (1, 2, 3)),
    ]
    noise = np.random.default_rng(0).normal(size=(len(MM), 9))
    found = read_columns(tmp_path, names, MM, angles, noise)
    assert found.layout.turn == ("Rx", "Ry", "Rz")


OWN_MODEL_MM = (
    tracker_poses("abb_irb120", 4, seed=7)
    .truth.seen_from(0)
    .base_flange(POSES.observations.joints_rad)[:, :3, 3]
    * 1e3
)


def test_what_a_controller_calculates_with_its_own_model_is_refused_beside_another_place(
    tmp_path: Path,
) -> None:
    read_columns(tmp_path, ["X", "Y", "Z", "X1", "Y1", "Z1"], OWN_MODEL_MM, MM)
    with pytest.raises(MeasurementError, match="calculated by a controller") as refused:
        identify_file(tmp_path / "rows.csv", MODEL.name, IdentifyOptions(level=2))
    assert "position=X1,Y1,Z1" in refused.value.remedy
    named = IdentifyOptions(level=2, read=ReadOptions(columns={"position": ("X1", "Y1", "Z1")}))
    found = identify_file(tmp_path / "rows.csv", MODEL.name, named)
    assert "not_measured" not in [lint.code for lint in found.lints]


def test_what_a_controller_calculates_with_its_own_model_is_named_alone(tmp_path: Path) -> None:
    read_columns(tmp_path, ["X", "Y", "Z"], OWN_MODEL_MM)
    found = identify_file(tmp_path / "rows.csv", MODEL.name, IdentifyOptions(level=2))
    assert "not_measured" in [lint.code for lint in found.lints]
    assert find_calculated_positions(np.full(10, 6e-6), 1e-5)
    assert not find_calculated_positions(np.full(10, 6e-6), 1e-6)
    assert not find_calculated_positions(np.full(10, 5e-5), 1e-4)


def test_what_was_measured_coarsely_is_not_called_calculated(tmp_path: Path) -> None:
    read_columns(tmp_path, ["X", "Y", "Z"], OWN_MODEL_MM, digits=1)
    found = identify_file(tmp_path / "rows.csv", MODEL.name, IdentifyOptions(level=2))
    assert "not_measured" not in [lint.code for lint in found.lints]
