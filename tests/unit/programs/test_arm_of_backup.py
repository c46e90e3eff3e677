"""A project's arm is compared with where its controller has the tip, as CURPOS.DG of the backup shows both."""

from pathlib import Path

import numpy as np
import pytest

from cellcal.calibration.arm.kinematics import load_model
from cellcal.drivers.fanuc.controller_files.position_report import read_position_report
from cellcal.service.engineering.programs.arm_of_backup import arm_doubts
from cellcal.service.engineering.programs.project_poses import ProjectError

ARM = "fanuc_m900ib700"
JOINTS_DEG = (-70.39, -24.78, -0.65, -0.15, -89.38, -19.65)
TOOL = np.eye(4)
TOOL[:3, 3] = (-0.0013, -1.0906, 0.7646)
REPORT = """F Number: F270477

CURRENT ROBOT POSITION::
Group #:  1

CURRENT JOINT POSITION:
{joints}
{extended}
Frame #:   1  Tool #:   {tool}
CURRENT USER FRAME POSITION:
CFG: N U T, 0, 0, 0
X:   6967.59
Y:  -1981.89
Z:   1346.29

Tool #:   {tool}
CURRENT WORLD POSITION:
CFG: N U T, 0, 0, 0
X:   {x:.2f}
Y:   {y:.2f}
Z:   {z:.2f}
W:       .08
P:      -.13
R:      -.04
"""


def save_report(
    folder: Path,
    *,
    along_flange_m: float = 0.0,
    tool: str = "1",
    flange_tip: np.ndarray = TOOL,
    extended: str = "",
) -> bytes:
    """Write CURPOS.DG of a controller whose flange is farther out than the model's."""
    joints_rad = np.radians(np.array(JOINTS_DEG))
    longer = np.eye(4)
    longer[2, 3] = along_flange_m
    base_tip = load_model(ARM).base_flange(joints_rad[None])[0] @ longer @ flange_tip
    x, y, z = base_tip[:3, 3] * 1e3
    joints = "\n".join(f"Joint   {axis}: {angle:9.2f}" for axis, angle in enumerate(JOINTS_DEG, 1))
    data = REPORT.format(joints=joints, extended=extended, tool=tool, x=x, y=y, z=z).encode()
    (folder / "curpos.dg").write_bytes(data)
    return data


def doubts_of(folder: Path, arm: str = ARM) -> tuple[str, ...]:
    return arm_doubts(load_model(arm), {"1": TOOL}, folder, "project.toml: [robot]")


def test_the_place_of_the_tip_is_read_beside_the_joints(tmp_path: Path) -> None:
    group = read_position_report(save_report(tmp_path)).groups[0]
    assert group.joints_deg == JOINTS_DEG
    assert (group.frame, group.tool, group.is_extended) == (1, 1, False)
    assert group.world_tip_mm is not None
    assert group.world_tip_mm[0] != pytest.approx(6967.59)


def test_the_arm_of_the_controller_gives_no_doubt(tmp_path: Path) -> None:
    save_report(tmp_path)
    assert doubts_of(tmp_path) == ()
    save_report(tmp_path, tool="0", flange_tip=np.eye(4))
    assert doubts_of(tmp_path) == ()


def test_an_adapter_at_the_flange_is_noted_with_its_size(tmp_path: Path) -> None:
    save_report(tmp_path, along_flange_m=0.025)
    (doubt,) = doubts_of(tmp_path)
    assert "25.0 mm" in doubt or "24.9 mm" in doubt
    assert ARM in doubt


def test_the_arm_of_another_model_is_refused(tmp_path: Path) -> None:
    save_report(tmp_path)
    with pytest.raises(ProjectError, match="of another arm than fanuc_m710ic_50") as refused:
        doubts_of(tmp_path, "fanuc_m710ic_50")
    assert "type plate" in refused.value.remedy


@pytest.mark.parametrize("reason", ["no report", "damaged", "extended axis", "unknown tool", "other axes"])
def test_what_cannot_be_compared_gives_no_doubt(tmp_path: Path, reason: str) -> None:
    if reason == "damaged":
        (tmp_path / "CURPOS.DG").write_bytes(b"CURRENT JOINT POSITION:\nJoint 1: x\n")
    elif reason != "no report":
        save_report(
            tmp_path,
            along_flange_m=0.5,
            tool="7" if reason == "unknown tool" else "1",
            extended="EXTAXS: 1:  -1444.07" if reason == "extended axis" else "",
        )
    assert doubts_of(tmp_path, "fanuc_m430ia2f" if reason == "other axes" else ARM) == ()
