"""One coordinate of another size than the other two: named with its factor, and not found where an arm lacks something."""

from dataclasses import replace

import numpy as np
import pytest

from cellcal.calibration.identification.axis_scales import AxisScale, find_axis_scale, refuse_axis_scale
from cellcal.calibration.identification.misfit_error import MisfitError
from cellcal.calibration.identification.observations import Observations
from cellcal.calibration.identification.target_change import series_columns
from tests.unit.helpers.simulated_arm import tracker_points

ROBOTS = ["ur10", "abb_irb120", "fanuc_m6ib", "kuka_kr6_r900"]


def scale_in(model, rows: Observations) -> AxisScale | None:
    return find_axis_scale(series_columns(model, rows), rows)


@pytest.mark.parametrize("robot", ROBOTS)
@pytest.mark.parametrize("factor", [0.998, 1.001, 1.003])
def test_a_coordinate_of_another_size_is_named_with_its_factor(robot: str, factor: float) -> None:
    for axis in range(3):
        true = tracker_points(robot, 60, seed=axis)
        places = true.observations.positions_m.copy()
        places[:, axis] *= factor
        rows = replace(true.observations, positions_m=places)
        found = scale_in(true.model, rows)
        assert found is not None
        assert found.axis == axis
        assert found.factor == pytest.approx(factor, abs=4e-4)
        with pytest.raises(MisfitError, match=f"{'XYZ'[axis]} is .* beside the other two"):
            refuse_axis_scale(true.model, rows, found, ("X", "Y", "Z"))


@pytest.mark.parametrize("robot", ROBOTS)
@pytest.mark.parametrize("effect", ["nothing", "play", "ripple", "gear", "scale", "drift", "outliers"])
def test_what_an_arm_or_a_device_has_beside_it_is_no_other_size(robot: str, effect: str) -> None:
    for seed in range(3):
        true, random = tracker_points(robot, 60, seed=seed), np.random.default_rng(seed)
        joints, places = true.observations.joints_rad.copy(), true.observations.positions_m.copy()
        if effect == "play":
            joints += np.deg2rad(0.05) * np.sign(np.diff(joints, axis=0, prepend=joints[:1]))
        elif effect == "ripple":
            joints += np.deg2rad(0.05) * np.sin(joints + random.random(6))
        elif effect == "gear":
            joints[:, 1:3] *= 1.002
        elif effect == "scale":
            places *= 1.003
        elif effect == "drift":
            places += np.linspace(0.0, 1.0, 60)[:, None] * [1e-3, 5e-4, 0.0]
        elif effect == "outliers":
            places[random.random(60) < 0.08] += 0.01
        rows = replace(true.observations, joints_rad=joints, positions_m=places)
        assert scale_in(true.model, rows) is None
