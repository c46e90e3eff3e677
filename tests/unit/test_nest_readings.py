"""Rows in which a nest or a second ball was read are no readings of the robot's target."""

import numpy as np
import pytest

from cellcal.calibration.arm.kinematics import load_model
from cellcal.calibration.geometry import Array, exp_rotation, homogeneous_matrix
from cellcal.service.engineering.measured.nest_readings import find_nest_readings

MODEL = load_model("abb_irb120")
TARGET_M = np.array([0.03, -0.02, 0.11])
NOISE_M = 3e-5


def random_postures(count: int, seed: int) -> tuple[Array, Array]:
    """Return the true and the nominal flange (N, 4, 4) of an arm whose zeros are off by a third of a degree."""
    rng = np.random.default_rng(seed)
    joints = rng.uniform(0.7 * MODEL.lower_rad, 0.7 * MODEL.upper_rad, size=(count, 6))
    return MODEL.base_flange(joints + rng.normal(scale=5e-3, size=6)), MODEL.base_flange(joints)


def measured_places(count: int = 40, seed: int = 3) -> tuple[Array, Array]:
    """Return places (N, 3) as a tracker reads them, and the nominal flange (N, 4, 4)."""
    true_flange, nominal_flange = random_postures(count, seed)
    device = homogeneous_matrix(exp_rotation(np.array([0.1, -0.2, 0.7])), np.array([1.5, -2.0, 0.4]))
    places = (device @ true_flange)[:, :3, :] @ np.append(TARGET_M, 1.0)
    return places + np.random.default_rng(seed).normal(scale=NOISE_M, size=places.shape), nominal_flange


@pytest.mark.parametrize("unit_m", [1.0, 1e-3, 0.0254])
@pytest.mark.parametrize("nest_m", [(2.0, -1.0, 0.1), (1.7, -1.8, 0.5)], ids=["far", "in the work"])
@pytest.mark.parametrize("every", [5, 13])
def test_a_nest_between_poses_is_found(unit_m: float, nest_m: tuple[float, ...], every: int) -> None:
    places, flange = measured_places()
    rows = np.arange(every, len(places), every)
    places[rows] = np.array(nest_m) + np.random.default_rng(1).normal(scale=NOISE_M, size=(len(rows), 3))
    found = find_nest_readings(places / unit_m, flange)
    assert sorted(found) == rows.tolist()
    assert all("was not on the robot" in why for why in found.values())


def test_good_rows_are_left_alone() -> None:
    assert find_nest_readings(*measured_places(400)) == {}


def test_a_target_about_which_the_robot_turns_is_a_reading() -> None:
    places, flange = measured_places()
    rng = np.random.default_rng(4)
    for row in range(5, 25):
        turn = exp_rotation(rng.normal(size=3))
        flange[row] = homogeneous_matrix(turn, np.array([0.35, 0.1, 0.4]) - turn @ TARGET_M)
    device = homogeneous_matrix(exp_rotation(np.array([0.1, -0.2, 0.7])), np.array([1.5, -2.0, 0.4]))
    places[5:25] = (device @ flange[5:25])[:, :3, :] @ np.append(TARGET_M, 1.0)
    assert find_nest_readings(places, flange) == {}


def test_poses_that_are_visited_again_are_readings() -> None:
    places, flange = measured_places(10)
    again = np.tile(np.arange(10), 5)
    noise = np.random.default_rng(5).normal(scale=NOISE_M, size=(50, 3))
    assert find_nest_readings(places[again] + noise, flange[again]) == {}


def test_lengths_and_few_rows_are_not_judged() -> None:
    places, flange = measured_places()
    assert find_nest_readings(np.linalg.norm(places, axis=1)[:, None], flange) == {}
    assert find_nest_readings(places[:6], flange[:6]) == {}
