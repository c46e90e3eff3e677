"""Tags of a simulation and of the real cell: robots, bases and workpieces, and what is refused."""

import math
from dataclasses import replace

import numpy as np
import pytest

from cellcal.calibration.errors import CalibrationError, DegenerateDataError
from cellcal.calibration.geometry import (
    Pose,
    exp_rotation,
    exp_twist,
    log_transform,
    quaternion_from_rotation,
)
from cellcal.calibration.points.tag_placement import TagSigmas, place_by_tags
from cellcal.calibration.points.tag_points import TagPath, match_tags
from cellcal.calibration.points.tag_robot import calibrate_simulated_robot
from tests.unit.helpers.tag_paths import (
    DEVICE_BASE,
    FIXTURE_BASE,
    OFFSETS_DEG,
    TIP,
    make_tag_path,
    robot_tags,
    to_triples,
    two_paths,
)


def pose_error(found, truth):
    error = log_transform(np.linalg.inv(found.outer_inner.to_matrix()) @ truth)
    return float(np.linalg.norm(error[:3])), float(np.linalg.norm(error[3:]))


def test_a_base_is_found_by_tags_and_before_and_after_are_reported():
    nominal = Pose.from_matrix(FIXTURE_BASE @ exp_twist(np.array([0.01, 0, 0, 0, 0, 0.02])))
    found = place_by_tags(match_tags(*two_paths(FIXTURE_BASE)), nominal=nominal)
    origin, turn = pose_error(found, FIXTURE_BASE)
    assert origin <= 1.5 * found.origin_uncertainty.expanded_uncertainty < 5e-4
    assert turn <= 1.5 * found.angle_uncertainty.expanded_uncertainty < 1e-3
    assert max(found.after_m) < 5e-4
    assert max(found.before_m) > 5e-3


@pytest.mark.parametrize("stated", [None, 1e-4])
def test_origin_and_turn_are_within_u_as_often_as_it_says(stated):
    inside = np.zeros(2)
    for seed in range(500):
        pairs = match_tags(*two_paths(FIXTURE_BASE, 6, seed=seed))
        try:
            found = place_by_tags(pairs, sigmas=TagSigmas(stated))
        except CalibrationError:  # one in a thousand looks stray
            continue
        inside += np.array(pose_error(found, FIXTURE_BASE)) <= (
            found.origin_uncertainty.expanded_uncertainty,
            found.angle_uncertainty.expanded_uncertainty,
        )
    assert (inside / 500 > 0.92).all()
    assert (inside / 500 < 0.98).all()


def test_tags_are_paired_by_their_names_whatever_their_order():
    robot, fixture = two_paths(FIXTURE_BASE)
    shuffled = fixture.select_tags([3, 1, 7, 0, 2, 5])
    found = place_by_tags(match_tags(robot, shuffled))
    assert pose_error(found, FIXTURE_BASE)[0] < 5e-4
    assert found.unpaired == ("P5", "P7")
    with pytest.raises(CalibrationError, match="not both name them"):
        match_tags(replace(robot, names=()), shuffled)
    with pytest.raises(DegenerateDataError, match="2 tags in common"):
        match_tags(robot, fixture.select_tags([1, 2]))


def test_attitudes_of_the_tags_make_the_turn_surer():
    robot, fixture = two_paths(FIXTURE_BASE, 4, seed=3)
    random = np.random.default_rng(0)
    turns = [exp_rotation(random.normal(size=3)) for _ in range(4)]
    measured_rotations = [
        FIXTURE_BASE[:3, :3] @ turn @ exp_rotation(random.normal(scale=1e-5, size=3)) for turn in turns
    ]
    with_turns = [
        replace(one, quaternions=tuple(tuple(map(float, quaternion_from_rotation(r))) for r in rotations))
        for one, rotations in ((robot, turns), (fixture, measured_rotations))
    ]
    places = place_by_tags(match_tags(robot, fixture), sigmas=TagSigmas(1e-4))
    both = place_by_tags(match_tags(*with_turns), sigmas=TagSigmas(1e-4, 1e-5))
    assert both.angle_uncertainty.expanded_uncertainty < 0.2 * places.angle_uncertainty.expanded_uncertainty
    assert pose_error(both, FIXTURE_BASE)[1] <= 1.5 * both.angle_uncertainty.expanded_uncertainty
    assert both.turned_rad == pytest.approx(1.7e-5, rel=0.6)


