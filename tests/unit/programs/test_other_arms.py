"""Programs of a SCARA, of arms of five joints and of seven: judged by formulas of their own and by Pinocchio."""

import json
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest

from cellcal.calibration.arm.kinematics import load_model
from cellcal.calibration.arm.urdf import bare_urdf
from cellcal.calibration.compensation.compensate import ProgramDirection
from cellcal.calibration.identification.free_parameters import StartingPoint, starting_state
from cellcal.calibration.identification.layouts import make_layout
from cellcal.calibration.identification.parameters import GEOMETRY
from cellcal.calibration.orientation import rotation_from, values_from
from cellcal.calibration.programs.scara import elbow_side, scara_axes, scara_postures
from cellcal.drivers.fanuc.program_files.ls_program import read_ls
from cellcal.drivers.fanuc.program_files.programs import BRAND
from cellcal.service.cli.app import run_command_line
from cellcal.service.engineering.programs.clone import CloneRoute
from cellcal.service.engineering.programs.compensate import compensation_transfer
from cellcal.service.engineering.programs.other_arm_checks import rods_left_out
from cellcal.service.engineering.programs.program_transfer import ProgramTransfer
from cellcal.service.engineering.programs.project import read_project
from cellcal.service.engineering.programs.project_arms import IdentifiedArm
from cellcal.service.engineering.programs.project_poses import ProjectError

DESCRIPTIONS = Path(__file__).parents[2] / "data" / "descriptions"
TOOL_MM = (40.0, 0.0, 120.0)
PROJECT = """format = 1
name = "c"
[robot]
serial = "1"
model = "{model}"
{robot}
[tools.1.entered]
position_mm = [40, 0, 120]
[frames.2]
position_mm = [100, -50, 20]
fanuc_wpr_deg = [0, 0, 30]
"""
HEAD = '/PROG  A\n/ATTR\nCOMMENT = "";\n/MN\n{moves}/POS\n{points}/END\n'
JOINT_POINT = """P[{n}]{{
   GP1:
    UF : 2, UT : 1,
    {joints}
}};
"""
POSE_POINT = """P[{n}]{{
   GP1:
    UF : 2, UT : 1,		CONFIG : '{config}',
    X = {0:9.3f}  mm,	Y = {1:9.3f}  mm,	Z = {2:9.3f}  mm,
    W = {3:9.3f} deg,	P = {4:9.3f} deg,	R = {5:9.3f} deg
}};
"""
FRAME = np.radians(30.0), np.array([100.0, -50.0, 20.0])


def turn_z(angle_rad: float):
    c, s = np.cos(angle_rad), np.sin(angle_rad)
    return np.array([[c, -s, 0], [s, c, 0], [0, 0, 1.0]])


def scara_tip_mm(j1_deg: float, j2_deg: float, j3_mm: float, j4_deg: float):
    """Return place and yaw of the tip of the described SCARA in its base, by plane trigonometry.

    Links of 350 and 300 mm; the tool points down, so its x goes along the yaw and its z down.
    """
    first, both = np.radians(j1_deg), np.radians(j1_deg + j2_deg)
    yaw = both - np.radians(j4_deg)
    x = 350 * np.cos(first) + 300 * np.cos(both) + TOOL_MM[0] * np.cos(yaw)
    y = 350 * np.sin(first) + 300 * np.sin(both) + TOOL_MM[0] * np.sin(yaw)
    z = 300 + 20 - 50 - 100 - j3_mm - TOOL_MM[2]
    return np.array([x, y, z]), yaw


def in_frame(place_mm, yaw_rad: float):
    angle, origin = FRAME
    return turn_z(-angle) @ (place_mm - origin), yaw_rad - angle


def joint_text(*values: tuple[float, str]) -> str:
    return ",    ".join(f"J{i + 1}={value:10.4f} {unit}" for i, (value, unit) in enumerate(values))


def scara_joints(j1: float, j2: float, j3: float, j4: float) -> str:
    return joint_text((j1, "deg"), (j2, "deg"), (j3, " mm"), (j4, "deg"))


