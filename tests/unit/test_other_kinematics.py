"""Arms of any kind are identified: seven axes, five, SCARA, on a track; and what is told of joints that slide."""

import csv
import json
from pathlib import Path

import numpy as np
import pytest

from cellcal.calibration.arm.joint_terms import gear_terms, gravity_terms, harmonic_terms
from cellcal.calibration.arm.kinematics import load_model
from cellcal.calibration.cells.levels import CellOptions
from cellcal.calibration.compensation.compensate import CompensationLimits, compensate
from cellcal.calibration.compensation.pose_gap import TipArm
from cellcal.calibration.compensation.posture_of_pose import postures_of_poses
from cellcal.calibration.errors import CalibrationError
from cellcal.calibration.geometry import exp_rotation, homogeneous_matrix
from cellcal.calibration.identification.lints import rounding_floor
from cellcal.calibration.identification.misfit_error import MisfitError
from cellcal.calibration.identification.sweep_lint import sweep_lint
from cellcal.calibration.motion.motion_check import MotionLimits, check_moves
from cellcal.calibration.orientation import values_from
from cellcal.service.cli.app import run_command_line
from cellcal.service.engineering.identification.cell_identify import identify_cell_file
from cellcal.service.engineering.identification.identify import identify_file
from cellcal.service.engineering.identification.row_fit import IdentifyOptions
from cellcal.service.engineering.measured.measurements import ReadOptions
from cellcal.service.engineering.measured.table import MeasurementError
from tests.unit.helpers.hidden_arm import NOISE_M, HiddenArm, calibrate

DESCRIPTIONS = Path(__file__).parents[1] / "data" / "descriptions"
TRACK = f"{DESCRIPTIONS}/arm_on_track.urdf?base=world&tip=tool0"
SCARA = f"{DESCRIPTIONS}/scara.urdf?tip=flange"
SEVEN = f"{DESCRIPTIONS}/seven_axes.urdf?tip=tool0"
POSITIONER = f"{DESCRIPTIONS}/positioner.urdf?tip=plate"
WITHIN = 1.3  # times the noise: the errors of readings that no fit has seen


def written(path, robot, seed=1, *, rows=40, held=100, slides_in="mm", named=True):
    """Write a file as an instrument does: degrees, millimetres of joints that slide, millimetres of places."""
    hidden = HiddenArm(load_model(robot), seed)
    joints, slides = hidden.postures(rows + held), hidden.slides()
    scale = {"mm": 1e3, "m": 1.0}[slides_in]
    shown = np.where(slides, joints * scale, np.degrees(joints))
    unit = [f" ({slides_in if slide else 'deg'})" if named else "" for slide in slides]
    heads = [f"J{i + 1}{unit[i]}" for i in range(len(slides))] + ["x (mm)", "y (mm)", "z (mm)"]
    table = np.column_stack([shown, hidden.measured(joints) * 1e3])
    np.savetxt(path, table, delimiter=",", header=",".join(heads), comments="", fmt="%.7f")
    return path


@pytest.mark.parametrize("robot", [TRACK, SCARA, SEVEN], ids=["track", "scara", "seven"])
@pytest.mark.parametrize("seed", [1, pytest.param(2, marks=pytest.mark.soak)])
def test_forty_points_identify_an_arm_of_any_kind(tmp_path, robot, seed):
    path = written(tmp_path / "points.csv", robot, seed)
    report = identify_file(path, robot, IdentifyOptions(train_rows=40))
    noise = NOISE_M * np.sqrt(3.0)
    assert report.held_out.rmse_m <= WITHIN * noise
    assert report.before.rmse_m > 5 * noise
    assert report.level == 2


@pytest.mark.parametrize("seed", [1, 3])
def test_the_axes_of_a_positioner_are_found_from_a_target_on_its_table(tmp_path, seed):
    path = written(tmp_path / "points.csv", POSITIONER, seed)
    report = identify_file(path, POSITIONER, IdentifyOptions(train_rows=40, level=2))
    assert report.held_out.rmse_m <= WITHIN * NOISE_M * np.sqrt(3.0)
    square = [p.sigma for p in report.parameters if p.name in ("J2 placement rx", "J2 placement ry")]
    assert min(square) < 5e-4  # rad: how well the angle between the axes is known


