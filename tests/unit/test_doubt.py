"""While joints are in doubt, distances grow by what no turn within the doubt exceeds, and no more than it takes."""

from dataclasses import replace
from types import SimpleNamespace
from typing import cast

import numpy as np
import pytest

from cellcal.calibration.arm.kinematics import RobotModel, load_model
from cellcal.calibration.geometry import homogeneous_matrix
from cellcal.calibration.mastering.counts import DriveTrain
from cellcal.calibration.mastering.turn_recovery import TurnRecovery
from cellcal.calibration.motion.cell_shapes import (
    BoxObstacle,
    CellShape,
    PlaneObstacle,
    SphereObstacle,
    arm_shape,
)
from cellcal.calibration.motion.collision import CollisionCheck
from cellcal.calibration.motion.motion_check import MotionLimits, WirePath, check_moves
from cellcal.calibration.motion.motion_quantities import body_points, workspace_excess
from cellcal.calibration.motion.position_uncertainty import AxisUncertainty, PositionUncertainty
from cellcal.procedures.motion.plans import MotionBounds
from cellcal.procedures.motion.turn_uncertainty import (
    HALF_TURN,
    first_uncertainty,
    posture_uncertainty,
    uncertainty_after,
)

ARMS = ("fanuc_m6ib", "ur10e", "abb_irb120")
BOX = ((-9.0, -9.0, -9.0), (9.0, 9.0, 9.0))


def collision_check(model: RobotModel) -> CollisionCheck:
    table = BoxObstacle("table", homogeneous_matrix(np.eye(3), np.array([0.8, 0.5, -0.4])), (0.4, 0.4, 0.6))
    stands = (
        PlaneObstacle("floor", (0, 0, -0.9), (0, 0, 1)),
        SphereObstacle("post", (0.2, -0.9, 0.3), 0.1),
        table,
    )
    wire = WirePath((0.9, -0.7, -0.45), (0.06, 0.05, 0.12), 3.0)
    arm = arm_shape(model, tip_in_flange_m=(0.05, 0.02, 0.2))
    return CollisionCheck.from_model(model, CellShape(arm, stands, wire))


def draw_postures(model: RobotModel, count: int, seed: int) -> np.ndarray:
    low, high = np.maximum(model.lower_rad, -3.0), np.minimum(model.upper_rad, 3.0)
    return np.random.default_rng(seed).uniform(low, high, (count, model.axis_count))


@pytest.mark.parametrize("name", ARMS)
def test_no_posture_within_the_doubt_is_nearer_than_the_margin_foresees(name: str) -> None:
    model, rng = load_model(name), np.random.default_rng(3)
    check, nominal = collision_check(model), draw_postures(model, 40, 1)
    doubt = tuple(float(v) for v in rng.uniform(0.0, 0.2, model.axis_count))
    clearances = check.compute_clearances(nominal, PositionUncertainty(doubt, doubt))
    assert clearances.uncertainty is not None
    used = np.zeros(clearances.uncertainty.shape)
    for _ in range(200):
        signs = rng.choice([-1.0, 1.0], nominal.shape) * np.where(
            rng.random(nominal.shape) < 0.7, 1.0, rng.random()
        )
        found = check.compute_clearances(nominal + signs * np.array(doubt)).found
        nearer = clearances.found - found
        outside = (clearances.found > 0) & (found > 0)  # inside each other nothing is a distance
        assert (nearer <= clearances.uncertainty + 1e-9)[outside].all()
        used = np.maximum(used, np.where(outside, nearer, 0.0))
    assert (
        np.median(used.max(axis=1) / clearances.uncertainty.max(axis=1)) > 0.4
    )  # it is a bound, not a fright