def scara_pose(n: int, joints, config: str = "L, 0, 0, 0", tilt_deg: float = 0.0) -> str:
    place, yaw = in_frame(*scara_tip_mm(*joints))
    return POSE_POINT.format(*place, 180.0 - tilt_deg, 0.0, np.degrees(yaw), n=n, config=config)


def listing(points: list[str], linear: str = "J") -> str:
    moves = "".join(f"   {i + 1}:{linear} P[{i + 1}] 20% FINE    ;\n" for i in range(len(points)))
    return HEAD.format(moves=moves, points="".join(points))


def run(tmp_path: Path, model: str, program: str, *words: str, robot: str = "", command: str = "move"):
    """Run a program command; return the exit code and the text of the new program, "" where there is none."""
    (tmp_path / "A.LS").write_text(program)
    project = tmp_path / "project.toml"
    project.write_text(PROJECT.format(model=model, robot=robot))
    out = tmp_path / f"out_{len(list(tmp_path.iterdir()))}"
    code = run_command_line(
        ["program", command, "--project", str(project), str(tmp_path / "A.LS"), *words, "--out", str(out)]
    )
    made = list(out.glob("*.LS"))
    return code, made[0].read_text() if made else ""


def poses_of(text: str):
    """Return the number and X Y Z W P R of each Cartesian position."""
    number = r"\s*(-?[\d.]+)\s+(?:mm|deg)"
    pattern = r"P\[(\d+)\]\{[^}]*?" + r"[^}]*?".join(rf"{letter} ={number}" for letter in "XYZWPR")
    return {int(found[1]): [float(v) for v in found.groups()[1:]] for found in re.finditer(pattern, text)}


def joints_of(text: str):
    return {
        int(n): [float(v) for v in re.findall(r"J\d=\s*(-?[\d.]+)\s+(?:mm|deg)", body)]
        for n, body in re.findall(r"P\[(\d+)\]\{([^}]*J1=[^}]*)\}", text)
    }


SCARA = f"{DESCRIPTIONS}/scara.urdf?tip=flange"
POSTURES = [(10.0, 40.0, 30.0, 15.0), (-35.0, 60.0, 80.0, -120.0), (20.0, 95.0, 25.0, 170.0)]
OFFSET = "12.5,-30,8,0,0,25"


def moved_by_hand(place_mm, yaw_rad: float):
    """Return place and yaw in the base when the work in frame 2 was shifted and turned by OFFSET within it."""
    angle, origin = FRAME
    place, yaw = in_frame(place_mm, yaw_rad)
    there = turn_z(np.radians(25.0)) @ place + np.array([12.5, -30.0, 8.0])
    return turn_z(angle) @ there + origin, yaw + np.radians(25.0) + angle


def test_a_scara_moves_poses_and_joints_with_its_work(tmp_path):
    points = [JOINT_POINT.format(n=1, joints=scara_joints(*POSTURES[0]))]
    points += [scara_pose(i + 2, joints) for i, joints in enumerate(POSTURES)]
    code, text = run(tmp_path, SCARA, listing(points), "--frame", "2", "--offset", OFFSET)
    assert code == 0
    place, yaw = moved_by_hand(*scara_tip_mm(*POSTURES[0]))
    (written,) = joints_of(text).values()
    found, turned = scara_tip_mm(*written)
    assert np.abs(found - place).max() < 1.1e-3 + 2 * np.radians(5e-5) * 700  # joints have four decimals
    assert abs(np.degrees(turned - yaw)) < 1.6e-4
    poses = poses_of(text)
    assert len(poses) == 3
    for i, joints in enumerate(POSTURES):
        place, yaw = in_frame(*moved_by_hand(*scara_tip_mm(*joints)))
        x, y, z, w, p, r = poses[i + 2]
        assert (
            np.abs(np.array([x, y, z]) - place).max() <= 1.0e-3 + 1e-9
        )  # what was written has three decimals
        assert abs((r - np.degrees(yaw) + 180) % 360 - 180) <= 1.0e-3
        assert abs(abs(w) - 180) < 1e-4
        assert abs(p) < 1e-4