def scale_path(one: TagPath, factor: float) -> TagPath:
    return replace(one, positions_m=to_triples(one.to_positions() * factor))


@pytest.mark.parametrize(("factor", "units"), [(1000.0, "millimetres for metres"), (25.4, "inches")])
def test_a_mix_of_units_is_named(factor, units):
    robot, fixture = two_paths(FIXTURE_BASE)
    for one, other in ((robot, scale_path(fixture, factor)), (scale_path(robot, factor), fixture)):
        with pytest.raises(CalibrationError, match="times as wide") as refused:
            place_by_tags(match_tags(one, other))
        assert units in refused.value.remedy


def test_mirrored_collinear_and_stray_tags_are_refused():
    robot, fixture = two_paths(FIXTURE_BASE)
    mirrored = replace(robot, positions_m=to_triples(robot.to_positions() * [1, 1, -1]))
    with pytest.raises(CalibrationError, match="mirror image"):
        place_by_tags(match_tags(mirrored, fixture))
    line = make_tag_path("line.csv", np.outer(np.linspace(0, 1, 5), [1.0, 2.0, 0.5]))
    with pytest.raises(DegenerateDataError, match="one line"):
        place_by_tags(match_tags(line, line))
    moved = fixture.to_positions()
    moved[4] += [0.002, 0, 0]
    with pytest.raises(CalibrationError, match=r"tag P5 is .* mm from where the other tags have it"):
        place_by_tags(match_tags(robot, replace(fixture, positions_m=to_triples(moved))))
    with pytest.raises(CalibrationError, match="more than"):
        place_by_tags(match_tags(robot, fixture), sigmas=TagSigmas(1e-6))


PLACE = exp_twist(np.array([0.8, 0.2, 0.1, 0.02, -0.03, 0.4]))
CORNERS = np.array([[0.0, 0.0, 0.0], [0.4, 0.0, 0.0], [0.1, 0.3, 0.0]])
FACES = np.array(
    [
        [0.05, 0.05, 0.0],
        [0.4, 0.05, 0.0],
        [0.1, 0.3, 0.0],
        [0.1, 0.0, 0.02],
        [0.4, 0.0, 0.02],
        [0.0, 0.1, 0.02],
    ]
)


def move_points(points: np.ndarray) -> np.ndarray:
    return points @ PLACE[:3, :3].T + PLACE[:3, 3]


def test_three_points_place_a_workpiece_and_must_have_its_shape():
    pairs = match_tags(
        make_tag_path("model.csv", CORNERS), make_tag_path("touched.csv", move_points(CORNERS))
    )
    found = place_by_tags(pairs, "three_points", sigmas=TagSigmas(1e-4))
    assert max(pose_error(found, PLACE)) < 1e-9
    assert found.origin_uncertainty.standard == pytest.approx(1e-4 * math.sqrt(3.0), rel=1e-3)
    bent = CORNERS + np.array([[0, 0, 0], [0.002, 0, 0], [0, 0, 0]])
    with pytest.raises(CalibrationError, match=r"tag P2 is 2\.00 mm from its place"):
        place_by_tags(
            match_tags(make_tag_path("m", CORNERS), make_tag_path("t", move_points(bent))),
            "three_points",
            sigmas=TagSigmas(1e-4),
        )
    with pytest.raises(CalibrationError, match="tells how good they are"):
        place_by_tags(pairs, "three_points")
    with pytest.raises(CalibrationError, match="takes 6 tags"):
        place_by_tags(pairs, "six_points", sigmas=TagSigmas(1e-4))


