"""Any six-axis robot behind the fakes: the world puts it where the catalogue does, by arithmetic of its own."""

import tomllib
from pathlib import Path

import numpy as np
import pytest

from cellcal.calibration.arm.dh_of_chain import dh_of_chain
from cellcal.calibration.arm.kinematics import DhTable, RobotModel, load_model
from cellcal.calibration.arm.robot_models.catalogue_index import catalogue_entries
from cellcal.calibration.arm.urdf import bare_urdf
from cellcal.calibration.errors import CalibrationError, CellError
from cellcal.calibration.motion.motion_check import MotionLimits, WirePath
from cellcal.fake_devices.arm import SimulatedArm
from cellcal.fake_devices.arm_models import MODELS
from cellcal.fake_devices.cell import FakeCell
from cellcal.fake_devices.described_arms import described_arm, model_of, read_described_arms
from cellcal.fake_devices.encoders import PulseCoders
from cellcal.service.configuration.cell_file import read_cell_file
from cellcal.service.demo.demo_arm import (
    HOOK_IN_FLANGE_M,
    KNOWN_TO_FAKES,
    describe_arms,
    described,
    plan_demo_arm,
    write_described,
)
from cellcal.service.demo.fake_cell import write_cell_file

SIX = [entry.name for entry in catalogue_entries() if entry.usable and entry.axes == 6]


def played(name):
    model = load_model(name)
    return model, described_arm(name, described(model, [0.0] * 6, drives=True))


def test_every_six_axis_robot_of_the_catalogue_is_played_where_it_is():
    apart = {}
    for name in SIX:
        model, drawn = played(name)
        joints = np.random.default_rng(3).uniform(-1.5, 1.5, (5, 6))
        arm = SimulatedArm.from_model(drawn, 1, hidden=False)
        apart[name] = np.abs(arm.believed_flange(joints) - model.base_flange(joints)).max()
    assert len(SIX) > 300
    assert not {name: far for name, far in apart.items() if not far < 1e-9}


def test_drives_of_described_arms_are_generic_and_turn_all_joints():
    _, drawn = played("staubli_tx2_90l")
    assert drawn.gears is not None
    coders = PulseCoders(SimulatedArm.from_model(drawn, 1), np.random.default_rng(1))
    assert np.linalg.matrix_rank(coders.radians_per_count) == 6
    model = load_model("ur20")
    assert described_arm("ur20", described(model, [0.0] * 6, drives=False)).gears is None


def test_a_large_arm_sags_about_as_much_as_a_small_one():
    """Masses and stiffness grow with the reach as those of real arms do: no arm of the world is made of rubber."""
    sags = []
    for name in ("mecademic_meca_500_r3", "fanuc_crx10ia", "kuka_kr210_r3100_2"):
        _, drawn = played(name)
        arm, perfect = SimulatedArm.from_model(drawn, 2), SimulatedArm.from_model(drawn, 2, hidden=False)
        joints = np.array([[0.1, 0.2, -0.3, 0.2, 0.7, 0.1]])
        away = np.linalg.norm(arm.flange_at(joints)[0, :3, 3] - perfect.flange_at(joints)[0, :3, 3])
        sags.append(away / np.linalg.norm(perfect.flange_at(joints)[0, :3, 3]))
    assert min(sags) > 1e-5
    assert max(sags) < 0.01


@pytest.mark.parametrize(
    ("change", "says"),
    [
        ({"dh": [[0, 0, 0, 0]] * 5}, "six axes"),
        ({"park_deg": [0.0] * 5}, "park_deg needs 6"),
        ({"lower_deg": [float("nan")] * 6}, "lower_deg needs 6"),
        ({"base": [[1.0]]}, "base needs 4 times 4"),
    ],
)
def test_a_wrong_description_is_refused(change, says):
    table = described(load_model("abb_irb120"), [0.0] * 6, drives=True) | change
    with pytest.raises(ValueError, match=says):
        described_arm("x", table)


def test_an_arm_without_a_description_is_named():
    with pytest.raises(ValueError, match="'unknown'"):
        model_of("robot", "unknown", {})
    assert model_of("robot", "ur10e", {}).gears is None
    _, drawn = played("ur10e")
    assert model_of("robot", "ur10e", {"robot": drawn}).gears is not None
    assert model_of("ur", "ur10e", {"robot": drawn}).gears is None


def test_the_service_knows_which_arms_the_fakes_know():
    assert {name for some in KNOWN_TO_FAKES.values() for name in some} == set(MODELS)
    assert all(
        (MODELS[name].gears is not None) == (name in KNOWN_TO_FAKES["modbus_robot"]) for name in MODELS
    )


@pytest.mark.parametrize("name", ["kuka_kr10_r1100_2", "mecademic_meca_500_r3", "kuka_kr210_r3100_2", "ur20"])
def test_wire_floor_and_first_posture_suit_the_size_of_an_arm(name):
    arm = plan_demo_arm(name)
    model, park = arm.model, arm.park_rad
    assert ((park > model.lower_rad) & (park < model.upper_rad)).all()
    hook = model.tip_positions(park[None], np.array(HOOK_IN_FLANGE_M))[0]
    length = float(np.linalg.norm(hook - np.array(arm.anchor_in_base_m)))
    assert 0.05 * arm.wire_range_m < length < 0.95 * arm.wire_range_m
    assert hook[2] > arm.floor_m + 0.1
    assert plan_demo_arm(name).park_rad.tolist() == park.tolist()
    limits = MotionLimits(wire=WirePath(arm.anchor_in_base_m, HOOK_IN_FLANGE_M, arm.wire_range_m))
    assert limits.wire is not None