def test_a_point_that_a_scara_would_have_to_lean_for_is_left_with_the_angle(tmp_path, capsys):
    points = [JOINT_POINT.format(n=1, joints=scara_joints(*POSTURES[0])), scara_pose(2, POSTURES[1])]
    code, text = run(tmp_path, SCARA, listing(points), "--frame", "2", "--offset", "0,0,1,1.5,0,0")
    assert code == 4
    assert text == listing(points)
    output = " ".join(capsys.readouterr().out.split())
    assert "turn it by 1.50 deg more than" in output
    code, text = run(
        tmp_path,
        SCARA,
        listing(points),
        "--frame",
        "2",
        "--offset",
        "0,0,1,1.5,0,0",
        robot="largest_tilt_deg = 2",
    )
    assert code == 0
    place, _ = in_frame(*scara_tip_mm(*POSTURES[1]))
    lean = np.radians(1.5)
    turn = np.array([[1, 0, 0], [0, np.cos(lean), -np.sin(lean)], [0, np.sin(lean), np.cos(lean)]])
    x, y, z, w, p, _ = poses_of(text)[2]
    assert np.abs(np.array([x, y, z]) - turn @ place - [0, 0, 1]).max() <= 1.1e-3
    assert abs(abs(w) - 180) < 1e-4
    assert abs(p) < 1e-4
    assert "1.500 deg of the orientation stay" in " ".join(capsys.readouterr().out.split())


def test_a_pose_that_no_scara_takes_is_left(tmp_path, capsys):
    points = [
        JOINT_POINT.format(n=1, joints=scara_joints(*POSTURES[0])),
        scara_pose(2, POSTURES[0], tilt_deg=4.0),
    ]
    code, text = run(tmp_path, SCARA, listing(points), "--frame", "2", "--offset", OFFSET)
    assert code == 4
    assert poses_of(text)[2] == poses_of(listing(points))[2]
    assert "its pose is turned by 4.00 deg" in " ".join(capsys.readouterr().out.split())


def test_a_side_of_the_elbow_is_not_guessed(tmp_path, capsys):
    """Without a posture before it, or behind another configuration, a pose is left; a starting posture lifts that."""
    poses = [scara_pose(1, POSTURES[0]), scara_pose(2, POSTURES[1])]
    code, _ = run(tmp_path, SCARA, listing(poses), "--frame", "2", "--offset", OFFSET)
    assert code == 4
    assert "starting_posture_deg" in capsys.readouterr().out
    begin = "starting_posture_deg = [0, 30, 20, 0]"
    code, text = run(tmp_path, SCARA, listing(poses), "--frame", "2", "--offset", OFFSET, robot=begin)
    assert code == 0
    mixed = [poses[0], scara_pose(2, POSTURES[1], config="R, 0, 0, 0")]
    code, text = run(tmp_path, SCARA, listing(mixed), "--frame", "2", "--offset", OFFSET, robot=begin)
    assert code == 4
    assert poses_of(text)[2] == poses_of(listing(mixed))[2]
    assert "its configuration R, 0, 0, 0" in " ".join(capsys.readouterr().out.split())


@pytest.mark.parametrize("elbow", [1.0, -1.0])
def test_a_far_turn_of_the_work_keeps_the_side_of_the_elbow(tmp_path, elbow):
    posture = (elbow * 20.0, elbow * 70.0, 60.0, 0.0)
    points = [JOINT_POINT.format(n=1, joints=scara_joints(*posture))]
    code, text = run(tmp_path, SCARA, listing(points), "--offset", "60,-40,0,0,0,80", "--joints", "move")
    assert code == 0
    (written,) = joints_of(text).values()
    assert written[1] * elbow > 5
    before, yaw = scara_tip_mm(*posture)
    after, turned = scara_tip_mm(*written)
    expected_m = turn_z(np.radians(80.0)) @ before + np.array([60.0, -40.0, 0.0])
    assert np.abs(after - expected_m).max() < 3e-3
    assert abs(np.remainder(np.degrees(turned - yaw) - 80 + 180, 360) - 180) < 2e-4


