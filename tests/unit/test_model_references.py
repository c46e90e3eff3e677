"""Robots by reference: names, model files, descriptions; and every bad description in one sentence with a cure."""

import json
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from cellcal.calibration.arm.kinematics import load_model
from cellcal.calibration.arm.model_references import fixed_reference, is_known_model, parse_reference
from cellcal.calibration.arm.model_scale import DESCRIPTION_UNITS, MODEL_FILE_UNITS, refuse_wrong_units
from cellcal.calibration.arm.mounting import mounted_name
from cellcal.calibration.arm.robot_models.catalogue_index import catalogue_entries
from cellcal.calibration.arm.urdf import bare_urdf
from cellcal.calibration.errors import CalibrationError
from cellcal.service.cli.app import run_command_line
from cellcal.service.configuration.cell_file import ConfigError, read_cell_file

URDF = """<robot name="gantry">
<link name="world"/><link name="carriage"/><link name="arm"/><link name="flange"/><link name="camera"/>
<joint name="rail" type="prismatic"><origin xyz="0.1 0 0.5"/><parent link="world"/><child link="carriage"/>
  <axis xyz="0 1 0"/><limit lower="-0.5" upper="2" velocity="0.4" effort="0"/></joint>
<joint name="turn" type="revolute"><origin xyz="0 0 0.3" rpy="0.2 0 0"/><parent link="carriage"/><child link="arm"/>
  <axis xyz="0 0 1"/><limit lower="-2" upper="2" velocity="1" effort="0"/></joint>
<joint name="mount" type="fixed"><origin xyz="0.4 0 0"/><parent link="arm"/><child link="flange"/></joint>
<joint name="eye" type="fixed"><origin xyz="0 0.1 0"/><parent link="arm"/><child link="camera"/></joint>
</robot>"""
TOML = """title = "track and two bars"
joints = ["track", "a", "b"]
joint_types = ["prismatic", "revolute", "continuous"]
dh_source = "here"
theta_deg = [90, 0, 0]
d_mm = [100, 0, 50]
a_mm = [0, 300, 200]
alpha_deg = [90, 0, 0]
base = {xyz_mm = [0, 0, 10], rpy_deg = [0, 90, 0]}
flange = {xyz_mm = [0, 0, 20], rpy_deg = [180, 0, 0]}
limits_source = "here"
lower = [-1000, -90, -180]
upper = [3000, 90, 180]
"""


@pytest.fixture
def urdf(tmp_path):
    path = tmp_path / "gantry.urdf"
    path.write_text(URDF)
    return path


def test_a_description_is_named_with_its_tip(urdf):
    model = load_model(f"{urdf}?tip=flange&base=world")
    assert model.kinds == ("prismatic", "revolute")
    assert np.allclose(model.lower_rad, (-0.5, -2))
    assert np.allclose(model.max_speed_rad_s, (0.4, 1))
    turned = model.base_flange(np.array([[0.7, 0.0]]))[0]
    assert np.allclose(turned[:3, 3], (0.1 + 0.4, 0.7, 0.8))
    assert np.allclose(load_model(f"{urdf}?tip=flange,base=world").placements, model.placements)


def test_a_sliding_joint_has_its_derivatives(urdf):
    model = load_model(f"{urdf}?tip=flange")
    joints = np.array([[0.3, 0.4], [1.0, -0.7]])
    tip = np.array([0.05, 0.02, 0.1])
    places, slopes = model.tip_jacobian(joints, tip)
    _, whole = model.flange_jacobian(joints)
    for i in range(2):
        more = joints.copy()
        more[:, i] += 1e-6
        assert np.allclose((model.tip_positions(more, tip) - places) / 1e-6, slopes[:, :, i], atol=1e-6)
    assert np.allclose(whole[:, 3:, 0], 0)
    assert np.allclose(whole[:, :3, 0], (0, 1, 0))