SLICE = [
    "abb_irb2400",
    pytest.param("fanuc_crx10ia", marks=pytest.mark.soak),
    "franka_fr3",
    pytest.param("mitsubishi_rh6frh5520", marks=pytest.mark.soak),
    pytest.param("staubli_tx2_90l", marks=pytest.mark.soak),
    "ufactory_xarm5",
    "yaskawa_mpl80",
]  # `make soak ARGS=catalogue_arms` takes the whole catalogue


@pytest.mark.parametrize("robot", SLICE)
def test_a_calibration_finds_what_was_hidden(robot):
    found = calibrate(robot)
    assert found.held_out <= WITHIN < 5 < found.before
    assert found.covered >= 0.92


@pytest.mark.parametrize("robot", ["denso_hsr065a1_n32", "fanuc_crx10ia", "kuka_lbr_iiwa14_r820"])
def test_a_calibration_finds_hidden_zeros(robot):
    zeros = calibrate(robot, geometry=0.0, level=1)
    assert zeros.held_out <= WITHIN
    assert zeros.zeros
    assert all(abs(deviations) < 4 for deviations in zeros.zeros.values())


@pytest.mark.parametrize(("slides_in", "named"), [("m", True), ("mm", False), ("m", False)])
def test_the_unit_of_a_slide_is_read_or_recognised_by_its_travel(tmp_path, slides_in, named):
    path = written(tmp_path / "points.csv", TRACK, slides_in=slides_in, named=named)
    report = identify_file(path, TRACK, IdentifyOptions(train_rows=40))
    assert report.measurements.units["slides"] == slides_in
    assert report.held_out.rmse_m < WITHIN * NOISE_M * np.sqrt(3.0)


def test_a_unit_that_was_said_wrong_is_named(tmp_path):
    path = written(tmp_path / "points.csv", TRACK, named=False)
    with pytest.raises(MisfitError) as refused:
        identify_file(path, TRACK, IdentifyOptions(read=ReadOptions(units={"slides": "cm"})))
    assert "do not fit" in refused.value.message
    with pytest.raises(MisfitError, match="J1 is in mm"):
        identify_file(path, TRACK, IdentifyOptions(read=ReadOptions(units={"slides": "m"})))
    with pytest.raises(MeasurementError, match="slides cannot be in 'deg'"):
        identify_file(path, TRACK, IdentifyOptions(read=ReadOptions(units={"slides": "deg"})))


@pytest.mark.parametrize(("unit", "metres"), [("inch", 0.0254), ("cm", 0.01)])
def test_a_track_in_inches_or_centimetres_is_named(tmp_path, unit, metres):
    plain = written(tmp_path / "points.csv", TRACK, named=False, held=0)
    head, *rows = plain.read_text().splitlines()
    shown = [float(row.split(",", 1)[0]) * 1e-3 / metres for row in rows]
    lines = [f"{track:.6f},{row.split(',', 1)[1]}" for track, row in zip(shown, rows, strict=True)]
    path = tmp_path / "other_unit.csv"
    path.write_text("\n".join([head, *lines]) + "\n")
    with pytest.raises(MisfitError, match=f"J1 is in {unit}") as refused:
        identify_file(path, TRACK)
    assert f"--units slides={unit}" in refused.value.remedy


@pytest.mark.parametrize("slides_in", ["m", "mm"])
def test_a_sliding_joint_described_as_one_that_turns_is_named(tmp_path, slides_in):
    """The file's joint slides by 0 to 0.2 m; the description says that it turns by so many radians."""
    path = written(tmp_path / "points.csv", SCARA, slides_in=slides_in, named=False)
    text = (DESCRIPTIONS / "scara.urdf").read_text()
    wrong = tmp_path / "wrong.urdf"
    wrong.write_text(text.replace('name="z" type="prismatic"', 'name="z" type="revolute"'))
    with pytest.raises(MisfitError, match=f"J3 slides, by {slides_in}, and does not turn") as refused:
        identify_file(path, f"{wrong}?tip=flange")
    assert "as prismatic" in refused.value.remedy