def fanuc_flange(model, joints_deg):
    """Return the flange (4, 4) [m] by Pinocchio; joints as the pendant shows them."""
    built = pin.buildModelFromXML(bare_urdf(model, geometric_joints=True))
    data, angles = built.createData(), np.radians(joints_deg)
    angles = model.joint_coupling @ angles
    pin.framesForwardKinematics(built, data, angles)
    return np.array(data.oMf[built.getFrameId("flange")].homogeneous)


def degrees_apart(a, b) -> float:
    return float(np.degrees(np.linalg.norm(pin.log3(a[:3, :3].T @ b[:3, :3]))))


FIVE = "fanuc_lrmate200ic5h"
UPRIGHT = [(10.0, 20.0, -30.0, -60.0, 15.0), (-30.0, 35.0, -10.0, -80.0, 100.0)]  # J4 - J3: straight down


def five_joints(*values: float) -> str:
    return joint_text(*((value, "deg") for value in values))


def test_five_joints_follow_what_keeps_the_tool_upright(tmp_path):
    model = load_model(FIVE)
    points = [JOINT_POINT.format(n=i + 1, joints=five_joints(*joints)) for i, joints in enumerate(UPRIGHT)]
    code, text = run(tmp_path, FIVE, listing(points), "--offset", "20,-15,30,0,0,40", "--joints", "move")
    assert code == 0
    change = np.eye(4)
    change[:3, :3], change[:3, 3] = turn_z(np.radians(40.0)), [0.020, -0.015, 0.030]
    tool = np.eye(4)
    tool[:3, 3] = np.array(TOOL_MM) * 1e-3
    for i, joints in enumerate(UPRIGHT):
        expected_tip = change @ fanuc_flange(model, joints) @ tool
        found = fanuc_flange(model, joints_of(text)[i + 1]) @ tool
        assert np.abs(found - expected_tip)[:3, 3].max() < 4e-6  # four decimals of a degree at 0.7 m
        assert degrees_apart(expected_tip, found) < 4e-4


def test_a_turn_that_five_joints_cannot_follow_is_left_with_the_angle(tmp_path, capsys):
    """Beside its own plane an arm of five joints carries only a tool that points straight down."""
    points = [JOINT_POINT.format(n=1, joints=five_joints(0.0, 20.0, -30.0, -20.0, 0.0))]
    points += [JOINT_POINT.format(n=2, joints=five_joints(*UPRIGHT[0]))]
    code, text = run(tmp_path, FIVE, listing(points), "--offset", "0,30,0,0,0,0", "--joints", "move")
    assert code == 4
    assert joints_of(text)[1] == [0.0, 20.0, -30.0, -20.0, 0.0]
    assert joints_of(text)[2] != list(UPRIGHT[0])
    assert re.search(r"turn it by \d\.\d\d deg more than", " ".join(capsys.readouterr().out.split()))


def test_poses_of_five_joints_take_the_posture_before_them(tmp_path):
    model, tool = load_model(FIVE), np.eye(4)
    tool[:3, 3] = np.array(TOOL_MM) * 1e-3
    angle, origin = FRAME
    frame = np.eye(4)
    frame[:3, :3], frame[:3, 3] = turn_z(angle), origin * 1e-3
    points = [JOINT_POINT.format(n=1, joints=five_joints(*UPRIGHT[0]))]
    taught = [np.linalg.inv(frame) @ fanuc_flange(model, joints) @ tool for joints in UPRIGHT]
    for i, pose in enumerate(taught):
        wpr = np.degrees(values_from("fanuc_wpr", pose[:3, :3]))
        points.append(POSE_POINT.format(*pose[:3, 3] * 1e3, *wpr, n=i + 2, config="N U T, 0, 0, 0"))
    code, text = run(tmp_path, FIVE, listing(points), "--frame", "2", "--offset", "20,-15,30,0,0,10")
    assert code == 0
    for i, pose in enumerate(taught):
        expected_mm = turn_z(np.radians(10.0)) @ pose[:3, 3] * 1e3 + [20, -15, 30]
        x, y, z, *wpr = poses_of(text)[i + 2]
        assert np.abs([x, y, z] - expected_mm).max() < 1.6e-3  # both files have three decimals
        turned = np.eye(4)
        turned[:3, :3] = rotation_from("fanuc_wpr", np.radians([wpr]))[0]
        expected = np.eye(4)
        expected[:3, :3] = turn_z(np.radians(10.0)) @ pose[:3, :3]
        assert degrees_apart(turned, expected) < 2e-3