def test_a_model_file_states_joints_that_slide_base_and_flange(tmp_path):
    path = tmp_path / "track.toml"
    path.write_text(TOML)
    model = load_model(str(path))
    assert model.dh is None
    assert np.allclose(model.upper_rad, (3, np.pi / 2, np.pi))
    assert np.allclose(model.max_speed_rad_s, (0.1, 1, 1))  # not stated: slow
    places = model.base_flange(np.array([[0.0, 0, 0], [1.5, 0, 0]]))[:, :3, 3]
    assert np.allclose(places[1] - places[0], (1.5, 0, 0))
    base = np.array([[0, 0, 1, 0], [0, 1, 0, 0], [-1, 0, 0, 0.01], [0, 0, 0, 1.0]])
    row = base @ np.array([[0, 0, 1, 0], [1, 0, 0, 0], [0, 1, 0, 0.1], [0, 0, 0, 1.0]])
    far = row @ np.array([0.5, 0, 0.05 + 0.02, 1.0])
    assert np.allclose(places[0], far[:3])


@pytest.mark.parametrize(
    ("old", "new", "says"),
    [
        ("lower = [", "lower_deg = [", "cannot hold a joint that slides"),
        ('"prismatic"', '"sliding"', "joint_types needs 3"),
        ("rpy_deg = [0, 90, 0]", "rpy = [0, 90, 0]", "base has xyz_mm and rpy_deg"),
        ("xyz_mm = [0, 0, 20]", "xyz_mm = [0, 0]", "xyz_mm needs 3 finite numbers"),
        ("upper = [3000,", "upper = [-3000,", "lower limits below upper"),
        ("upper = ", "speed = [1, 2, 3]\nupper = ", "speed_source"),
        ('title = "', 'colour = "', "unknown"),
        ('"track", "a"', '"a", "a"', "no name twice"),
        ('"track", "a"', '"track", 2', "no name twice"),
        ('"track", "a"', '"track", " "', "no name twice"),
        ("theta_deg = [90,", "theta_deg = [1.5708,", "theta_deg holds 1.5708"),
        ("upper = ", 'interaction_source = "x"\ninteraction = [[3, 2]]\nupper = ', "[DH angle, joint, factor]"),
        ("alpha_deg = [90,", "alpha_deg = [1.5708,", "alpha_deg holds 1.5708"),
        ("[3000, 90, 180]", "[3000000, 90, 180]", "'track' slides to 3000 m"),
        ("upper = ", "combined_limits = [{weights = [1, 1, 0], lower_deg = 0, upper_deg = 9}]\nupper = ", "turn"),
        ("upper = ", "combined_limits = [{weights = [0, 1, 1], lower_deg = 9, upper_deg = 0}]\nupper = ", "lower"),
    ],
)  # fmt: skip
def test_a_wrong_model_file_is_refused(tmp_path, old, new, says):
    assert old in TOML
    path = tmp_path / "track.toml"
    path.write_text(TOML.replace(old, new, 1))
    with pytest.raises(CalibrationError, match=re.escape(says)):
        load_model(str(path))


