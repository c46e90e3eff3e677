"""Points asked for: joints, or poses of the flange in any convention, solved near measured postures."""

import numpy as np
import pytest

from cellcal.calibration.arm.kinematics import load_model
from cellcal.calibration.compensation.pose_gap import TipArm
from cellcal.calibration.compensation.posture_of_pose import postures_of_poses
from cellcal.calibration.orientation import CONVENTIONS, values_from
from cellcal.service.engineering.identification.at_points import AtOptions, read_points, solve_joints
from cellcal.service.engineering.measured.table import MeasurementError
from tests.unit.helpers.simulated_arm import dh_errors, random_joints

MODEL = load_model("fanuc_m6ib")


def write_points(path, convention, poses):
    fields = CONVENTIONS[convention or "abb_quaternion"].fields
    names = ["qw", "qx", "qy", "qz"] if not convention else [f"{field}_deg" for field in fields]
    turns = values_from(convention or "abb_quaternion", poses[:, :3, :3])
    turns = turns if not convention else np.rad2deg(turns)
    lines = [",".join(["x_mm", "y_mm", "z_mm", *names])]
    lines += [
        ",".join(f"{v:.12g}" for v in (*(1e3 * p[:3, 3]), *t)) for p, t in zip(poses, turns, strict=True)
    ]
    path.write_text("\n".join(lines), encoding="utf-8")
    return path


@pytest.mark.parametrize("convention", ["", "fanuc_wpr", "kuka_abc"])
def test_poses_are_brought_to_the_branch_that_was_measured(convention, tmp_path):
    rng = np.random.default_rng(0)
    measured_joints = random_joints(MODEL, rng, 60, reach=1.2)
    target_joints = measured_joints[:8] + rng.uniform(-0.1, 0.1, (8, 6))
    path = write_points(tmp_path / "poses.csv", convention, MODEL.base_flange(target_joints))
    points = read_points(AtOptions(path, convention), 6)
    joints = solve_joints(points, TipArm(MODEL), measured_joints)
    assert np.abs(joints - target_joints).max() < 1e-7


def test_an_identified_arm_stands_where_the_pose_says():
    rng = np.random.default_rng(1)
    real = MODEL.with_dh_errors(dh_errors(MODEL, rng))
    measured_joints = random_joints(MODEL, rng, 40, reach=1.2)
    poses = MODEL.base_flange(measured_joints[:10])
    found = postures_of_poses(TipArm(real), poses, measured_joints)
    assert found.reached.all()
    assert np.abs(real.base_flange(found.joints_rad) - poses).max() < 1e-7
    assert np.abs(found.joints_rad - measured_joints[:10]).max() > 1e-4


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("x_mm,y_mm,z_mm,qw,qx,qy,qz\n99000,0,0,1,0,0,0\n", "cannot be reached"),
        ("x_mm,y_mm,z_mm,qw,qx,qy,qz\n900,0,0,1,1,0,0\n", "unit length"),
        ("x_mm,y_mm,z_mm,qw,qx,qy,qz\n900,nan,0,1,0,0,0\n", "'nan' cannot be read as a number"),
        ("x_mm,y_mm,z_mm,qw,qx,qy,qz\n900,,0,1,0,0,0\n", "column y_mm: '' cannot be read as a number"),
        ("a,b\n1,2\n", "neither joints nor poses"),
        ("q1_deg\n", "no rows"),
    ],
)
def test_points_that_make_no_sense_are_refused(text, message, tmp_path):
    path = tmp_path / "points.csv"
    path.write_text(text, encoding="utf-8")
    with pytest.raises(MeasurementError, match=message):
        solve_joints(read_points(AtOptions(path), 6), TipArm(MODEL), np.zeros((1, 6)))


def test_an_unknown_convention_is_named(tmp_path):
    path = write_points(tmp_path / "poses.csv", "", MODEL.base_flange(np.zeros((1, 6))))
    with pytest.raises(MeasurementError, match="no orientation is called 'euler'"):
        read_points(AtOptions(path, "euler"), 6)
