"""Which cause of a change is named, how surely, and which pose would decide."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from cellcal.calibration.arm.kinematics import load_model
from cellcal.calibration.drift.causes import (
    OTHER,
    drift_causes,
    explain_changes,
    most_informative_order,
    most_informative_pose,
)
from cellcal.calibration.drift.reference import DriftReference
from cellcal.calibration.errors import CalibrationError
from cellcal.calibration.mastering.pose_design import candidate_joints
from cellcal.calibration.motion.motion_check import MotionLimits, WirePath
from cellcal.calibration.poses.arm_fit import ArmTask

ANCHOR, HOOK, SIGMA_M = (0.9, -0.7, -0.45), (0.06, 0.05, 0.12), 5e-5
TASKS = {kind: ArmTask("fanuc_m6ib", kind, 1e-4, HOOK, ANCHOR) for kind in ("length", "point")}
SIZES = {"warmth": 2e-4, "tool": 1e-3, "device": 1.5e-3, "joint": 0.002}


def _draw_joints(count: int = 40) -> np.ndarray:
    limits = MotionLimits(wire=WirePath(ANCHOR, HOOK, 3.0, lowest_fraction=0.08))
    return candidate_joints(load_model("fanuc_m6ib"), limits, count, seed=3, hook_in_flange_m=HOOK)


@pytest.mark.parametrize("kind", ["length", "point"])
def test_named_causes_are_the_true_ones_in_nearly_all_draws(kind: str) -> None:
    task, rng, drawn = TASKS[kind], np.random.default_rng(1), _draw_joints()
    joints = drawn[list(most_informative_order(task, drawn, SIGMA_M, 6))]
    values = load_model(task.model).tip_positions(joints, np.array(HOOK)) if kind == "point" else None
    every = drift_causes(task, joints, values)
    right = wrong = 0
    for truth in every:
        for _ in range(20):
            if truth.kind in (OTHER, "nothing"):
                continue
            size = SIZES[truth.kind] * rng.normal(size=truth.columns.shape[1])
            changes = (truth.columns @ size).reshape(6, -1)
            changes = changes + rng.normal(size=changes.shape) * SIGMA_M
            found = explain_changes(every, changes, SIGMA_M)
            if found.has_changed and found.is_decided(0.9):
                right += found.likeliest_cause.name == truth.name
                wrong += found.likeliest_cause.name != truth.name
    assert right >= (60 if kind == "length" else 120)
    assert wrong <= 0.05 * (right + wrong)


def test_noise_alone_is_no_change() -> None:
    rng, joints = np.random.default_rng(2), _draw_joints(6)
    every = drift_causes(TASKS["length"], joints)
    causes = [
        explain_changes(every, rng.normal(size=(6, 1)) * SIGMA_M, SIGMA_M).has_changed for _ in range(300)
    ]
    assert sum(causes) <= 4


@settings(max_examples=25, deadline=None)
@given(st.lists(st.floats(-0.01, 0.01), min_size=6, max_size=6))
def test_probabilities_add_up_whatever_happened(changes: list[float]) -> None:
    found = explain_changes(
        drift_causes(TASKS["length"], _draw_joints(6)), np.array(changes)[:, None], SIGMA_M
    )
    assert sum(one.probability for one in found.suspects) == pytest.approx(1.0)
    assert found.change_max_m == pytest.approx(max(map(abs, changes)))


def test_the_pose_that_tells_is_the_one_at_which_two_causes_differ() -> None:
    task, joints = TASKS["length"], _draw_joints(12)
    taken = drift_causes(task, joints[:4])
    both = drift_causes(task, joints)
    j2 = next(cause for cause in both if cause.name == "J2")
    changes = (j2.columns[:4] * 0.001).reshape(4, 1)
    best = most_informative_pose(taken, both, changes, SIGMA_M, ("J2", "tool"))
    chances = []
    for pose in range(8):
        rows = [*range(4), 4 + pose]
        found = explain_changes(drift_causes(task, joints[rows]), j2.columns[rows] * 0.001, SIGMA_M)
        chances.append(next(one.probability for one in found.suspects if one.name == "tool"))
    assert chances[best] <= sorted(chances)[2]


def test_numbers_that_are_none_are_refused() -> None:
    with pytest.raises(CalibrationError, match="finite"):
        explain_changes(drift_causes(TASKS["length"], _draw_joints(6)), np.full((6, 1), np.nan), SIGMA_M)
    with pytest.raises(CalibrationError, match="twice"):
        DriftReference("F", "m", "wire", (), 0, (0.0,), ((0.0,),), ((0.0,),), ((np.nan,),), ((1.0,),), 1e-4)


def test_a_reference_is_as_good_as_its_rounds_repeat() -> None:
    rows = ((0.0,) * 6,) * 2
    alike = DriftReference(
        "F", "m", "wire", (), 0, rows[0], rows, rows, ((1.0,), (2.0,)), ((1.0,), (2.0,)), 1e-4
    )
    apart = DriftReference(
        "F", "m", "wire", (), 0, rows[0], rows, rows, ((1.0,), (2.0,)), ((1.002,), (1.998,)), 1e-4
    )
    assert alike.sigma_m(0.0) == pytest.approx(1e-4 / np.sqrt(2))
    assert apart.sigma_m(0.0) == pytest.approx(0.001, rel=1e-6)
    assert apart.values_m()[:, 0] == pytest.approx([1.001, 1.999])