BAD = {
    "prismatic as revolute": (
        'type="prismatic"><origin xyz="0.1 0 0.5"/><parent link="world"/><child link="carriage"/>\n'
        '  <axis xyz="0 1 0"/><limit lower="-0.5" upper="2"',
        'type="revolute"><origin xyz="0.1 0 0.5"/><parent link="world"/><child link="carriage"/>\n'
        '  <axis xyz="0 1 0"/><limit lower="-500" upper="2000"',
        "'rail' is revolute and turns to 2000 rad",
        "prismatic",
    ),
    "millimetres": ('lower="-0.5" upper="2"', 'lower="-500" upper="2000"', "slides by 2000 m", "metres"),
    "mimic": ('<axis xyz="0 0 1"/>', '<axis xyz="0 0 1"/><mimic joint="rail"/>', "mimics", "equivalent chain"),
    "axis not unit": ('<axis xyz="0 0 1"/>', '<axis xyz="0 0 2"/>', "'turn' is 2 long", "length of one"),
    "axis of nothing": ('<axis xyz="0 0 1"/>', '<axis xyz="0 0 0"/>', "'turn' is 0 long", "length of one"),
    "axis of two": ('<axis xyz="0 0 1"/>', '<axis xyz="0 1"/>', "axis of joint 'turn' is '0 1'", "Correct"),
    "reversed": ('lower="-2" upper="2"', 'lower="2" upper="-2"', "limits of joint 'turn' are reversed", "Exchange"),
    "no limits": ('<limit lower="-2" upper="2" velocity="1" effort="0"/>', "", "'turn' has no range", "continuous"),
    "not finite": ('lower="-2"', 'lower="nan"', "lower of joint 'turn' is 'nan'", "Correct"),
    "digits that only Python reads": ('xyz="0 0 0.3"', 'xyz="0 0 0_3"', "'0 0 0_3', not 3 finite numbers", "Correct"),
    "joint on itself": ('<parent link="carriage"/><child link="arm"/>', '<parent link="arm"/><child link="arm"/>',
                        "'turn' hangs on itself", "<parent>"),
    "twice": ('name="turn"', 'name="rail"', "2 joints of the description are called 'rail'", "name of its own"),
    "link twice": ('<link name="camera"/>', '<link name="arm"/>', "2 links", "name of its own"),
    "no such link": ('<child link="arm"/>', '<child link="harm"/>', "names the link 'harm'", "Correct the name"),
    "two parents": ('<child link="camera"/>', '<child link="flange"/>', "hangs on two joints", "tree"),
    "ball": ('type="revolute"', 'type="floating"', "'turn' on the way is of type 'floating'", "revolute"),
    "xacro": ('<link name="camera"/>', '<link name="camera"/><x:macro xmlns:x="http://wiki.ros.org/xacro"/>',
              "xacro that is not expanded", "Expand"),
    "xacro without its namespace": ('<link name="camera"/>', '<link name="camera"/><xacro:arm/>', "not expanded", "Expand"),
    "xacro in a number": ('xyz="0 0 0.3"', 'xyz="0 0 ${h}"', "'0 0 ${h}', not 3 finite numbers", "Expand the xacro"),
    "namespace": ('<robot name="gantry">', '<robot name="gantry" xmlns="http://x">', "root element", "Take xmlns"),
    "rpy in degrees": ('rpy="0.2 0 0"', 'rpy="90 0 0"', "'turn' turns by 90 rad", "radians"),
    "rpy and quaternion": ('rpy="0.2 0 0"', 'rpy="0 0 0" quat_xyzw="0 0 0 1"', "rpy and quat_xyzw", "Leave one"),
    "quaternion not unit": ('rpy="0.2 0 0"', 'quat_xyzw="0 0 0 2"', "'turn' is 2 long", "unit quaternion"),
    "misspelt place": ('<origin xyz="0 0 0.3"', '<origin xzy="0 0 0.3"', "states 'xzy'", "xyz or rpy"),
    "place twice": ('<origin xyz="0 0 0.3"', '<origin xyz="9 0 0"/><origin xyz="0 0 0.3"', "2 elements called origin", "right"),
    "axis twice": ('<axis xyz="0 0 1"/>', '<axis xyz="1 0 0"/><axis xyz="0 0 1"/>', "2 elements called axis", "right"),
    "misspelt axis": ('<axis xyz="0 0 1"/>', '<axes xyz="0 0 1"/>', "states 'axes'", "Did you mean axis?"),
    "misspelt origin": ('<origin xyz="0 0 0.3" rpy', '<Origin xyz="0 0 0.3" rpy', "states 'Origin'", "Did you mean origin?"),
    "misspelt limit": ('lower="-0.5" upper="2"', 'lower="-0.5" uper="2"', "states 'uper'", "Did you mean upper?"),
    "arm in millimetres": ('xyz="0.4 0 0"', 'xyz="400 0 0"', "the arm is 400.3 m long", "in metres"),
    "base in millimetres": ('xyz="0.1 0 0.5"', 'xyz="100 0 500"', "first joint 509.902 m from its base", "in metres"),
    "stroke in millimetres": ('lower="-0.5" upper="2"', 'lower="0" upper="150"', "'rail' slides to 150 m", "in metres"),
    "ring": ('<parent link="world"/>', '<parent link="flange"/>', "form a ring", "hang on nothing"),
    "other document": ('<robot name="gantry">', '<model name="gantry">', "not a robot description", ""),
}  # fmt: skip