SEVEN = "yaskawa_sia10f"
PULSES = [
    71000.0,
    -68000.0,
    55000.0,
    -52000.0,
    51000.0,
    40000.0,
    66000.0,
]  # S L U R B T E, as the job has them
ELBOWS = [
    (10.0, 40.0, 25.0, 60.0, 20.0, -50.0, 30.0),
    (-20.0, 45.0, -30.0, 70.0, 35.0, 55.0, 0.0),
]  # S L E U R B T


def job_of(postures_deg) -> str:
    """Return a job of postures of the chain: the elbow axis E stands behind the others."""
    rows = []
    for i, joints in enumerate(postures_deg):
        written = np.radians([joints[j] for j in (0, 1, 3, 4, 5, 6, 2)]) * PULSES
        rows.append(f"C{i:05d}=" + ",".join(str(round(value)) for value in written))
    head = [
        "/JOB",
        "//NAME A",
        "//POS",
        f"///NPOS {len(rows)},0,0,0,0,0",
        "///TOOL 0",
        "///POSTYPE PULSE",
        "///PULSE",
    ]
    moves = [f"MOVJ C{i:05d} VJ=25.00" for i in range(len(rows))]
    return "\r\n".join([*head, *rows, "//INST", "///DATE 2026/11/22 12:00", "NOP", *moves, "END", ""])


def test_seven_joints_move_with_the_elbow_axis_at_its_taught_value(tmp_path):
    model, project = load_model(SEVEN), tmp_path / "project.toml"
    built = pin.buildModelFromXML(bare_urdf(model, geometric_joints=True))
    data = built.createData()

    def flange(joints_deg):
        pin.framesForwardKinematics(built, data, np.radians(joints_deg))
        return np.array(data.oMf[built.getFrameId("flange")].homogeneous)

    project.write_text(
        f'format = 1\n[robot]\nserial = "1"\nmodel = "{SEVEN}"\npulses_per_rad = {PULSES}\n'
        "[tools.0.entered]\nposition_mm = [0, 0, 100]\n"
    )
    (tmp_path / "A.JBI").write_bytes(job_of(ELBOWS).encode())
    words = ["program", "move", "--project", str(project), str(tmp_path / "A.JBI"), "--joints", "move"]
    assert run_command_line([*words, "--offset", "30,20,-25,2,-3,10", "--out", str(tmp_path / "o")]) == 0
    text = (tmp_path / "o" / "A.JBI").read_text()
    turn = rotation_from("yaskawa_rpy", np.radians([[2.0, -3.0, 10.0]]))[0]
    change, tool = np.eye(4), np.eye(4)
    change[:3, :3], change[:3, 3], tool[2, 3] = turn, [0.03, 0.02, -0.025], 0.1
    for i, joints in enumerate(ELBOWS):
        pulses = [float(v) for v in re.search(rf"C{i:05d}=(.*)", text)[1].split(",")]
        s, low, u, r, b, t, e = np.degrees(np.array(pulses) / PULSES)
        expected_tip = change @ flange(joints) @ tool
        found = flange([s, low, e, u, r, b, t]) @ tool
        assert abs(e - joints[2]) <= 0.51 / 66000 * 57.3  # the same pulse
        assert np.abs(found - expected_tip)[:3, 3].max() < 3e-5  # a pulse is some 14 microradians at a metre
        assert degrees_apart(expected_tip, found) < 4e-3


