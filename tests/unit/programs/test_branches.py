"""Eight postures of a pose: all of them real, the one it came from among them, and no ninth."""

from dataclasses import replace

import numpy as np
import pytest

from cellcal.calibration.arm.kinematics import DhTable, RobotModel, load_model, model_names
from cellcal.calibration.errors import CalibrationError
from cellcal.calibration.programs.branches import AxesAtZero, all_branches, branch_numbers


def _draw_postures(model: RobotModel, count: int = 300) -> np.ndarray:
    rng = np.random.default_rng(len(model.name))
    return rng.uniform(model.lower_rad, model.upper_rad, (count, 6))


@pytest.mark.parametrize("name", model_names())
def test_every_branch_reaches_and_the_first_posture_is_among_them(name: str) -> None:
    model = load_model(name)
    joints = _draw_postures(model)
    target_flanges = model.base_flange(joints)

    found = all_branches(AxesAtZero.from_model(model), target_flanges)

    reached = np.isfinite(found).all(axis=2)
    for branch, rows in zip(found, reached, strict=True):
        assert np.abs(model.base_flange(branch[rows]) - target_flanges[rows]).max() < 1e-12
    apart = np.abs(np.remainder(found - joints + np.pi, 2 * np.pi) - np.pi).max(axis=2)
    assert np.nanmin(apart, axis=0).max() < 1e-6


@pytest.mark.parametrize("name", ["fanuc_m6ib", "kuka_kr6_r900", "abb_irb120", "ur10e"])
def test_branches_are_different_postures(name: str) -> None:
    model = load_model(name)
    found = all_branches(AxesAtZero.from_model(model), model.base_flange(_draw_postures(model)))

    turned = np.remainder(found[:, None] - found[None, :] + np.pi, 2 * np.pi) - np.pi
    apart = np.abs(turned).max(axis=3)
    apart[np.arange(8), np.arange(8)] = 1.0

    assert np.nanmin(apart) > 1e-4


def test_a_pose_beyond_reach_has_no_posture() -> None:
    model = load_model("fanuc_m6ib")
    far = model.base_flange(np.zeros((1, 6)))
    far[0, :3, 3] *= 5.0

    assert np.isnan(all_branches(AxesAtZero.from_model(model), far)).any(axis=2).all()


@pytest.mark.parametrize("name", ["fanuc_m6ib", "abb_irb120", "ur5e"])
def test_a_singular_wrist_still_gives_a_posture(name: str) -> None:
    model = load_model(name)
    joints = _draw_postures(model, 50) * 0.4
    joints[:, 4] = -model.theta0_rad[4]
    target_flanges = model.base_flange(joints)

    found = all_branches(AxesAtZero.from_model(model), target_flanges)

    reached = np.isfinite(found).all(axis=2)
    if name != "ur5e":  # there joint 4 is one of the free turns of the singular wrist, and may not reach
        assert reached.any(axis=0).all()
    for branch, rows in zip(found, reached, strict=True):
        assert np.abs(model.base_flange(branch[rows]) - target_flanges[rows]).max() < 1e-7


def test_an_arm_of_neither_family_is_refused() -> None:
    rng = np.random.default_rng(1)
    strange = RobotModel.from_dh(DhTable.from_rows(rng.normal(size=(6, 5))), name="strange")
    nearly = load_model("fanuc_m6ib").with_dh_errors(1e-3 * np.ones((6, 5)))
    short = replace(
        load_model("ur5e"),
        dh=None,
        placements=load_model("ur5e").placements[:6],
        joint_coupling=np.eye(5),
        joint_names=tuple("abcde"),
        theta0_rad=np.zeros(5),
        lower_rad=-np.ones(5),
        upper_rad=np.ones(5),
        max_speed_rad_s=np.ones(5),
    )

    for model, says in ((strange, "postures"), (nearly, "postures"), (short, "ur5e has 5, of which 0 slide")):
        with pytest.raises(CalibrationError, match=says):
            AxesAtZero.from_model(model)


@pytest.mark.parametrize("name", model_names())
def test_the_branch_of_an_arm_changes_in_singularities_only(name: str) -> None:
    model = load_model(name)
    first, last = _draw_postures(model, 2)
    way = first + (last - first) * np.linspace(0.0, 1.0, 4001)[:, None]

    numbers = branch_numbers(AxesAtZero.from_model(model), way)
    signs = np.sign(np.linalg.det(model.flange_jacobian(way)[1]))

    changes = np.flatnonzero(np.diff(numbers))
    crossings = np.flatnonzero(np.diff(signs))
    assert all(np.abs(crossings - change).min(initial=len(way)) <= 1 for change in changes)
    assert len(set(numbers[signs > 0]) & set(numbers[signs < 0])) == 0