def test_six_points_may_be_touched_anywhere_on_the_same_faces():
    along_x, along_y = [0.01, -0.02, 0.01, 0.02, -0.01, 0.0], [0.004, 0.01, -0.01, 0.0, 0.0, 0.03]
    slid = FACES + np.column_stack([along_x, along_y, [0.0, 0.0, 0.0, 0.005, 0.0, 0.0]])
    pairs = match_tags(make_tag_path("model.csv", FACES), make_tag_path("touched.csv", move_points(slid)))
    found = place_by_tags(pairs, "six_points", sigmas=TagSigmas(1e-4))
    assert max(pose_error(found, PLACE)) < 1e-9
    assert 1e-4 < found.origin_uncertainty.expanded_uncertainty < 2e-3
    swapped = match_tags(
        make_tag_path("m", FACES), make_tag_path("t", move_points(FACES[[0, 2, 1, 3, 4, 5]]))
    )
    with pytest.raises(CalibrationError, match="from its place"):
        place_by_tags(swapped, "six_points", sigmas=TagSigmas(1e-4))


def test_a_robots_zeros_tool_and_device_are_found_and_what_cannot_be_known_is_named():
    tags = robot_tags()
    found, calibrated = calibrate_simulated_robot(
        tags.model, match_tags(tags.robot, tags.device), start_guess=Pose((2.0, 0.0, 0.0))
    )
    hidden = {one.name for one in found.unknowable}
    assert hidden == {"J1 offset", "J6 offset"}
    for value, truth in zip(found.values, np.radians(OFFSETS_DEG), strict=True):
        if value.name not in hidden:
            assert abs(value.value - truth) <= 3.5 * value.standard_uncertainty
            assert value.standard_uncertainty < np.radians(0.02)
    assert math.dist(found.flange_tool.position_m, TIP) <= 1.5 * found.tool.expanded_uncertainty
    assert found.after.rmse_m < 3e-4
    assert found.before.rmse_m > 1e-3
    assert found.is_better
    assert found.device_moved_m is not None
    assert found.device_moved_m > 0.3
    assert calibrated.axis_count == 6
    base = found.device_base.to_matrix()
    turn_about_z = np.linalg.inv(DEVICE_BASE) @ base  # what J1's zero hides behind
    assert abs(turn_about_z[2, 2] - 1.0) < 1e-6


def test_what_a_robots_tags_cannot_be_used_for_is_refused():
    tags = robot_tags()
    with pytest.raises(CalibrationError, match="tells no joints"):
        calibrate_simulated_robot(tags.model, match_tags(replace(tags.robot, joints_rad=()), tags.device))
    with pytest.raises(CalibrationError, match="times as wide") as refused:
        calibrate_simulated_robot(tags.model, match_tags(tags.robot, scale_path(tags.device, 1000.0)))
    assert "millimetres for metres" in refused.value.remedy
    few = tags.robot.select_tags(list(range(8)))
    with pytest.raises(DegenerateDataError, match="8 tags are too few"):
        calibrate_simulated_robot(tags.model, match_tags(few, tags.device))
    attitudes = tuple((1.0, 0.0, 0.0, 0.0) for _ in range(30))
    with pytest.raises(CalibrationError, match="do not belong to its poses"):
        calibrate_simulated_robot(
            tags.model, match_tags(replace(tags.robot, quaternions=attitudes), tags.device)
        )


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"positions_m": ((0.0, 0.0, math.nan),) * 2}, "not finite"),
        ({"names": ("A", "A")}, "two tags are called 'A'"),
        ({"names": ("A",)}, "1 names for 2 tags"),
        ({"joints_rad": ((0.0,), (0.0, 1.0))}, "not the same"),
    ],
)
def test_a_path_that_is_no_path_is_refused(change, message):
    with pytest.raises(CalibrationError, match=message):
        TagPath(**({"source": "p", "positions_m": ((0.0, 0.0, 0.0), (1.0, 0.0, 0.0))} | change))