@pytest.mark.parametrize(
    ("line", "says"),
    [
        ("held_joints = [2, 3]", "5 of them are free"),
        ("held_joints = [9]", "has 7 joints"),
        ("held_joints = [0]", "has 7 joints"),
        ("held_joints = []", "7 of them are free"),
        ("largest_tilt_deg = -1", "largest_tilt_deg"),
        ('held_joints = ["3"]', "list of joints from 1"),
    ],
)
def test_joints_that_stay_are_named_rightly(tmp_path, line, says):
    path = tmp_path / "project.toml"
    path.write_text(PROJECT.format(model=SEVEN, robot=line))
    with pytest.raises(ProjectError, match=re.escape(says)):
        read_project(path)


def real_scara(model, seed: int):
    """Return an identified arm: every frame some tenths of a millimetre and hundredths of a degree off."""
    layout = make_layout(model, "point", 1, level=GEOMETRY)
    dice = np.random.default_rng(seed)
    values = {
        p.name: float(dice.normal() * (3e-4 if p.unit == "m" else 4e-4))
        for p in layout.parameters
        if not p.name.startswith(("base", "tool"))
    }
    state = starting_state(model, StartingPoint(values), (), np.eye(4), ())
    return IdentifiedArm(state, "0" * 64, 1, None, None, None)


def scara_project(tmp_path, seed: int):
    path = tmp_path / "project.toml"
    path.write_text(PROJECT.format(model=SCARA, robot="starting_posture_deg = [0, 30, 20, 0]"))
    project = read_project(path)
    return replace(project, identified=real_scara(project.nominal, seed), default_frame="2")


def tips_by_hand(arm, tool, joints):
    """Return the tip (N, 4, 4) of a chain of placements, multiplied out."""
    found = []
    for posture in joints:
        pose = np.eye(4)
        for k, value in enumerate(posture):
            turn = np.eye(4)
            if arm.sliding[k]:
                turn[2, 3] = value + arm.theta0_rad[k]
            else:
                turn[:3, :3] = turn_z(value + arm.theta0_rad[k])
            pose = pose @ arm.placements[k] @ turn
        found.append(pose @ arm.placements[-1] @ tool)
    return np.array(found)


def commanded_joints(project, frame_tip):
    """Return the joints that the controller of the described SCARA computes for upright poses, by trigonometry."""
    tips = project.frames["2"] @ frame_tip
    found = []
    for pose in tips @ np.linalg.inv(project.tools["1"].entered):
        x, y = pose[:2, 3]
        elbow = np.arccos((x * x + y * y - 0.35**2 - 0.3**2) / (2 * 0.35 * 0.3))
        first = np.arctan2(y, x) - np.arctan2(0.3 * np.sin(elbow), 0.35 + 0.3 * np.cos(elbow))
        yaw = np.arctan2(pose[1, 0], pose[0, 0])
        found.append([first, elbow, 0.17 - pose[2, 3], first + elbow - yaw])
    return np.array(found)


def test_compensation_of_a_scara_puts_its_real_tip_where_the_program_says(tmp_path):
    """The place and the turn about the vertical are met; the lean of the arm's own axes stays, and is said."""
    project = scara_project(tmp_path, 5)
    program = read_ls(
        "A.LS", listing([scara_pose(i + 1, joints) for i, joints in enumerate(POSTURES)]).encode()
    )
    route = compensation_transfer(project, ProgramDirection.UPLOAD, BRAND.configurations)
    result = route.transfer_programs([program])[0]
    assert result.is_complete
    expected_tips = project.frames["2"] @ result.before.positions.frame_tip
    joints = commanded_joints(project, result.after.positions.frame_tip)
    real = tips_by_hand(project.identified.state.arm_model, project.tools["1"].real, joints)
    nominal = tips_by_hand(
        project.identified.state.arm_model,
        project.tools["1"].real,
        commanded_joints(project, result.before.positions.frame_tip),
    )
    assert np.linalg.norm((nominal - expected_tips)[:, :3, 3], axis=1).min() > 3e-4
    assert (
        np.linalg.norm((real - expected_tips)[:, :3, 3], axis=1).max() < 2e-6
    )  # the file has three decimals
    yaw = [np.degrees(np.arctan2(pose[1, 0], pose[0, 0])) for pose in np.linalg.inv(expected_tips) @ real]
    assert np.abs(yaw).max() < 2e-3
    assert any("deg of the orientation stay" in warning for warning in result.warnings)