def test_the_workspace_shrinks_by_what_each_point_may_be_elsewhere() -> None:
    model, rng = load_model("fanuc_m6ib"), np.random.default_rng(4)
    nominal, tip, doubt = draw_postures(model, 60, 2), (0.0, 0.1, 0.2), (0.1, 0.05, 0.07, 0.1, 0.1, 0.2)
    shrunk = workspace_excess(model, nominal, BOX, tip, PositionUncertainty(doubt, doubt))
    whole = workspace_excess(model, nominal, BOX, tip)
    more = (shrunk.excess - whole.excess).reshape(60, -1, 3)
    assert (more[:, -1] > more[:, -2] - 1e-12).all()  # the tip swings further than the flange
    for _ in range(100):
        off = nominal + rng.uniform(-1.0, 1.0, nominal.shape) * np.array(doubt)
        apart = np.linalg.norm(body_points(model, off, tip) - body_points(model, nominal, tip), axis=2)
        assert (apart <= more.max(axis=2) + 1e-9).all()


def test_one_axis_alone_swings_a_point_by_its_chord() -> None:
    model = load_model("fanuc_m6ib")
    stretched = np.array([[0.0, 0.3, 0.2, 0.0, 0.4, 0.0]])
    doubt = AxisUncertainty.from_joints(model, stretched, (0.1, 0.0, 0.0, 0.0, 0.0, 0.0))
    flange = model.base_flange(stretched)[0, :3, 3]
    lever = float(np.hypot(flange[0], flange[1]))
    assert doubt.displacement_between([flange[:, None]], 0, model.axis_count)[0] == pytest.approx(
        2 * np.sin(0.05) * lever
    )
    assert (
        doubt.displacement_between([flange[:, None]], 1, model.axis_count)[0] == 0.0
    )  # seen from the first link nothing moves


def test_a_refusal_says_which_body_and_how_much_of_it_is_doubt() -> None:
    model = load_model("fanuc_m6ib")
    limits = MotionLimits(clearances=collision_check(model), box_low_m=BOX[0], box_high_m=BOX[1])
    here, there = np.zeros(6), np.array([[0.0, 0.9, -0.4, 0.0, 0.0, 0.0]])
    sure = check_moves(model, here, there, limits, speed_rad_s=1e-3)
    assert not [finding for finding in sure.findings if "floor" in finding.sentence]
    doubt = PositionUncertainty((0.2,) * 6, (0.0,) * 6)
    found = check_moves(
        model, here, there, replace(limits, position_uncertainty=doubt), speed_rad_s=1e-3
    ).findings
    clearance_sentences = [finding.sentence for finding in found if finding.check == "clearance"]
    assert clearance_sentences
    assert all("for turns that are not known yet" in sentence for sentence in clearance_sentences)
    assert all(" and " in sentence for sentence in clearance_sentences)


def test_motors_seen_healthy_are_in_doubt_by_half_a_turn_and_the_others_by_all_that_may_be_lost() -> None:
    assert first_uncertainty(MotionBounds(), 2, is_measured=True) == (HALF_TURN, HALF_TURN)
    assert first_uncertainty(MotionBounds(lost_turns=3), 2, is_measured=False) == (3.0, 3.0)
    assert first_uncertainty(MotionBounds(lost_turns=0), 2, is_measured=True) == (0.0, 0.0)
    drive = DriveTrain(((1e-4, 0.0), (2e-5, -5e-5)), (1000, 2000))
    doubt = posture_uncertainty(drive, (2.0, 2.0))
    assert doubt.bodies_rad == pytest.approx((0.2, 0.04 + 0.2))
    assert doubt.wire_rad == pytest.approx((0.05, 0.01 + 0.05))


@pytest.mark.parametrize(
    ("degrees_of_freedom", "chi_square", "mode", "is_less"),
    [(6, 4.0, "turns", True), (6, 60.0, "turns", False), (6, 4.0, "geometry", False), (0, 0.0, "turns", False),
     (-1, 0.0, "turns", False)],
)  # fmt: skip
def test_captures_take_doubt_away_only_where_they_could_have_contradicted(
    degrees_of_freedom: int, chi_square: float, mode: str, is_less: bool
) -> None:
    found = SimpleNamespace(
        mode=mode,
        degrees_of_freedom=degrees_of_freedom,
        chi_square=chi_square,
        offset_turns=(0.0, 0.1),
        sigma_turns=(0.01, 0.01),
    )
    left = uncertainty_after(cast(TurnRecovery, found), (0, 0), (2.0, 2.0))
    assert left == (pytest.approx((0.04, 0.14)) if is_less else (2.0, 2.0))