def test_columns_of_a_track_go_to_the_joint_that_slides(tmp_path):
    """The description has the track first; files have it as E1, as J7 in millimetres, or anywhere by its name."""
    plain = written(tmp_path / "points.csv", TRACK).read_text().splitlines()
    rows = [line.split(",") for line in plain[1:]]
    arm = [f"A{i} (deg)" for i in range(1, 7)]
    for name, heads, track_at in (
        ("e1_first", ["E1 (mm)", *arm], 0),
        ("e1_last", [*arm, "E1 (mm)"], 6),
        ("e1_no_unit", [*(f"J{i}" for i in range(1, 7)), "E1"], 6),
        ("j7", [*(f"J{i} (deg)" for i in range(1, 7)), "J7 (mm)"], 6),
    ):
        path = tmp_path / f"{name}.csv"
        table = [[*row[1 : track_at + 1], row[0], *row[track_at + 1 :]] for row in rows]
        lines = [",".join([*heads, "x (mm)", "y (mm)", "z (mm)"]), *(",".join(row) for row in table)]
        path.write_text("\n".join(lines) + "\n")
        report = identify_file(path, TRACK, IdentifyOptions(train_rows=40))
        assert report.measurements.layout.joints[0] == heads[track_at]
        assert report.held_out.rmse_m < WITHIN * NOISE_M * np.sqrt(3.0)


@pytest.mark.parametrize(("old", "new"), [("prismatic", "revolute"), ("revolute", "prismatic")])
def test_a_heading_that_contradicts_the_kind_of_joint_is_named(tmp_path, old, new):
    path = written(tmp_path / "points.csv", SCARA)
    text = (DESCRIPTIONS / "scara.urdf").read_text()
    name = {"prismatic": "z", "revolute": "j2"}[old]
    wrong = tmp_path / "wrong.urdf"
    wrong.write_text(text.replace(f'name="{name}" type="{old}"', f'name="{name}" type="{new}"'))
    with pytest.raises(MeasurementError, match="the robot's joint there") as refused:
        identify_file(path, f"{wrong}?tip=flange")
    assert "prismatic" in refused.value.remedy


def test_a_zero_in_degrees_of_a_slide_is_refused(tmp_path):
    path = written(tmp_path / "points.csv", TRACK, named=False)
    columns = {"joints": ["J1+5", *(f"J{i}" for i in range(2, 8))]}
    with pytest.raises(MeasurementError, match="joint that slides"):
        identify_file(path, TRACK, IdentifyOptions(read=ReadOptions(columns=columns)))


def test_parameters_of_a_slide_are_lengths(tmp_path):
    path = written(tmp_path / "points.csv", SCARA)
    report = identify_file(path, SCARA, IdentifyOptions(level=2))
    units = {p.name: p.unit for p in report.identification.robust.fit.layout.parameters}
    assert units.get("J3 offset", "m") == "m"
    assert {units[name] for name in units if name.endswith(" offset") and name != "J3 offset"} == {"rad"}


def test_a_slide_sags_and_ripples_in_no_term():
    model = load_model(TRACK)
    for terms in (gravity_terms(model), harmonic_terms(model)):
        assert terms
        assert 0 not in {term.joint for term in terms}
    ratios = [term for term in gear_terms(model) if term.joint == 0]
    assert [term.source for term in ratios] == [0]


