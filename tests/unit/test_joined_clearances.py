"""Distances of many pairs at once are those of each pair, and doubts those of the plain recursion."""

from itertools import pairwise

import numpy as np
import pytest

from cellcal.calibration.arm.kinematics import load_model
from cellcal.calibration.motion.capsule_distance import MANY_POSTURES, pair_distances, segment_distance
from cellcal.calibration.motion.position_uncertainty import AxisUncertainty
from cellcal.calibration.motion.wire_uncertainty import wire_approaches

_DOUBTS_RAD = (0.1, 0.2, 0.05, 0.3, 0.1, 0.2)


def segments(count, postures, seed=1):
    rng = np.random.default_rng(seed)
    return [(rng.normal(size=(3, postures)), rng.normal(size=(3, postures))) for _ in range(count)]


def displaced(uncertainty, points, joints):
    """Return the recursion of `position_uncertainty`, joint by joint and point by point."""
    found = np.zeros(uncertainty.axes.shape[2])
    for joint in joints:
        levers = [
            np.linalg.norm(
                np.cross(point - uncertainty.origins[joint], uncertainty.axes[joint], axis=0), axis=0
            )
            for point in points
        ]
        found = found + uncertainty.chords[joint] * (np.max(levers, axis=0) + found)
    return found


@pytest.fixture
def uncertainty():
    joints = np.random.default_rng(2).uniform(-2.0, 2.0, (7, 6))
    return AxisUncertainty.from_joints(load_model("ur10"), joints, _DOUBTS_RAD)


@pytest.mark.parametrize("postures", [1, 9, MANY_POSTURES + 1])
def test_pairs_together_are_as_far_apart_as_each(postures) -> None:
    firsts, seconds = segments(5, postures), segments(5, postures, seed=2)
    fixed = np.array([[0.3], [0.2], [0.1]])
    firsts[2] = (fixed, firsts[2][1])
    found = pair_distances(list(zip(firsts, seconds, strict=True)), postures)
    for first, second, apart in zip(firsts, seconds, found, strict=True):
        assert np.array_equal(apart, segment_distance(first, second))


def test_displacements_are_those_of_the_recursion(uncertainty) -> None:
    points = segments(1, 7)[0]
    for outer in (1, 4, 6):
        found = uncertainty.displacements_from_links(points, outer)
        assert not found[outer].any()
        for inner in range(outer):
            expected = displaced(uncertainty, points, range(outer - 1, inner - 1, -1))
            np.testing.assert_allclose(found[inner], expected, rtol=1e-13)
    base = uncertainty.base_displacements(points[0])
    for link in range(7):
        np.testing.assert_allclose(base[link], displaced(uncertainty, points[:1], range(link)), rtol=1e-13)


def test_a_wire_approaches_by_its_worst_piece(uncertainty) -> None:
    anchor, (hook, _) = np.array([[0.9], [-0.7], [0.1]]), segments(1, 7)[0]
    bars = [(bar, link) for link, bar in enumerate(segments(3, 7, seed=5))]
    found = wire_approaches(uncertainty, (anchor, hook), bars)
    for (bar, link), approach in zip(bars, found, strict=True):
        hook_off = displaced(uncertainty, [hook], range(5, link - 1, -1))
        anchor_off = displaced(uncertainty, [anchor], range(link))
        nearest = np.full(7, np.inf)
        for start, stop in pairwise(np.linspace(0.0, 1.0, 9)):
            piece = (anchor + start * (hook - anchor), anchor + stop * (hook - anchor))
            off = np.maximum(*((1.0 - at) * anchor_off + at * hook_off for at in (start, stop)))
            nearest = np.minimum(nearest, segment_distance(piece, bar) - off)
        np.testing.assert_allclose(approach, segment_distance((anchor, hook), bar) - nearest, atol=1e-12)


def test_a_model_is_read_once_and_cannot_be_changed() -> None:
    model = load_model("ur10")
    assert load_model("ur10") is model
    assert load_model("ur10@ceiling") is not model
    for array in (model.placements, model.theta0_rad, model.joint_coupling, model.lower_rad, model.dh.d_m):
        with pytest.raises(ValueError, match="read-only"):
            array.flat[0] = 1.0
    changed = model.with_dh_errors(np.full((6, 5), 1e-3))
    assert changed is not model
    assert not np.array_equal(changed.placements, model.placements)
    with pytest.raises(ValueError, match="read-only"):
        changed.placements.flat[0] = 1.0