@pytest.mark.parametrize("case", BAD)
def test_a_bad_description_is_one_sentence_with_its_cure(tmp_path, case, capsys):
    old, new, says, cure = BAD[case]
    assert old in URDF
    path = tmp_path / "bad.urdf"
    path.write_text(URDF.replace(old, new, 1))
    with pytest.raises(CalibrationError) as refused:
        load_model(f"{path}?tip=flange")
    assert says in refused.value.message
    assert cure in refused.value.remedy
    assert refused.value.message.startswith("bad.urdf: ")
    assert run_command_line(["models", f"{path}?tip=flange"]) != 0
    output = capsys.readouterr()
    assert output.out == ""
    assert "Traceback" not in output.err


def test_a_turn_as_a_quaternion_is_the_same_as_by_angles(tmp_path):
    path = tmp_path / "quaternion.urdf"
    stated = f'quat_xyzw="{np.sin(0.1):.17g} 0 0 {np.cos(0.1):.17g}"'
    path.write_text(URDF.replace('rpy="0.2 0 0"', stated))
    arm = load_model(f"{path}?tip=flange")
    path.write_text(URDF)
    np.testing.assert_allclose(arm.placements, load_model(f"{path}?tip=flange").placements, atol=1e-12)


def test_an_arm_in_wrong_units_is_refused_and_every_shipped_one_is_right():
    for entry in catalogue_entries():
        if not entry.withheld:
            model = load_model(entry.name)
            refuse_wrong_units(model, MODEL_FILE_UNITS)
            refuse_wrong_units(model, DESCRIPTION_UNITS)
    ur = load_model("ur10e")
    small = ur.placements.copy()
    small[:, :3, 3] *= 1e-3
    with pytest.raises(CalibrationError, match="mm long"):
        refuse_wrong_units(replace(ur, placements=small), MODEL_FILE_UNITS)
    for factor, says in ((np.degrees(1), "half of them"), (np.radians(1), "no joint turns further than")):
        wrong = replace(ur, lower_rad=ur.lower_rad * factor, upper_rad=ur.upper_rad * factor)
        with pytest.raises(CalibrationError, match=says):
            refuse_wrong_units(wrong, DESCRIPTION_UNITS)


@pytest.mark.parametrize(
    ("asked", "says", "cure"),
    [
        ("?tip=flangee", "no link 'flangee' for the tip", "Did you mean flange?"),
        ("?tip=flange&base=wrld", "no link 'wrld' for the base", "Did you mean world?"),
        ("", "none is named as the flange", "?tip=LINK, one of flange, camera"),
        ("?tip=world&base=arm", "does not hang on", "Exchange them: ?base=world&tip=arm."),
        (
            "?tip=camera&base=flange",
            "does not hang on",
            "on the way from the root to the tip: world, carriage, arm.",
        ),
        ("?tip=flange&base=arm", "no joint moves", "base and its flange"),
        ("?top=flange", "'top=flange'", "in quotes"),
        ("?tip=flange&tip=arm", "'tip=arm'", "in quotes"),
    ],
)
def test_a_wrong_question_is_answered_with_names(urdf, asked, says, cure):
    with pytest.raises(CalibrationError) as refused:
        load_model(f"{urdf}{asked}")
    assert says in refused.value.message
    assert cure in refused.value.remedy