def test_a_wrong_scale_of_a_track_is_found(tmp_path):
    """A rack that is 0.05 % longer than its maker says moves the far end by more than a millimetre."""
    model, hidden = load_model(TRACK), HiddenArm(load_model(TRACK), 3)
    joints = hidden.postures(300)
    moved = joints.copy()
    moved[:, 0] *= 1.0005
    places = hidden.measured(moved)
    heads = [
        *(f"J{i + 1} ({'mm' if i == 0 else 'deg'})" for i in range(model.axis_count)),
        "x (mm)",
        "y (mm)",
        "z (mm)",
    ]
    shown = np.where(hidden.slides(), joints * 1e3, np.degrees(joints))
    path = tmp_path / "points.csv"
    np.savetxt(
        path, np.column_stack([shown, places * 1e3]), delimiter=",", header=",".join(heads), comments="", fmt="%.7f"
    )  # fmt: skip
    report = identify_file(path, TRACK, IdentifyOptions(level=5))
    fit = report.identification.robust.fit
    found = {p.name: value for p, value in zip(fit.layout.parameters, fit.deviations, strict=True)}
    assert abs(found["J1 gear ratio"] - 5e-4) < 5e-5


def test_the_command_writes_all_it_can_of_an_arm_on_a_track(tmp_path, capsys):
    path = written(tmp_path / "points.csv", TRACK)
    at = tmp_path / "at.csv"
    at.write_text("q1_mm,q2_deg,q3_deg,q4_deg,q5_deg,q6_deg,q7_deg\n1200,10,20,-10,5,30,0\n")
    words = ["identify", str(path), "--robot", TRACK, "--level", "2", "--json", "--at", str(at)]
    words += ["--at-csv", str(tmp_path / "tips.csv"), "--plot", str(tmp_path / "plots")]
    words += [
        "--save",
        str(tmp_path / "sets"),
        "--serial",
        "T1",
        "--by",
        "me",
        "--urdf",
        str(tmp_path / "new.urdf"),
    ]
    assert run_command_line(words) == 0
    document = json.loads(capsys.readouterr().out)
    assert document["at"]["points"][0]["joints_rad"][0] == pytest.approx(1.2)
    with (tmp_path / "tips.csv").open() as file:
        (row,) = csv.DictReader(file)
    assert float(row["q1_mm"]) == 1200
    assert float(row["q2_deg"]) == 10
    assert (tmp_path / "plots" / "residuals_by_joint.svg").exists()
    identified = load_model(f"{tmp_path}/new.urdf?tip=flange")
    assert identified.kinds[0] == "prismatic"
    assert np.abs(identified.placements - load_model(TRACK).placements).max() > 1e-5


def test_the_description_of_the_nominal_robot_is_not_written_over(tmp_path, capsys):
    mine = tmp_path / "mine.urdf"
    mine.write_text((DESCRIPTIONS / "scara.urdf").read_text())
    robot = f"{mine}?tip=flange"
    path = written(tmp_path / "points.csv", robot)
    assert run_command_line(["identify", str(path), "--robot", robot, "--urdf", str(mine)]) != 0
    assert "Name another file" in capsys.readouterr().err
    assert mine.read_text() == (DESCRIPTIONS / "scara.urdf").read_text()


@pytest.mark.parametrize(
    "robot", [TRACK, SCARA, SEVEN, "ufactory_xarm5"], ids=["track", "scara", "seven", "five"]
)
def test_poses_are_planned_for_any_kind(tmp_path, robot, capsys):
    out = tmp_path / "poses.csv"
    words = [
        "poses",
        "--robot",
        robot,
        "--sigma-mm",
        "0.05",
        "--count",
        "12",
        "--candidates",
        "300",
        "--json",
    ]
    assert run_command_line([*words, "--csv", str(out)]) == 0
    document = json.loads(capsys.readouterr().out)
    model = load_model(robot)
    with out.open() as file:
        rows = list(csv.DictReader(file))
    assert len(rows) == 12
    assert document["joint_columns"] == list(rows[0])[: model.axis_count]
    for i, kind in enumerate(model.kinds):
        values = np.array([float(row[document["joint_columns"][i]]) for row in rows])
        values = values / 1e3 if kind == "prismatic" else np.radians(values)
        assert ((values >= model.lower_rad[i]) & (values <= model.upper_rad[i])).all()
        assert np.ptp(values) > 0.3 * min(np.ptp([model.lower_rad[i], model.upper_rad[i]]), 2.0)