@pytest.mark.parametrize("name", ["franka_fr3", "denso_hsr065a1_n32", "ufactory_xarm5"])
def test_arms_of_other_kinds_are_refused_with_the_reason(name):
    with pytest.raises(CellError, match="six turning axes") as refused:
        plan_demo_arm(name)
    assert f"has {load_model(name).axis_count} axes" in refused.value.message
    assert f"`cellcal poses --robot {name} --sigma-mm 0.05`" in refused.value.remedy


def test_the_demos_own_cell_file_is_as_it_was(tmp_path):
    text = write_cell_file(tmp_path, "127.0.0.9", seed=1, time_factor=600).read_text()
    table = tomllib.loads(text)
    assert [robot["model"] for robot in table["robot"]] == ["fanuc_m6ib", "ur10e"]
    assert table["robot"][0]["name"] == "fanuc"
    assert table["gauge"][0]["anchor_in_base_mm"] == [900.0, -700.0, -450.0]
    assert table["gauge"][0]["range_m"] == 3.0
    assert table["robot"][0]["space"]["plane"][0]["point_in_base_mm"] == [0, 0, -900]
    assert "park_deg" not in table["fake"]
    assert describe_arms(tmp_path / "cell.toml") == {}


@pytest.mark.parametrize("kind", ["catalogue", "model file", "description"])
def test_a_cell_file_with_any_robot_is_played(tmp_path, kind):
    """From the name in the file, over the description that the service makes of it, to the fakes' arm."""
    model = load_model("yaskawa_gp25")
    files = {"model file": f"{tmp_path}/mine.toml", "description": f"{tmp_path}/mine.urdf?tip=flange"}
    robot = files.get(kind, "yaskawa_gp25")
    (tmp_path / "mine.urdf").write_text(bare_urdf(model))
    (tmp_path / "mine.toml").write_text(toml_of(model))
    arm = plan_demo_arm(robot)
    path = write_cell_file(tmp_path / "cell", "127.0.0.9", seed=1, time_factor=600, arm=arm)
    assert load_model(read_cell_file(path).robot_named("robot").model).joint_names == model.joint_names
    arms = write_described(tmp_path, describe_arms(path))
    cell = FakeCell.from_file(path, arms)
    seen = cell.world.arms["robot"]
    assert np.allclose(seen.joints_rad, arm.park_rad, atol=1e-5)
    joints = np.array([[0.2, 0.3, -0.4, 0.5, 0.6, 0.7]])
    assert np.abs(seen.believed_flange(joints) - model.base_flange(joints)).max() < 1e-9
    assert read_described_arms(arms)


def toml_of(model):
    """Return a model file of an arm, as people write one."""
    rows = model.dh.to_rows()
    columns = {
        "theta_deg": np.degrees(rows[:, 0]),
        "d_mm": rows[:, 1] * 1e3,
        "a_mm": rows[:, 2] * 1e3,
        "alpha_deg": np.degrees(rows[:, 3]),
        "lower_deg": np.degrees(model.lower_rad),
        "upper_deg": np.degrees(model.upper_rad),
        "sign": np.diag(model.joint_coupling).astype(int),
    }
    lines = [f"{key} = {values.tolist()}" for key, values in columns.items()]
    names = ", ".join(f'"{name}"' for name in model.joint_names)
    return "\n".join(
        ['title = "mine"', f"joints = [{names}]", 'dh_source = "x"', 'limits_source = "x"', *lines]
    )


def test_a_first_posture_outside_the_limits_is_refused(tmp_path):
    path = write_cell_file(
        tmp_path, "127.0.0.9", seed=1, time_factor=600, arm=plan_demo_arm("kuka_kr10_r1100_2")
    )
    text = path.read_text()
    start = text.index("[fake.park_deg]")
    path.write_text(text[:start] + "[fake.park_deg]\nrobot = [0, 400, 0, 0, 0, 0]\n")
    with pytest.raises(CalibrationError, match="park_deg"):
        describe_arms(path)


@pytest.mark.parametrize("name", ["abb_irb4400l_30_243", "nachi_mz07", "franka_fr3", "yaskawa_mpl80", "ur10"])
def test_any_chain_of_turning_joints_is_a_table(name):
    model = load_model(name)
    bare = RobotModel(
        name="bare", title="bare", dh=None, placements=model.placements, theta0_rad=model.theta0_rad,
        joint_coupling=model.joint_coupling, lower_rad=model.lower_rad, upper_rad=model.upper_rad,
        max_speed_rad_s=model.max_speed_rad_s, joint_names=model.joint_names,
    )  # fmt: skip
    moved = bare.with_twists(np.random.default_rng(1).normal(size=(model.axis_count + 1, 6)) * 0.01)
    joints = np.random.default_rng(2).uniform(-2, 2, (10, model.axis_count))
    for arm in (bare, moved):
        table = dh_of_chain(arm)
        rows = DhTable.from_rows(table.rows)
        again = RobotModel.from_dh(
            rows, base=table.base, flange=table.flange, name="again", joint_coupling=model.joint_coupling
        )
        assert np.abs(again.base_flange(joints) - arm.base_flange(joints)).max() < 1e-9


@pytest.mark.parametrize(
    "name", ["abb_irb1600_8_145", "aubo_i10", "fanuc_lrmate25_19a", "kuka_kr10r1420", "yaskawa_gp25"]
)
def test_an_arm_of_a_cell_file_finds_a_posture_to_begin_in(name: str, tmp_path: Path) -> None:
    """Short wrists: no wire is hooked to them, and none may keep them from standing anywhere."""
    cell = tmp_path / "cell.toml"
    cell.write_text(f'[[robot]]\nname = "arm"\ndriver = "yaskawa"\nmodel = "{name}"\n', encoding="utf-8")
    assert len(describe_arms(cell)["arm"]["park_deg"]) == 6  # type: ignore[arg-type]
