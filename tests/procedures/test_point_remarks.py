"""What the residuals of a frame from drawn points do not show is put in words: exchanged names, another scale."""

import re

import numpy as np
import pytest

from cellcal.calibration.geometry import exp_rotation
from cellcal.procedures.teaching.point_remarks import point_remarks

RNG = np.random.default_rng(11)
SQUARE = np.array([[0.0, 0, 0], [0.4, 0, 0], [0.4, 0.4, 0], [0, 0.4, 0]])
IRREGULAR = RNG.uniform(-0.4, 0.4, (8, 3))
TURN = exp_rotation(np.array([0.1, 0.2, 0.7]))


def measure_points(drawn, scale=1.0, sigma_m=5e-5):
    return scale * drawn @ TURN.T + [1.2, -0.3, 0.4] + RNG.normal(scale=sigma_m, size=drawn.shape)


def remarks_on(drawn, measured):
    return point_remarks([f"T{row + 1}" for row in range(len(drawn))], drawn, measured)


@pytest.mark.parametrize("shift", [0, 1, 2])
def test_corners_of_a_square_do_not_tell_their_order(shift):
    remark, *more = remarks_on(SQUARE, np.roll(measure_points(SQUARE), shift, axis=0))
    assert not more
    assert "in the order T" in remark
    assert "turned by 90 deg" in remark or "turned by 180 deg" in remark


@pytest.mark.parametrize("drawn", [np.vstack([SQUARE, [[0.13, 0.05, 0.02]]]), IRREGULAR])
def test_points_of_no_pattern_need_no_remark(drawn):
    assert remarks_on(drawn, measure_points(drawn)) == ()


@pytest.mark.parametrize(("scale", "sigma_m"), [(1.002, 5e-5), (0.998, 5e-5), (1.0005, 2e-5)])
def test_another_scale_is_named_with_its_figure(scale, sigma_m):
    (remark,) = remarks_on(IRREGULAR, measure_points(IRREGULAR, scale, sigma_m))
    figure = re.search(r"are (\d\.\d{5}) times", remark)
    assert figure
    assert float(figure[1]) == pytest.approx(scale, abs=2e-4)
    assert "which more points do not cure" in remark


def test_noise_is_no_scale():
    found = [remarks_on(IRREGULAR, measure_points(IRREGULAR, sigma_m=3e-4)) for _ in range(300)]
    assert not any(found)