def test_a_clone_of_a_scara_stands_at_the_fixture_of_the_other_cell(tmp_path):
    master, clone = scara_project(tmp_path, 5), scara_project(tmp_path, 6)
    change = np.eye(4)
    change[:3, :3], change[:3, 3] = turn_z(0.2), [0.02, 0.01, -0.005]
    program = read_ls(
        "A.LS", listing([scara_pose(i + 1, joints) for i, joints in enumerate(POSTURES)]).encode()
    )
    route = ProgramTransfer(CloneRoute(master, clone, change, np.zeros((6, 6))), BRAND.configurations)
    result = route.transfer_programs([program])[0]
    assert result.is_complete
    ends = []
    for project, positions in ((master, result.before.positions), (clone, result.after.positions)):
        joints = commanded_joints(project, positions.frame_tip)
        ends.append(tips_by_hand(project.identified.state.arm_model, project.tools["1"].real, joints))
    assert np.linalg.norm((change @ ends[0] - ends[1])[:, :3, 3], axis=1).max() < 3e-6


def test_a_scara_and_an_arm_of_six_joints_are_no_clones(tmp_path):
    scara, path = scara_project(tmp_path, 5), tmp_path / "six.toml"
    path.write_text(PROJECT.format(model="fanuc_m6ib", robot=""))
    with pytest.raises(ProjectError, match="or of another kind"):
        ProgramTransfer(
            CloneRoute(scara, read_project(path), np.eye(4), np.zeros((6, 6))), BRAND.configurations
        )


KUKA_DAT = """&ACCESS RVP
DEFDAT  A
DECL E6POS XP1={X %s,Y %s,Z %s,A %s,B 0.0,C 180.0,S 2,T 0,E1 0.0,E2 0.0,E3 0.0,E4 0.0,E5 0.0,E6 0.0}
DECL FDAT FP1={TOOL_NO 1,BASE_NO 2,IPO_FRAME #BASE,POINT2[] " "}
DECL E6AXIS XP2={A1 10.0,A2 20.0,A3 30.0,A4 0.0,A5 0.0,A6 0.0,E1 0.0,E2 0.0,E3 0.0,E4 0.0,E5 0.0,E6 0.0}
ENDDAT
"""
KUKA_SRC = "&ACCESS RVP\nDEF A()\nBAS(#TOOL,1)\nBAS(#BASE,2)\nPTP XP2\nPTP XP1\nEND\n"


def test_joints_without_a_unit_are_left_where_one_slides(tmp_path, capsys):
    place, yaw = in_frame(*scara_tip_mm(*POSTURES[0]))
    (tmp_path / "A.dat").write_text(KUKA_DAT % (*place, np.degrees(yaw)))
    (tmp_path / "A.src").write_text(KUKA_SRC)
    (tmp_path / "project.toml").write_text(
        PROJECT.format(model=SCARA, robot="starting_posture_deg = [0, 30, 20, 0]")
    )
    words = ["program", "move", "--project", str(tmp_path / "project.toml")]
    words += [str(tmp_path / "A.dat"), str(tmp_path / "A.src"), "--joints", "move", "--offset", "0,0,2,0,0,1"]
    assert run_command_line([*words, "--out", str(tmp_path / "o")]) == 4
    text = (tmp_path / "o" / "A.dat").read_text()
    assert "A1 10.0,A2 20.0,A3 30.0,A4 0.0" in text
    x, y, z, a = (float(v) for v in re.search(r"X (\S+),Y (\S+),Z (\S+),A (\S+),B", text).groups())
    angle, origin = FRAME
    base = turn_z(angle) @ place + origin
    moved = turn_z(-angle) @ (turn_z(np.radians(1.0)) @ base + [0, 0, 2] - origin)
    assert np.abs([x - moved[0], y - moved[1], z - moved[2]]).max() < 1e-3
    assert abs(a - np.degrees(yaw) - 1.0) < 1e-4
    assert "joints without a unit" in " ".join(capsys.readouterr().out.split())


