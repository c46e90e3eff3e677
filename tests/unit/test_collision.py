"""Collision checks: distances against an independent library, postures and ways, and what is not seen."""

import coal
import numpy as np
import pytest

from cellcal.calibration.arm.kinematics import load_model
from cellcal.calibration.errors import CalibrationError
from cellcal.calibration.geometry import exp_rotation, homogeneous_matrix
from cellcal.calibration.motion.capsule_distance import box_distance, plane_distance, segment_distance
from cellcal.calibration.motion.cell_shapes import (
    BoxObstacle,
    CellShape,
    LinkCapsule,
    PlaneObstacle,
    SphereObstacle,
    arm_shape,
    assumed_shape,
)
from cellcal.calibration.motion.collision import CollisionCheck
from cellcal.calibration.motion.motion_check import WirePath

MODEL = load_model("fanuc_m6ib")
STRETCHED = np.array([[0.0, 0.3, 0.2, 0.0, 0.4, 0.0]])


def reference_distance(shape, at, other, other_at):
    result = coal.DistanceResult()
    return coal.distance(shape, at, other, other_at, coal.DistanceRequest(), result)


def placed_capsule(start, end, radius):
    along = end - start
    length = np.linalg.norm(along)
    z = along / length
    x = np.cross(z, np.eye(3)[np.argmin(np.abs(z))])
    x /= np.linalg.norm(x)
    turn = np.column_stack([x, np.cross(z, x), z])
    return coal.Capsule(radius, length), coal.Transform3s(turn, (start + end) / 2)


def as_columns(points):
    return np.asarray(points).T


def test_segments_are_as_far_apart_as_an_independent_library_says():
    rng = np.random.default_rng(1)
    ends = rng.uniform(-1, 1, (300, 4, 3))
    ends[:20, 3] = ends[:20, 2] + (ends[:20, 1] - ends[:20, 0])  # parallel
    ends[20:40, 3] = ends[20:40, 2] + 1e-7 * rng.normal(size=(20, 3))  # nearly a point
    ours = segment_distance(
        (as_columns(ends[:, 0]), as_columns(ends[:, 1])), (as_columns(ends[:, 2]), as_columns(ends[:, 3]))
    )
    theirs = []
    for a, b, c, d in ends:
        first, second = placed_capsule(a, b, 0.01), placed_capsule(c, d, 0.01)
        theirs.append(reference_distance(*first, *second) + 0.02)
    apart = ours > 0.03
    assert apart.sum() > 250
    assert np.allclose(ours[apart], np.array(theirs)[apart], atol=2e-6)


def test_boxes_are_as_far_away_as_an_independent_library_says():
    rng = np.random.default_rng(2)
    for _ in range(150):
        turn, centre, size = exp_rotation(rng.normal(size=3)), rng.uniform(-1, 1, 3), rng.uniform(0.1, 1, 3)
        a, b = rng.uniform(-2, 2, (2, 3))
        ours = box_distance((as_columns([a]), as_columns([b])), homogeneous_matrix(turn, centre), size)[0]
        theirs = (
            reference_distance(*placed_capsule(a, b, 1e-3), coal.Box(*size), coal.Transform3s(turn, centre))
            + 1e-3
        )
        assert ours == pytest.approx(max(theirs, 0.0), abs=2e-6) or (ours < 2e-3 and theirs <= 2e-3)


def test_a_segment_that_enters_a_box_is_at_no_distance():
    through = (as_columns([[-2.0, 0.1, 0.1]]), as_columns([[2.0, -0.1, 0.2]]))
    assert box_distance(through, np.eye(4), np.ones(3))[0] == pytest.approx(0.0, abs=1e-9)


def test_points_and_parallels_have_distances():
    point = (np.zeros((3, 1)), np.zeros((3, 1)))
    assert segment_distance(point, point)[0] == 0.0
    line = (as_columns([[1.0, -1.0, 0.0]]), as_columns([[1.0, 1.0, 0.0]]))
    assert segment_distance(point, line)[0] == pytest.approx(1.0)
    beside = (as_columns([[1.5, 3.0, 0.0]]), as_columns([[1.5, 2.0, 0.0]]))
    assert segment_distance(line, beside)[0] == pytest.approx(np.hypot(0.5, 1.0))


