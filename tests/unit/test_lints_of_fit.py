"""Residuals that follow a joint, the temperature or the order of rows are noted, and noise is not."""

from dataclasses import replace

import numpy as np
import pytest

from cellcal.calibration.arm.kinematics import load_model
from cellcal.calibration.identification import lints
from cellcal.calibration.identification.drift_lint import fit_drift, order_drift, temperature_drift
from cellcal.calibration.identification.sweep_lint import sweep_lint
from cellcal.service.engineering.identification.identify import identify_file
from cellcal.service.engineering.identification.row_fit import IdentifyOptions
from tests.unit.helpers.simulated_arm import random_joints, tracker_points
from tests.unit.test_identify_report import file_of

NAMES = [f"J{i}" for i in range(1, 7)]
COUNT = 300


def simulated_residuals(seed=0):
    rng = np.random.default_rng(seed)
    return rng.uniform(-1.5, 1.5, (COUNT, 6)), 1e-4 * rng.standard_normal((3, COUNT)), np.arange(COUNT)


@pytest.mark.parametrize(
    ("shape", "words"),
    [
        (lambda q: 1.5e-4 * q, "a trend from -0.1"),
        (lambda q: np.where(q > np.deg2rad(30), 2e-4, -1e-4), "a step near"),
        (lambda q: 2e-4 * np.sin(4 * q), "a wave of"),
    ],
)
def test_what_follows_a_joint_is_named_with_its_shape(shape, words):
    joints, residuals, groups = simulated_residuals()
    residuals[1] += shape(joints[:, 3])
    (found,) = sweep_lint(joints, residuals, groups, NAMES)
    assert found.code == "sweep"
    assert "along y follow J4" in found.message
    assert words in found.message


def test_the_place_of_a_step_is_reported():
    joints, residuals, groups = simulated_residuals()
    residuals[0] += np.where(joints[:, 1] > np.deg2rad(30), 2e-4, -1e-4)
    (found,) = sweep_lint(joints, residuals, groups, NAMES)
    place = float(found.message.split("near ")[1].split(" deg")[0])
    assert abs(place - 30) < 15


def test_noise_follows_no_joint():
    assert [lint for seed in range(20) for lint in sweep_lint(*simulated_residuals(seed), NAMES)] == []


def test_runs_that_drift_do_not_pass_for_a_sweep():
    """Twenty runs, each at one angle of the wrist and each off by its own drift: no joint is to blame."""
    found = []
    for seed in range(10):
        rng = np.random.default_rng(seed)
        groups = np.repeat(np.arange(20), 15)
        joints = rng.uniform(-1.5, 1.5, (20, 6))[groups]
        residuals = 1e-4 * rng.standard_normal((3, 20))[:, groups] + 2e-5 * rng.standard_normal((3, 300))
        found += sweep_lint(joints, residuals, groups, NAMES)
    assert len(found) <= 1


def test_a_drift_with_temperature_is_reported_per_degree():
    _, residuals, _ = simulated_residuals()
    groups = np.arange(COUNT) // 10
    degrees = np.linspace(20.0, 23.0, COUNT)
    assert temperature_drift(None, residuals, groups) == []
    (still,) = temperature_drift(degrees, residuals, groups)
    assert "do not follow it" in still.message
    assert temperature_drift(np.full(COUNT, 21.0), residuals, groups) == []
    residuals[2] += 1e-4 * (degrees - 20.0)
    degrees[5] = np.nan
    (drifts,) = temperature_drift(degrees, residuals, groups)
    assert "per degree" in drifts.message
    assert abs(float(drifts.message.split("go with it: ")[1].split(" mm")[0]) - 0.1) < 0.03


def test_the_deviation_of_a_slope_comes_from_groups():
    slopes, sigmas = [], []
    for seed in range(60):
        rng = np.random.default_rng(seed)
        groups = np.repeat(np.arange(25), 12)
        residuals = rng.standard_normal((1, 25))[:, groups] + 0.1 * rng.standard_normal((1, 300))
        drift = fit_drift(np.repeat(rng.uniform(0, 1, 25), 12), residuals, groups)
        slopes.append(drift.slope[0])
        sigmas.append(drift.sigma[0])
    assert 0.7 < np.std(slopes) / np.mean(sigmas) < 1.4


def test_residuals_that_wander_are_noted():
    _, residuals, _ = simulated_residuals()
    groups = np.arange(COUNT) // 10
    assert order_drift(residuals, groups) == []
    residuals[0] += np.linspace(-1e-4, 1e-4, COUNT)
    assert order_drift(residuals, groups)[0].code == "order"


def test_a_temperature_column_is_read_and_judged(tmp_path):
    simulated = tracker_points("ur10", 120, seed=2)
    degrees = np.linspace(20.0, 26.0, 120)
    positions = simulated.observations.positions_m + np.outer(degrees - 20.0, [0.0, 0.0, 1e-4])
    path = file_of(
        replace(simulated, observations=replace(simulated.observations, positions_m=positions)),
        tmp_path / "warm.csv",
    )
    lines = path.read_text(encoding="utf-8").splitlines()
    warm = [f"{lines[0]},temperature", *(f"{row},{t:.2f}" for row, t in zip(lines[1:], degrees, strict=True))]
    path.write_text("\n".join(warm) + "\n", encoding="utf-8")
    report = identify_file(path, "ur10", IdentifyOptions(level=2))
    assert "temperature" in {lint.code for lint in report.lints}
    assert any("per degree" in lint.message for lint in report.lints)


def test_the_floor_names_what_is_coarse():
    model = load_model("abb_irb120")
    joints = random_joints(model, np.random.default_rng(0), 100)
    (values,) = lints.rounding_floor(model, joints, np.full(6, 1e-9), 1e-3)
    assert "measured values are rounded to 1 mm" in values.message
    assert "joints" not in values.message


def test_attitudes_without_noise_make_no_order_of_rows() -> None:
    rng, rows = np.random.default_rng(5), np.arange(40.0)
    places = rng.normal(0.0, 3e-5, (3, 40))
    attitudes = 1e-9 * (rows - rows.mean()) + rng.normal(0.0, 1e-9, (3, 40))
    assert order_drift(np.vstack([places, attitudes]), np.arange(40)) == []
    places[1] += 4e-6 * rows
    (found,) = order_drift(np.vstack([places, attitudes]), np.arange(40))
    assert found.code == "order"