def test_rods_of_an_identified_arm_are_said_to_stay_uncorrected(tmp_path):
    path = tmp_path / "project.toml"
    path.write_text(PROJECT.format(model="abb_irb2400", robot=""))
    plain = read_project(path)
    assert rods_left_out(plain, plain) == []
    state = starting_state(plain.nominal, StartingPoint({}), (), np.eye(4), ())
    identified = replace(plain, identified=IdentifiedArm(state, "0" * 64, 1, None, None, None))
    (remark,) = rods_left_out(identified, plain)
    assert "rods drive axis 3 of abb_irb2400" in remark
    scara = scara_project(tmp_path, 5)
    assert rods_left_out(scara, scara) == []


def test_an_inspection_shows_a_slide_in_millimetres_and_reaches_its_poses(tmp_path, capsys):
    points = [JOINT_POINT.format(n=1, joints=scara_joints(*POSTURES[0])), scara_pose(2, POSTURES[1])]
    (tmp_path / "A.LS").write_text(listing(points))
    (tmp_path / "project.toml").write_text(PROJECT.format(model=SCARA, robot=""))
    words = [
        "program",
        "inspect",
        "--project",
        str(tmp_path / "project.toml"),
        str(tmp_path / "A.LS"),
        "--json",
    ]
    assert run_command_line(words) == 0
    shown = json.loads(capsys.readouterr().out)["programs"][0]["points"]
    assert shown[0]["joints_deg"] == list(POSTURES[0])
    assert [point["reach"] for point in shown] == ["reached", "reached"]


WIDE = "lower_deg = [-126, -137, 0, -360]\nupper_deg = [126, 137, 200, 360]"  # mm of the slide


@pytest.mark.parametrize(("spline_deg", "code"), [(178.0, 4), (120.0, 0)])
def test_a_joint_that_passes_a_border_of_an_unread_configuration_leaves_the_point(
    tmp_path, spline_deg, code, capsys
):
    posture = (0.0, 60.0, 30.0, spline_deg)
    points = [JOINT_POINT.format(n=1, joints=scara_joints(*posture)), scara_pose(2, posture)]
    done, text = run(tmp_path, SCARA, listing(points), "--frame", "2", "--offset", "0,0,0,0,0,25", robot=WIDE)
    (written,) = joints_of(text).values()
    assert (written[3] > 180) == (code == 4)  # joints state their turns themselves
    assert done == code
    assert (poses_of(text) == poses_of(listing(points))) == (code == 4)
    assert ("joint 4 would pass a border" in " ".join(capsys.readouterr().out.split())) == (code == 4)


def test_both_sides_of_the_elbow_are_distinguished():
    arm = scara_axes(load_model("denso_hsr065a1_n32"))
    postures = np.random.default_rng(1).uniform(-1.5, 1.5, (50, 4)) * [1, 1, 0.05, 1]
    poses = arm.model.base_flange(postures)
    found, lean = scara_postures(arm, poses)
    assert lean.max() < 1e-7
    for side in found:
        assert np.abs(arm.model.base_flange(side) - poses).max() < 1e-12
    assert (elbow_side(arm, found[0]) * elbow_side(arm, found[1]) < 0).all()
    assert np.abs(found - postures).max(axis=2).min(axis=0).max() < 1e-9
    assert scara_axes(load_model("ur10e")) is None
    assert scara_axes(load_model(FIVE)) is None