def test_height_above_a_plane_is_that_of_the_lower_end():
    line = (as_columns([[0.0, 0.0, 0.4]]), as_columns([[0.0, 0.0, 0.1]]))
    assert plane_distance(line, np.array([0.0, 0.0, -0.2]), np.array([0.0, 0.0, 2.0]))[0] == pytest.approx(
        0.3
    )


def test_the_skeleton_is_where_the_kinematics_put_it():
    check = CollisionCheck.from_model(MODEL, CellShape(arm_shape(MODEL, radius_m=0.05)))
    flange = MODEL.base_flange(STRETCHED)[0, :3, 3]
    ball = CollisionCheck(
        MODEL, CellShape(check.shape.arm, (SphereObstacle("ball", tuple(flange), 0.03),)), check.touching
    )
    nearest = ball.narrowest_contacts(STRETCHED)[0]
    assert nearest.second == "ball"
    assert nearest.first == "link 6"
    assert nearest.clearance_m == pytest.approx(-0.08)


def test_an_obstacle_forbids_only_the_postures_that_come_near():
    tip = MODEL.base_flange(STRETCHED)[0, :3, 3]
    margin = 0.02

    def free_with_ball_at(gap):
        away = tip + np.array([gap + 0.05 + 0.03, 0.0, 0.0])
        arm = (LinkCapsule("hand", 6, (0.0, 0.0, 0.0), (0.0, 0.0, 0.0), 0.05),)
        shape = CellShape(arm, (SphereObstacle("ball", tuple(away), 0.03),), margin_m=margin)
        return bool(CollisionCheck(MODEL, shape).is_free(STRETCHED)[0])

    assert free_with_ball_at(margin + 1e-6)
    assert not free_with_ball_at(margin - 1e-6)


def test_an_arm_that_folds_into_itself_is_not_free():
    check = CollisionCheck.from_model(MODEL, assumed_shape(MODEL))
    folded = np.array([[0.0, 2.74, 1.88, 0.0, 0.0, 0.0], STRETCHED[0]])
    free = check.is_free(folded)
    assert not free[0]
    assert free[1]
    assert {check.narrowest_contacts(folded)[0].first, check.narrowest_contacts(folded)[0].second} <= {
        f"link {i}" for i in range(1, 7)
    }


def test_a_way_may_be_blocked_between_two_free_ends():
    ends = np.array([STRETCHED[0], STRETCHED[0]])
    ends[0, 0], ends[1, 0] = -1.0, 1.0
    middle = MODEL.base_flange(STRETCHED)[0, :3, 3]
    post = BoxObstacle("post", homogeneous_matrix(np.eye(3), middle), (0.05, 0.05, 2.0))
    check = CollisionCheck.from_model(MODEL, assumed_shape(MODEL, (post,)))
    assert check.is_free(ends).all()
    assert not check.is_path_free(ends)[0]
    without = CollisionCheck.from_model(MODEL, assumed_shape(MODEL))
    assert without.is_path_free(ends)[0]


def test_a_thin_wall_is_not_jumped_over():
    ends = np.array([STRETCHED[0], STRETCHED[0]])
    ends[0, 0], ends[1, 0] = -1.0, 1.0
    tip = MODEL.base_flange(STRETCHED)[0, :3, 3]
    sheet = BoxObstacle(
        "sheet", homogeneous_matrix(np.eye(3), tip + np.array([0.3, 0.0, 0.0])), (0.7, 1e-4, 0.5)
    )
    arm = (LinkCapsule("needle", 6, (0.0, 0.0, 0.0), (0.0, 0.0, 0.05), 1e-3),)
    check = CollisionCheck(MODEL, CellShape(arm, (sheet,), margin_m=0.005))
    assert check.is_free(ends).all()
    assert not check.is_path_free(ends)[0]