def broken(model, start, targets):
    verdict = check_moves(model, start, targets, MotionLimits(joint_margin_rad=0.0), speed_rad_s=0.1)
    return [found.sentence for found in verdict.findings if found.check == "joint limits"]


def test_a_joint_that_slides_has_its_limits_in_the_motion_gate():
    model = load_model(TRACK)
    start, far = np.zeros(7), np.array([[2.999, 0, 0, 0, 0, 0, 0]])
    assert not broken(model, start, far)
    assert broken(model, start, np.array([[3.2, 0, 0, 0, 0, 0, 0]])) == [
        "target 1, joint limits of J1: 3200 mm, limit 3000 mm"
    ]


def test_a_sum_of_joints_has_its_limit_in_the_motion_gate():
    model = load_model("fanuc_crx10ia")
    start = np.zeros(6)
    inside, outside = np.radians([[0, 60, 100, 0, 60, 0]]), np.radians([[0, 100, 160, 0, 60, 0]])
    assert (outside <= model.upper_rad).all()
    assert not broken(model, start, inside)
    assert any("J2+J3" in sentence for sentence in broken(model, start, outside))


def test_compensation_moves_the_slide_too():
    hidden = HiddenArm(load_model(TRACK), 4)
    model = hidden.nominal
    real = model.with_twists(np.random.default_rng(1).normal(size=(8, 6)) * 5e-4)
    joints = hidden.postures(20)
    found = compensate(real, model, joints)
    good = found.has_converged
    assert good.mean() > 0.8
    apart = real.base_flange(found.joints_rad)[good] - model.base_flange(joints)[good]
    assert np.abs(apart).max() < 1e-7


def test_compensation_leaves_a_joint_that_is_held():
    hidden = HiddenArm(load_model(TRACK), 4)
    model = hidden.nominal
    real = model.with_twists(np.random.default_rng(1).normal(size=(8, 6)) * 5e-4)
    joints = hidden.postures(50)
    found = compensate(real, model, joints, limits=CompensationLimits(held=(0,)))
    good = found.has_converged
    assert good.mean() > 0.7
    assert np.array_equal(found.joints_rad[:, 0], joints[:, 0])
    apart = real.base_flange(found.joints_rad)[good] - model.base_flange(joints)[good]
    assert np.abs(apart).max() < 1e-7
    free = compensate(real, model, joints)
    assert (free.joints_rad[free.has_converged, 0] != joints[free.has_converged, 0]).all()
    for held_joints in ((0, 1), (7,)):
        with pytest.raises(CalibrationError, match="cannot stay"):
            compensate(real, model, joints, limits=CompensationLimits(held=held_joints))


def test_full_poses_identify_an_arm_on_a_track(tmp_path):
    model, dice = load_model(TRACK), np.random.default_rng(5)
    hidden = HiddenArm(model, 3)
    joints, slides = hidden.postures(140), hidden.slides()
    real = model.with_twists(dice.normal(size=(8, 6)) * np.array([4e-4] * 3 + [5e-4] * 3))
    base_world = homogeneous_matrix(exp_rotation(dice.normal(size=3)), np.array([2.5, 0.7, 0.3]))
    target = homogeneous_matrix(exp_rotation(np.array([0.2, -0.1, 0.4])), np.array([0.05, 0.06, 0.12]))
    poses = base_world @ real.base_flange(joints + hidden.zeros()) @ target
    places = poses[:, :3, 3] + dice.normal(size=(140, 3)) * NOISE_M
    turns = poses[:, :3, :3] @ np.array([exp_rotation(v) for v in dice.normal(size=(140, 3)) * 1e-4])
    shown = np.where(slides, joints * 1e3, np.degrees(joints))
    table = np.column_stack([shown, places * 1e3, np.degrees(values_from("ros_rpy", turns))])
    heads = [f"J{i + 1} ({'mm' if slides[i] else 'deg'})" for i in range(7)]
    heads += ["x (mm)", "y (mm)", "z (mm)", "rx (deg)", "ry (deg)", "rz (deg)"]
    path = tmp_path / "poses.csv"
    np.savetxt(path, table, delimiter=",", header=",".join(heads), comments="", fmt="%.8f")
    report = identify_file(path, TRACK, IdentifyOptions(train_rows=40))
    assert report.measurements.convention == "ros_rpy"
    assert report.held_out.rmse_m < WITHIN * NOISE_M * np.sqrt(3.0) < report.before.rmse_m


