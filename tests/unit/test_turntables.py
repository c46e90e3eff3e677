"""One axis that turns its flange on the spot, as a turntable does, is placed and identified."""

import numpy as np
import pytest

from cellcal.calibration.arm.kinematics import load_model
from cellcal.calibration.geometry import exp_twist
from cellcal.calibration.identification.identify import identify_arm
from cellcal.calibration.identification.last_joint import last_joint_note
from cellcal.calibration.identification.misfit import refuse_misfit
from cellcal.calibration.identification.observations import PointObservations
from cellcal.calibration.identification.selection import IdentificationOptions

URDF = """<robot name="table"><link name="base"/><link name="plate"/>
<joint name="turn" type="continuous"><parent link="base"/><child link="plate"/>
<origin xyz="0 0 0.2" rpy="0 0 0"/><axis xyz="{axis}"/></joint></robot>"""
PLACE = exp_twist(np.array([1.2, -0.4, 0.7, 0.4, -0.3, 1.0]))
SIGMA_M = 2e-5


@pytest.mark.parametrize("axis", ["0 0 1", "1 0 0"])
def test_a_point_on_a_turntable_is_fitted(tmp_path, axis):
    path = tmp_path / "table.urdf"
    path.write_text(URDF.format(axis=axis), encoding="utf-8")
    model = load_model(f"{path}?base=base&tip=plate")
    rng = np.random.default_rng(4)
    joints = rng.uniform(-3.0, 3.0, (24, 1))
    points = (PLACE @ model.base_flange(joints) @ np.array([0.4, 0.3, 0.05, 1.0]))[:, :3]
    rows = PointObservations(
        joints,
        points + SIGMA_M * rng.standard_normal(points.shape),
        np.full(24, SIGMA_M),
        np.zeros(24, dtype=np.intp),
    )
    refuse_misfit(model, rows)
    found = identify_arm(model, rows, options=IdentificationOptions(judge=False))
    assert found.fit_errors.rmse_m < 1.3 * np.sqrt(3.0) * SIGMA_M
    (note,) = last_joint_note(model, rows)
    assert "measure attitudes" in note.message