_LOOP = (
    '<robot name="x"><link name="a"/><link name="b"/>'
    '<joint name="out" type="fixed"><parent link="a"/><child link="b"/></joint>'
    '<joint name="back" type="fixed"><parent link="b"/><child link="a"/></joint></robot>'
)


@pytest.mark.parametrize(
    ("text", "says", "cure"),
    [
        ("", "the file is empty", "xacro FILE.xacro > arm.urdf"),
        (" \n\n", "the file is empty", "xacro FILE.xacro > arm.urdf"),
        ('<robot name="x"/>', "has no links", "every <link> and <joint>"),
        (_LOOP, "each hangs on a joint, out, back", "leads back to the base"),
        (_LOOP.replace('"back"', '"$(arg prefix)back"'), "xacro that is not expanded", "Expand it first"),
        (_LOOP.replace('link="b"', 'link="${prefix}b"'), "xacro that is not expanded", "Expand it first"),
    ],
)
def test_a_description_without_an_arm_is_refused_in_words(tmp_path, text, says, cure):
    path = tmp_path / "arm.urdf"
    path.write_text(text, encoding="utf-8")
    for question in ("", "?base=a&tip=b"):
        with pytest.raises(CalibrationError) as refused:
            load_model(f"{path}{question}")
        assert says in refused.value.message
        assert cure in refused.value.remedy


def test_a_file_that_is_not_there_is_named(tmp_path):
    with pytest.raises(CalibrationError, match=r"none\.urdf cannot be read"):
        load_model(f"{tmp_path}/none.urdf?tip=a")
    with pytest.raises(CalibrationError, match="states its own base and flange"):
        load_model("any.toml?tip=a")


def test_a_changed_file_is_another_robot(urdf):
    name = load_model(f"{urdf}?tip=flange").name
    assert load_model(name).name == name
    urdf.write_text(URDF.replace('xyz="0.4 0 0"', 'xyz="0.41 0 0"'))
    with pytest.raises(CalibrationError, match="another file than the one that was used before") as refused:
        load_model(name)
    assert "calibrate again" in refused.value.remedy
    assert not is_known_model(name)


def test_a_reference_means_the_same_from_any_folder(urdf, monkeypatch, tmp_path):
    fixed = fixed_reference("gantry.urdf?tip=flange", urdf.parent)
    (tmp_path / "elsewhere").mkdir()
    monkeypatch.chdir(tmp_path / "elsewhere")
    assert load_model(fixed).axis_count == 2
    assert fixed_reference("ur10e", urdf.parent) == "ur10e"


def test_a_mounting_stands_behind_everything(urdf, tmp_path):
    folder = tmp_path / "a@b"
    folder.mkdir()
    file = folder / "gantry.urdf"
    file.write_text(URDF)
    assert parse_reference(str(file)).mounting == ""
    hanging = load_model(mounted_name(f"{file}?tip=flange", "ceiling"))
    assert hanging.gravity_in_base == (0, 0, 1)
    assert load_model(hanging.name).gravity_in_base == (0, 0, 1)
    assert load_model("fanuc_crx10ia@ceiling").gravity_in_base == (0, 0, 1)
    with pytest.raises(CalibrationError, match="no mounting"):
        load_model(f"{file}?tip=flange@shelf")


CELL = """[cell]
name = "c"
data_dir = "data"
[[robot]]
name = "arm"
driver = "modbus_robot"
profile = "fanuc_hmi"
address = "127.0.0.1"
port = 502
speed_limit_rad_s = 0.3
model = "{model}"
serial = "1"
"""


def cell_of(tmp_path, model):
    path = tmp_path / "cell.toml"
    path.write_text(CELL.format(model=model))
    return path


def test_a_cell_file_takes_a_description_beside_it(tmp_path, monkeypatch):
    shipped = load_model("ur10e")
    (tmp_path / "own.urdf").write_text(bare_urdf(shipped))
    path = cell_of(tmp_path, "own.urdf")
    monkeypatch.chdir("/")
    model = read_cell_file(path).robots[0].model
    own, joints = load_model(model), np.full((1, 6), 0.3)
    assert np.allclose(own.base_flange(joints), shipped.base_flange(joints), atol=1e-9)
    assert parse_reference(model).sha256 is not None


