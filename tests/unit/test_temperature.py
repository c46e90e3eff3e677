"""A temperature beside every row is a regressor where unseen rows gain by it, and only there."""

from dataclasses import replace

import numpy as np
import pytest

from cellcal.calibration.arm.kinematics import load_model
from cellcal.calibration.identification.cross_validation import group_rows
from cellcal.calibration.identification.temperature import temperature_effect, temperature_note
from cellcal.service.engineering.identification.identify import identify_file
from cellcal.service.engineering.identification.row_fit import IdentifyOptions
from tests.unit.helpers.simulated_arm import tracker_points, wire_lengths
from tests.unit.test_identify_report import file_of

SHIFT_M = np.array([6e-5, -2e-5, 4e-5])  # a degree


def warmed_measurements(count=200, slope=SHIFT_M, seed=2):
    simulated = tracker_points("ur10", count, seed=seed)
    degrees = 21.0 + np.cumsum(np.random.default_rng(seed).normal(0.03, 0.1, count))
    rows = simulated.observations
    moved = rows.positions_m + (degrees - degrees.mean())[:, None] * slope
    return simulated, replace(rows, positions_m=moved), degrees


def test_the_shift_of_a_degree_is_found_and_taken_out():
    simulated, rows, degrees = warmed_measurements()
    found = temperature_effect(load_model("ur10"), rows, degrees, group_rows(rows.joints_rad))
    assert found.slopes == pytest.approx(SHIFT_M, abs=1.5e-5)
    assert found.at == pytest.approx(degrees.mean())
    back = found.remove_effect(rows, degrees)
    assert np.abs(back.positions_m - simulated.observations.positions_m).max() < 5e-5
    (note,) = temperature_note(found)
    assert f"at {degrees.mean():.1f} °C" in note.message


def test_a_wire_shifts_by_one_number():
    simulated = wire_lengths(count=200)
    degrees = 20.0 + np.cumsum(np.random.default_rng(0).normal(0.03, 0.1, 200))
    rows = simulated.observations
    rows = replace(rows, lengths_m=rows.lengths_m + 1e-4 * (degrees - degrees.mean()))
    found = temperature_effect(simulated.model, rows, degrees, group_rows(rows.joints_rad))
    assert found.slopes == pytest.approx([1e-4], abs=2e-5)


@pytest.mark.parametrize("known_share", [True, False])
def test_what_gains_nothing_or_is_not_known_everywhere_is_left_alone(known_share):
    _, rows, degrees = warmed_measurements(slope=np.zeros(3) if known_share else SHIFT_M)
    if not known_share:
        degrees = np.where(np.arange(len(degrees)) == 7, np.nan, degrees)
    grouping = group_rows(rows.joints_rad)
    assert temperature_effect(load_model("ur10"), rows, degrees, grouping) is None
    assert temperature_effect(load_model("ur10"), rows, None, grouping) is None
    assert temperature_note(None) == []


def test_a_file_with_a_temperature_is_identified_at_its_mean(tmp_path):
    simulated, rows, degrees = warmed_measurements()
    path = file_of(replace(simulated, observations=rows), tmp_path / "warm.csv")
    head, *lines = path.read_text(encoding="utf-8").splitlines()
    cold = identify_file(path, "ur10", IdentifyOptions(level=2))
    lines = [f"{line},{degree:.3f}" for line, degree in zip(lines, degrees, strict=True)]
    path.write_text("\n".join([f"{head},temperature", *lines]) + "\n", encoding="utf-8")
    report = identify_file(path, "ur10", IdentifyOptions(level=2, check=path))
    assert report.held_out.rmse_m < 0.9 * cold.held_out.rmse_m
    assert report.check.rmse_m < 0.9 * cold.held_out.rmse_m  # a check file is brought to the same temperature
    assert any("taken out" in lint.message for lint in report.lints if lint.code == "temperature")
