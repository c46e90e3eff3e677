"""Which poses to measure: within limits, better than chance, and the right ones next."""

import numpy as np
import pytest

from cellcal.calibration.errors import DegenerateDataError
from cellcal.calibration.mastering.pose_design import candidate_joints, kit_poses, next_poses, predict_turns
from cellcal.calibration.motion.motion_check import MotionLimits, WirePath, allowed_postures
from tests.unit.helpers.recovery_cases import DRIVE, LIMITS, MODEL, PRIOR, healthy_record, record_poses
from tests.unit.helpers.wire_world import ANCHOR, HOOK, WireWorld

NONE = np.empty((0, 6))


@pytest.fixture(scope="module")
def record_captures():
    return healthy_record(WireWorld(2))


def test_the_kit_keeps_every_limit_and_repeats_nothing():
    assert record_poses().shape == (30, 6)
    assert allowed_postures(MODEL, record_poses(), LIMITS, PRIOR.hook_in_flange_m).all()
    tips = MODEL.tip_positions(record_poses(), HOOK)
    lengths = np.linalg.norm(tips - ANCHOR, axis=1)
    assert lengths.min() >= 0.06 * 3.0
    assert lengths.max() <= 0.97 * 3.0
    gaps = np.linalg.norm(record_poses()[:, None] - record_poses()[None], axis=2) + 10 * np.eye(30)
    assert gaps.min() > 0.05


def test_the_kit_is_reproducible_by_seed():
    again = kit_poses(MODEL, DRIVE, PRIOR, LIMITS, 12, seed=4)
    assert (again == kit_poses(MODEL, DRIVE, PRIOR, LIMITS, 12, seed=4)).all()
    assert (again != kit_poses(MODEL, DRIVE, PRIOR, LIMITS, 12, seed=5)).any()


def test_designed_poses_tell_more_than_random_ones(record_captures):
    candidates = candidate_joints(MODEL, LIMITS, 200, seed=3)
    designed = candidates[list(next_poses(MODEL, record_captures, NONE, candidates, 10))]
    rng = np.random.default_rng(0)
    volumes = [
        np.log(predict_turns(MODEL, record_captures, candidates[rng.choice(200, 10, False)])[1]).sum()
        for _ in range(20)
    ]
    assert np.log(predict_turns(MODEL, record_captures, designed)[1]).sum() < min(volumes)


def test_more_poses_never_tell_less(record_captures):
    order = list(next_poses(MODEL, record_captures, NONE, record_poses(), 14))
    sigmas = [predict_turns(MODEL, record_captures, record_poses()[order[:n]])[1] for n in range(1, 15)]
    assert (np.diff(sigmas, axis=0) <= 1e-9).all()
    assert predict_turns(MODEL, record_captures, record_poses()[order[:2]])[0] < 0.5
    assert predict_turns(MODEL, record_captures, record_poses()[order])[0] > 0.9999


def test_the_next_pose_is_the_one_that_an_exhaustive_search_picks(record_captures):
    measured, candidates = record_poses()[:4], record_poses()[4:]

    def information_volume(index):
        joints = np.vstack([measured, candidates[index]])
        return _log_volume(record_captures, joints)

    best = min(range(len(candidates)), key=information_volume)
    assert next_poses(MODEL, record_captures, measured, candidates, 1) == (best,)


def _log_volume(record, joints):
    from cellcal.calibration.mastering.pose_design import turn_covariances
    from cellcal.calibration.wires.reference import WirePredictor

    predictor = WirePredictor(MODEL, record.wire, record.prior)
    return np.linalg.slogdet(turn_covariances(record, predictor, joints)(len(joints)))[1]


def test_a_measured_pose_is_not_the_next_one(record_captures):
    measured = record_poses()[:6]
    assert not set(next_poses(MODEL, record_captures, measured, record_poses(), 8)) & set(range(6))


def test_asking_for_more_than_there_is_returns_all(record_captures):
    assert sorted(next_poses(MODEL, record_captures, NONE, record_poses()[:5], 9)) == [0, 1, 2, 3, 4]


def test_a_cell_without_free_space_is_refused():
    shut = MotionLimits(wire=WirePath(tuple(ANCHOR), tuple(HOOK), 0.05))
    with pytest.raises(DegenerateDataError):
        kit_poses(MODEL, DRIVE, PRIOR, shut, 20)
