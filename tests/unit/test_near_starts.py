"""What is quicker by a near start, or by giving up early, ends where the long way ends."""

from dataclasses import replace

import numpy as np
import pytest
from scipy import spatial

from cellcal.calibration.arm.kinematics import load_model
from cellcal.calibration.identification.cross_validation import same_postures
from cellcal.calibration.identification.frame_fits import FrameFits, fit_frames
from cellcal.calibration.identification.misfit_fit import fit_quickly
from tests.soak.misfits import WAYS, answer_to, is_named, measure_rows
from tests.unit.helpers.simulated_arm import ANCHOR, random_joints, tracker_points, wire_lengths
from tests.unit.test_identification_of_bad_data import with_outliers


@pytest.mark.parametrize("moved_m", [0.002, 0.3])
def test_places_from_a_fit_with_one_break_less_are_those_from_all_starts(moved_m):
    anchors = ANCHOR + np.array([[0.0, 0.0, 0.0], [moved_m, 0.0, 0.0], [moved_m, -moved_m, 0.0]])
    simulated = wire_lengths(count=120, anchors=anchors, breaks=(40, 80))
    fits = FrameFits(simulated.model, simulated.observations)
    for breaks in ([], [40], [80, 40], [40, 81]):
        near = fits.fit_breaks(breaks)
        far = fit_frames(simulated.model, simulated.observations, sorted(breaks))
        assert near.cost == pytest.approx(far.cost, rel=1e-4)
        for one, other in zip(near.state.devices, far.state.devices, strict=True):
            assert one.anchor_in_base_m == pytest.approx(other.anchor_in_base_m, abs=2e-5)


@pytest.mark.parametrize(("share", "size_m"), [(0.0, 0.0), (0.06, 0.8), (0.2, 0.05), (0.2, 0.5)])
def test_a_reading_that_reaches_the_limit_is_followed_whatever_outliers_pull(share, size_m):
    simulated, _ = with_outliers(tracker_points("abb_irb120", 60, sigma_m=1e-4), share, size_m, 3)
    alone = fit_quickly(simulated.model, simulated.observations)
    assert alone.score_m < 3e-3
    limited = fit_quickly(simulated.model, simulated.observations, limit_m=1.5 * alone.score_m)
    assert limited.score_m == pytest.approx(alone.score_m, rel=0.05)


def test_a_sign_is_named_where_a_fifth_of_the_rows_is_far_off():
    true, rng = measure_rows("abb_irb120", 200), np.random.default_rng(200)
    positions_m = true.rows.positions_m.copy()
    bad = rng.choice(len(positions_m), len(positions_m) // 5, replace=False)
    positions_m[bad] += 0.5 * rng.standard_normal((len(bad), 3))
    spoilt = WAYS["sign"](replace(true, rows=replace(true.rows, positions_m=positions_m)))
    assert is_named(spoilt, answer_to(spoilt))


def test_a_reading_far_above_the_limit_is_left():
    simulated = tracker_points("abb_irb120", 60)
    turned = replace(
        simulated.observations, joints_rad=simulated.observations.joints_rad * [1, 1, -1, 1, 1, 1]
    )
    assert np.isfinite(fit_quickly(simulated.model, turned).score_m)
    assert fit_quickly(simulated.model, turned, limit_m=1e-3).score_m == np.inf


@pytest.mark.parametrize("spread_rad", [3.0, 0.01])
def test_rows_share_a_posture_where_each_is_within_a_step_of_the_first(spread_rad):
    rng = np.random.default_rng(4)
    joints = np.repeat(rng.uniform(-spread_rad, spread_rad, (80, 6)), 4, axis=0)
    joints = rng.permutation(joints + rng.normal(0.0, 4e-4, joints.shape))
    cells, row, cell = np.unique(np.round(joints / 1e-3), axis=0, return_index=True, return_inverse=True)
    leader = np.full(len(cells), -1)
    tree = spatial.KDTree(cells)
    for each in np.argsort(row):
        if leader[each] < 0:
            near = np.array(tree.query_ball_point(cells[each], 1.0, p=np.inf))
            leader[near[leader[near] < 0]] = each
    expected = np.unique(leader[cell.reshape(-1)], return_inverse=True)[1].reshape(-1)
    assert (same_postures(joints) == expected).all()


def test_random_postures_stay_apart():
    joints = random_joints(load_model("ur10"), np.random.default_rng(7), 3000)
    assert same_postures(joints).max() == 2999