def test_four_axes_keep_no_pose_and_say_so():
    arm = TipArm(load_model(SCARA))
    for keep in (
        compensate,
        lambda one, _, joints: postures_of_poses(one, one.model.base_flange(joints), joints),
    ):
        with pytest.raises(CalibrationError, match="six or more") as refused:
            keep(arm, arm, np.zeros((1, 4)))
        assert "as far as its joints follow" in refused.value.remedy


def test_what_is_said_of_a_slide_is_in_millimetres():
    dice = np.random.default_rng(5)
    joints = dice.uniform(-1, 1, (200, 2))
    residuals = np.vstack([1e-4 * np.sin(3 * joints[:, 1]), np.zeros(200), np.zeros(200)])
    residuals += dice.normal(size=residuals.shape) * 1e-5
    (found,) = sweep_lint(joints, residuals, np.arange(200), ("a", "rail"), slides=(False, True))
    assert "rail" in found.message
    assert " mm" in found.message
    assert "deg" not in found.message
    model = load_model(SCARA)
    steps = np.array([1e-6, 1e-6, 1e-3, 1e-6])
    (floor,) = rounding_floor(model, HiddenArm(model).postures(50), steps, 0.0)
    assert "rounded to 1 mm" in floor.message


def test_a_cell_of_several_devices_around_an_arm_on_a_track(tmp_path):
    hidden = HiddenArm(load_model(TRACK), 1)
    joints = hidden.postures(60)
    tracked = hidden.measured(joints)
    noise = np.random.default_rng(9).normal(size=60) * NOISE_M
    wire = np.linalg.norm(hidden.tips(joints) - np.array([1.0, -0.5, 0.2]), axis=1) + noise
    shown = np.where(hidden.slides(), joints * 1e3, np.degrees(joints))
    heads = ",".join([*(f"J{i + 1}" for i in range(7)), "X", "Y", "Z", "L"])
    path, layout = tmp_path / "cell.csv", tmp_path / "layout.toml"
    np.savetxt(
        path, np.column_stack([shown, tracked * 1e3, wire * 1e3]), delimiter=",", header=heads, comments=""
    )
    layout.write_text(
        '[columns]\njoints = ["J1", "J2", "J3", "J4", "J5", "J6", "J7"]\n'
        '[[reading]]\nname = "tracked"\nkind = "point"\ncolumns = ["X", "Y", "Z"]\ndevice = "tracker"\n'
        'target = "ball"\nsigma_mm = 0.05\n'
        '[[reading]]\nname = "wire"\nkind = "length"\ncolumns = ["L"]\ndevice = "wire"\ntarget = "ball"\n'
        "sigma_mm = 0.05\n"
    )
    tracked_series, wire_series = identify_cell_file(path, layout, TRACK, CellOptions()).series
    assert tracked_series.held_out.rmse_m < WITHIN * NOISE_M * np.sqrt(3.0) < tracked_series.before.rmse_m
    assert wire_series.held_out.rmse_m < WITHIN * NOISE_M < wire_series.before.rmse_m
    layout.write_text(layout.read_text().replace(', "J7"', ""))
    with pytest.raises(MeasurementError, match="7 joints"):
        identify_cell_file(path, layout, TRACK, CellOptions())