def test_the_floor_is_solid_below():
    tablets = PlaneObstacle("floor", (0.0, 0.0, -0.3), (0.0, 0.0, 1.0))
    check = CollisionCheck.from_model(MODEL, assumed_shape(MODEL, (tablets,)))
    up, down = np.zeros(6), np.array([0.0, 1.6, -0.9, 0.0, 0.0, 0.0])
    assert MODEL.base_flange(down[None])[0, 2, 3] < -0.3
    assert check.is_free(np.array([up, down])).tolist() == [True, False]


def test_the_wire_must_not_touch_the_arm():
    hook = (0.0, 0.0, 0.1)
    tip = MODEL.tip_positions(STRETCHED, np.array(hook))[0]
    elbow = np.array([0.15 + 0.6 * np.sin(0.3), 0.0, 0.6 * np.cos(0.3)])
    behind = tip + 1.5 * (elbow - tip)
    beside = tip + np.array([0.5, 0.0, -0.2])
    for anchor, free in ((behind, False), (beside, True)):
        wire = WirePath(tuple(float(v) for v in anchor), hook, range_m=3.0)
        check = CollisionCheck.from_model(MODEL, assumed_shape(MODEL, wire=wire))
        assert check.is_free(STRETCHED)[0] == free


def test_numbers_that_are_not_finite_are_not_free_and_do_not_spoil_the_others():
    check = CollisionCheck.from_model(MODEL, assumed_shape(MODEL))
    joints = np.array([STRETCHED[0], STRETCHED[0], STRETCHED[0]])
    joints[1, 2] = np.nan
    joints[2, 4] = np.inf
    assert check.is_free(joints).tolist() == [True, False, False]
    assert check.is_path_free(joints).tolist() == [False, False]
    with pytest.raises(CalibrationError, match="finite"):
        check.narrowest_contacts(joints)


def test_it_says_what_it_does_not_see():
    words = " ".join(CollisionCheck.from_model(MODEL, assumed_shape(MODEL)).not_checked)
    assert "no obstacles known" in words
    assert "the draw-wire is not part of this plan" in words
    assert "skeleton" in words
    with_wire = assumed_shape(
        MODEL, (SphereObstacle("s", (9.0, 0.0, 0.0), 0.1),), wire=WirePath((1.0, 0, 0), (0, 0, 0), 3.0)
    )
    words = " ".join(CollisionCheck.from_model(MODEL, with_wire).not_checked)
    assert "no obstacles" not in words
    assert "no draw-wire" not in words


@pytest.mark.parametrize("name", ["ur10e", "abb_irb120", "kuka_kr6_r900", "fanuc_r2000ic_165f"])
def test_links_that_touch_by_construction_do_not_forbid_everything(name):
    model = load_model(name)
    check = CollisionCheck.from_model(model, assumed_shape(model))
    rng = np.random.default_rng(3)
    low, high = np.maximum(model.lower_rad, -np.pi), np.minimum(model.upper_rad, np.pi)
    share = check.is_free(rng.uniform(low, high, (500, 6))).mean()
    assert 0.2 < share < 1.0
    assert check.is_free(np.zeros((1, 6)) + 0.3)[0]


@pytest.mark.parametrize(
    "wrong",
    [
        lambda: CellShape((LinkCapsule("x", 1, (0.0, 0.0, float("nan")), (0.0, 0.0, 0.0), 0.1),)),
        lambda: CellShape((), (SphereObstacle("x", (0.0, 0.0, 0.0), -0.1),)),
        lambda: CellShape((), (PlaneObstacle("x", (0.0, 0.0, 0.0), (0.0, 0.0, 0.0)),)),
        lambda: CellShape((), (BoxObstacle("x", 2 * np.eye(4), (1.0, 1.0, 1.0)),)),
        lambda: CollisionCheck.from_model(
            MODEL, CellShape((LinkCapsule("x", 7, (0, 0, 0), (0, 0, 0), 0.1),))
        ),
    ],
)
def test_shapes_that_cannot_be_are_refused(wrong):
    with pytest.raises(CalibrationError):
        wrong()