def test_a_cell_file_takes_a_robot_of_the_catalogue(tmp_path):
    assert read_cell_file(cell_of(tmp_path, "staubli_tx2_90l")).robots[0].model == "staubli_tx2_90l"


@pytest.mark.parametrize(
    ("model", "says"),
    [
        ("gantry.urdf?tip=nose", "no link 'nose'"),
        ("nothing.urdf?tip=a", "cannot be read"),
        ("jaka_a5", "states no licence"),
        ("staubli_tx2_9ol", "Did you mean staubli_tx2_90l?"),
    ],
)
def test_a_cell_file_says_what_is_wrong_with_its_robot(urdf, tmp_path, model, says):
    with pytest.raises(ConfigError) as refused:
        read_cell_file(cell_of(tmp_path, model))
    assert says in str(refused.value)


def test_the_commands_take_descriptions(urdf, capsys):
    assert run_command_line(["models", f"{urdf}?tip=flange", "--json"]) == 0
    (one,) = json.loads(capsys.readouterr().out)["models"]
    assert [joint["unit"] for joint in one["joints"]] == ["mm", "deg"]
    assert one["joints"][0]["limits"] == [-500.0, 2000.0]


def test_the_folders_and_the_digest_of_a_file_stand_in_no_sentence(urdf):
    model = load_model(f"{urdf}?tip=flange")
    assert model.label == "gantry.urdf?tip=flange"
    assert load_model(f"{urdf}?tip=flange@wall").label == "gantry.urdf?tip=flange@wall"
    assert load_model("fanuc_crx10ia?tip=flange@wall").label == "fanuc_crx10ia?tip=flange@wall"
    assert str(urdf.parent) not in bare_urdf(model)
    with pytest.raises(CalibrationError, match=r"^gantry\.urdf\?tip=flange: joints must be"):
        model.base_flange(np.zeros((2, 9)))


def test_sentences_take_the_label_of_a_model():
    raw = re.compile(
        r"model_name=(?:\w+\.)*(?:model|nominal)\.name\b|\{(?:\w+\.)*(?:model|nominal)\.name\}[^_`]"
    )
    for package in ("calibration", "drivers", "procedures", "service"):
        for file in sorted((Path(__file__).parents[2] / package).rglob("*.py")):
            # No sentence: the --robot of a command line, which is to be typed again.
            lines = [line for line in file.read_text(encoding="utf-8").splitlines() if "--robot" not in line]
            assert not raw.search("\n".join(lines)), file.name


@pytest.mark.parametrize(
    ("written", "name"),
    [
        ("RS 7L", "kawasaki_rs007l"),
        ("IRB 120", "abb_irb120"),
        ("KR 210 R2700-2", "kuka_kr210_r2700_2"),
        ("TX2-90L", "staubli_tx2_90l"),
        ("UR10e@ceiling", "ur10e@ceiling"),
        ("fr3", "franka_fr3"),
    ],
)
def test_a_robot_is_loaded_by_its_title_in_any_spelling(written: str, name: str) -> None:
    assert load_model(written).name == name
    assert fixed_reference(written, Path()) == name


@pytest.mark.parametrize("written", ["7", "kr 210", "irb", "GP", "RS", "10"])
def test_words_that_could_mean_several_robots_load_none(written: str) -> None:
    with pytest.raises(CalibrationError, match="no robot model"):
        load_model(written)


@pytest.mark.parametrize("written", ["YuMi", "IRB 14000", "irb14050"])
def test_arms_on_one_body_are_answered_with_what_helps(written: str) -> None:
    with pytest.raises(CalibrationError, match="do not ship") as refused:
        load_model(written)
    assert "layout with two robots" in refused.value.remedy