def test_two_robots_on_one_track(tmp_path):
    """Two carriages of one rail, a target each; a tracker beside it sees both. Folds leave 40 points of each."""
    arms = {name: HiddenArm(load_model(TRACK), seed) for name, seed in (("left", 1), ("right", 2))}
    lines = ["arm,J1,J2,J3,J4,J5,J6,J7,X,Y,Z"]
    for name, hidden in arms.items():
        joints = hidden.postures(54)
        shown = np.where(hidden.slides(), joints * 1e3, np.degrees(joints))
        rows = np.column_stack([shown, hidden.measured(joints) * 1e3])
        lines += [f"{name},{','.join(f'{value:.6f}' for value in row)}" for row in rows]
    path, layout = tmp_path / "cell.csv", tmp_path / "layout.toml"
    path.write_text("\n".join(lines) + "\n")
    layout.write_text(
        '[columns]\njoints = ["J1", "J2", "J3", "J4", "J5", "J6", "J7"]\nrobot = "arm"\n'
        '[[robot]]\nname = "left"\n[[robot]]\nname = "right"\n'
        '[[reading]]\nname = "tracked"\nkind = "point"\ncolumns = ["X", "Y", "Z"]\ndevice = "tracker"\n'
        'target = "ball"\nsigma_mm = 0.05\n'
    )
    report = identify_cell_file(path, layout, TRACK, CellOptions(folds=4))
    for series in report.series:
        assert series.held_out.rmse_m < WITHIN * NOISE_M * np.sqrt(3.0) < series.before.rmse_m
    assert {frame.name for frame in report.frames} >= {"right", "tracker", "ball (left)", "ball (right)"}


@pytest.mark.parametrize(
    ("written", "cause", "cure"),
    [
        (
            ('"j2" type="revolute"', '"j2" type="fixed"'),
            "joint j2 turns, which the description has as fixed",
            "as revolute",
        ),
        (
            ('"z" type="prismatic"', '"z" type="fixed"'),
            "joint z slides, which the description has as fixed",
            "as prismatic",
        ),
        (
            ('"j2" type="revolute"', '"j2" type="prismatic"'),
            "J2 turns, by deg, and does not slide",
            "as revolute",
        ),
        (
            ('"z" type="prismatic"', '"z" type="revolute"'),
            "J3 slides, by mm, and does not turn",
            "as prismatic",
        ),
    ],
)
def test_a_joint_that_is_described_as_another_kind_is_named(tmp_path, written, cause, cure):
    hidden = HiddenArm(load_model(SCARA))
    joints = hidden.postures(60)
    shown = np.where(hidden.slides(), joints * 1e3, np.degrees(joints))
    table = np.column_stack([shown, hidden.measured(joints) * 1e3])
    path, text = tmp_path / "measured.csv", Path(SCARA.partition("?")[0]).read_text()
    np.savetxt(path, table, delimiter=",", header="J1,J2,J3,J4,X,Y,Z", comments="", fmt="%.5f")
    (tmp_path / "arm.urdf").write_text(text.replace(*written))
    with pytest.raises(MisfitError) as refused:
        identify_file(path, f"{tmp_path}/arm.urdf?tip=flange")
    assert cause in refused.value.message
    assert cure in refused.value.remedy


def test_rows_that_no_fixed_joint_explains_are_refused_as_before(tmp_path):
    dice = np.random.default_rng(2)
    table = np.column_stack([dice.uniform(-90, 90, (60, 3)), dice.uniform(-500, 500, (60, 4))])
    path, text = tmp_path / "measured.csv", Path(SCARA.partition("?")[0]).read_text()
    np.savetxt(path, table, delimiter=",", header="J1,J2,J3,J4,X,Y,Z", comments="", fmt="%.5f")
    (tmp_path / "arm.urdf").write_text(text.replace('"j2" type="revolute"', '"j2" type="fixed"'))
    with pytest.raises(MisfitError, match="no known cause fits"):
        identify_file(path, f"{tmp_path}/arm.urdf?tip=flange")
