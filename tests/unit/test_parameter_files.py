"""Parameter sets in and out of files, by the commands that people type."""

import json

import numpy as np
import pytest
from cyclopts import App

from cellcal.calibration.arm.kinematics import load_model
from cellcal.calibration.arm.ur_factory import factory_model
from cellcal.calibration.arm.urdf import bare_urdf, read_urdf
from cellcal.calibration.errors import CalibrationError
from cellcal.service.cli.parameters import parameters
from cellcal.service.engineering.parameters.parameter_set import ParameterValue
from cellcal.service.engineering.parameters.parameter_sets import ParameterSets
from cellcal.service.engineering.parameters.ur_files import (
    RosKinematics,
    UrKinematics,
    model_of_ros,
    read_calibration_conf,
    read_primary_kinematics,
    read_ros_kinematics,
    ros_frames,
    write_calibration_conf,
    write_primary_kinematics,
    write_ros_kinematics,
)
from tests.unit.test_ur_factory import ABSOLUTE
from tests.unit.test_ur_files import DEFAULT_UR10E

UR = load_model("ur10e")
ARM = factory_model(UR, ABSOLUTE)
FACTORY = UrKinematics(ABSOLUTE, (1, 2, 3, 4, 5, 6), 2)
JOINTS = np.random.default_rng(0).uniform(-3, 3, (50, 6))


def arm_reach_m(model):
    return model.base_flange(JOINTS)


@pytest.fixture
def run_cli(tmp_path, capsys):
    app = App(name="cellcal", result_action="return_value")
    app.command(parameters)
    folder = tmp_path / "sets"

    def call_command(*words):
        capsys.readouterr()
        code = app(
            ["parameters", *map(str, words), "--folder", str(folder)], exit_on_error=False, print_error=False
        )
        assert code == 0
        return capsys.readouterr()

    call_command.folder = folder
    call_command.tmp = tmp_path
    return call_command


def write_text(path, content):
    path.write_bytes(content if isinstance(content, bytes) else content.encode())
    return path


def factory_imported(cli):
    conf = write_text(cli.tmp / "calibration.conf", write_calibration_conf(FACTORY, UR))
    cli("import", conf, "--robot", "ur10e", "--serial", "17", "--by", "Ada")


def identification_file(cli, **changes):
    found = [
        {"name": "J2 offset", "unit": "rad", "value": 2e-3, "sigma": 1e-5, "prior": 1e-2},
        {"name": "J3 a", "unit": "m", "value": -3e-4, "sigma": 2e-5, "prior": 1e-3},
        {"name": "J2 sag under link 2", "unit": "rad/m", "value": 1e-4, "sigma": 1e-5, "prior": 1e-3},
        {"name": "wire zero", "unit": "m", "value": 1e-3, "sigma": 1e-5, "prior": 1e-3},
    ]
    document = {"robot": "ur10e", "parameters": found, **changes}
    return write_text(cli.tmp / "found.json", json.dumps(document))


@pytest.mark.parametrize(
    "content",
    [
        write_calibration_conf(FACTORY, UR),
        write_primary_kinematics(FACTORY),
        write_ros_kinematics(RosKinematics(ros_frames(ARM), FACTORY.factory_hash)),
    ],
    ids=["calibration.conf", "primary interface", "ROS"],
)
@pytest.mark.parametrize("kind", ["calibration-conf", "primary", "ros-yaml", "urdf"])
def test_each_form_of_a_factory_table_goes_in_and_comes_out_in_each(run_cli, content, kind):
    run_cli(
        "import",
        write_text(run_cli.tmp / "file", content),
        "--robot",
        "ur10e",
        "--serial",
        "17",
        "--by",
        "Ada",
    )
    out = run_cli.tmp / "out"
    run_cli("export", "17", out, "--format", kind)
    back = {
        "calibration-conf": lambda: factory_model(UR, read_calibration_conf(out.read_text(), UR).table),
        "primary": lambda: factory_model(UR, read_primary_kinematics(out.read_bytes()).table),
        "ros-yaml": lambda: model_of_ros(read_ros_kinematics(out.read_text()), UR),
        "urdf": lambda: read_urdf(out.read_text(), tip_link="flange").model,
    }[kind]()
    assert np.allclose(arm_reach_m(back), arm_reach_m(ARM), rtol=0, atol=1e-10)


@pytest.mark.parametrize(
    ("change_m", "says"), [(0.0, ""), (1e-5, "its hash is not that of its numbers")], ids=["own", "changed"]
)
def test_a_ros_file_whose_numbers_were_changed_is_noticed_by_its_hash(run_cli, change_m, says):
    frames = ros_frames(ARM)
    frames[0, 2, 3] += change_m
    text = write_ros_kinematics(RosKinematics(frames, FACTORY.factory_hash))
    file = write_text(run_cli.tmp / "file", text)
    note = run_cli("import", file, "--robot", "ur10e", "--serial", "17", "--by", "Ada").err
    assert ("note:" in note) == bool(says)
    assert says in " ".join(note.split())


def test_a_ros_file_of_the_arm_as_drawn_needs_no_note(run_cli):
    file = write_text(run_cli.tmp / "file", DEFAULT_UR10E)
    assert "note:" not in run_cli("import", file, "--robot", "ur10e", "--serial", "17", "--by", "Ada").err


def test_an_identification_goes_in_with_its_uncertainties(run_cli):
    factory_imported(run_cli)
    run_cli(
        "import",
        identification_file(run_cli),
        "--robot",
        "ur10e",
        "--serial",
        "17",
        "--by",
        "Ada",
        "--note",
        "spring",
    )
    item = ParameterSets(run_cli.folder).load_set("17")
    assert item.version == 2
    assert item.find_value("J2 offset") == ParameterValue("J2 offset", "rad", 2e-3, 1e-5)
    assert item.find_value("wire zero") is None
    assert item.factory_hash == FACTORY.factory_hash
    assert item.source.startswith("identification: found.json, sha256 ")
    shown = json.loads(run_cli("show", "17", "--json").out)
    assert shown["note"] == "spring"
    assert {p["name"] for p in shown["parameters"]} == {"J2 offset", "J3 a", "J2 sag under link 2"}


def test_an_export_says_what_a_rigid_arm_cannot_hold(run_cli):
    run_cli("import", identification_file(run_cli), "--robot", "ur10e", "--serial", "17", "--by", "Ada")
    out = run_cli.tmp / "out.urdf"
    assert "J2 sag under link 2" in run_cli("export", "17", out).err
    errors = np.zeros((6, 5))
    errors[1, 0], errors[2, 2] = 2e-3, -3e-4
    found = read_urdf(out.read_text(), tip_link="flange").model
    assert np.allclose(arm_reach_m(found), arm_reach_m(UR.with_dh_errors(errors)), atol=1e-12)


def test_a_flange_that_a_table_cannot_hold_is_reported(run_cli):
    found = [{"name": "J6 beta", "unit": "rad", "value": 1e-3, "sigma": 1e-5, "prior": 1e-2}]
    file = identification_file(run_cli, parameters=found)
    run_cli("import", file, "--robot", "ur10e", "--serial", "17", "--by", "Ada")
    words = run_cli("export", "17", run_cli.tmp / "c.conf", "--format", "calibration-conf").err
    assert "put it into the tool" in words
    assert "0.05730" in words  # deg about y


def test_versions_are_listed_compared_and_restored(run_cli):
    factory_imported(run_cli)
    run_cli("import", identification_file(run_cli), "--robot", "ur10e", "--serial", "17", "--by", "Ada")
    changes = json.loads(run_cli("diff", "17", "--json").out)["changes"]
    offset = next(c for c in changes if c["name"] == "J2 offset")
    assert offset["after"] == 2e-3
    assert offset["difference"] == pytest.approx(2e-3 - offset["before"])
    run_cli("rollback", "17", "1", "--by", "Grace", "--note", "worse")
    listed = json.loads(run_cli("list", "17", "--json").out)["parameter_sets"]
    assert [item["version"] for item in listed] == [1, 2, 3]
    assert listed[2]["rolls_back_to"] == 1
    same = json.loads(run_cli("diff", "17", "--before", "1", "--after", "3", "--json").out)
    assert same["changes"] == []
    newest = json.loads(run_cli("list", "--json").out)["parameter_sets"]
    assert [(item["robot_serial"], item["version"]) for item in newest] == [("17", 3)]


def test_readable_tables_hold_millimetres_and_degrees(run_cli):
    run_cli("import", identification_file(run_cli), "--robot", "ur10e", "--serial", "17", "--by", "Ada")
    shown = run_cli("show", "17").out
    assert "+0.11459" in shown
    assert "-0.30000" in shown
    assert "17" in run_cli("list").out
    found = [{"name": "J3 a", "unit": "m", "value": 0.0, "sigma": 1e-5, "prior": 1e-3}]
    file = identification_file(run_cli, parameters=found)
    run_cli("import", file, "--robot", "ur10e", "--serial", "17", "--by", "Ada")
    assert "+0.30000" in run_cli("diff", "17").out


def test_a_set_is_exported_as_its_own_file(run_cli):
    run_cli("import", identification_file(run_cli), "--robot", "ur10e", "--serial", "17", "--by", "Ada")
    out = run_cli.tmp / "set.toml"
    run_cli("export", "17", out, "--format", "toml")
    run_cli("import", out, "--robot", "ur10e", "--serial", "18", "--by", "Grace")
    sets = ParameterSets(run_cli.folder)
    assert sets.load_set("18").values == sets.load_set("17").values
    assert "parameter set 17 version 1" in sets.load_set("18").source


def test_a_set_of_another_robot_is_noted(run_cli):
    run_cli("import", identification_file(run_cli), "--robot", "ur10e", "--serial", "17", "--by", "Ada")
    out = run_cli.tmp / "set.toml"
    run_cli("export", "17", out, "--format", "toml")
    assert "note:" not in run_cli("import", out, "--robot", "ur10e", "--serial", "17", "--by", "Ada").err
    said = run_cli("import", out, "--robot", "ur10e", "--serial", "18", "--by", "Ada").err
    assert "the file is of robot 17" in " ".join(said.split())


@pytest.mark.parametrize(
    ("content", "says"),
    [
        (b'MOC:CFG_1.0::\n#\nARM_CALIB:\n -name "rob1_1"\n', "an ABB controller"),
        ("&ACCESS RV\nDEFDAT $MACHINE PUBLIC\n;Länge\nENDDAT\n".encode("latin-1"), "a KUKA controller"),
        (b"[*SYSTEM*]$DMR_GRP  Storage: CMOS  Access: RW\n", "a FANUC controller"),
        (b"/CRC 1234\n///VERSION\nYAS 3.30-00\n", "a Yaskawa controller"),
        (b'<?xml version="1.0"?><robot name="a"/>', "a description"),
        (b'title = "mine"\njoints = ["J1"]\n', "a model file"),
        (b"J1,J2,X\n1,2,3\n", "no parameters of an arm in a form that is read"),
    ],
)
def test_files_of_other_controllers_are_called_what_they_are(run_cli, content, says):
    file = write_text(run_cli.tmp / "file", content)
    with pytest.raises(CalibrationError, match=says):
        run_cli("import", file, "--robot", "abb_irb120", "--serial", "17", "--by", "Ada")


def test_kinematics_of_another_arm_are_refused(run_cli):
    factory_imported(run_cli)
    foreign = RosKinematics(ros_frames(UR), UrKinematics(UR.dh).factory_hash)
    file = write_text(run_cli.tmp / "other.yaml", write_ros_kinematics(foreign))
    with pytest.raises(CalibrationError, match="another arm"):
        run_cli("import", file, "--robot", "ur10e", "--serial", "17", "--by", "Ada")
    assert len(ParameterSets(run_cli.folder).load_history("17")) == 1


def test_a_table_that_is_not_linearised_is_reported(run_cli):
    doubtful = UrKinematics(ABSOLUTE, (), 1)
    conf = write_text(run_cli.tmp / "c.conf", write_calibration_conf(doubtful, UR))
    assert (
        "not linearised" in run_cli("import", conf, "--robot", "ur10e", "--serial", "17", "--by", "Ada").err
    )


def test_a_description_keeps_everything_but_the_joints(run_cli):
    template = bare_urdf(UR).replace('<link name="link_2" />', '<link name="link_2"><!-- mesh --></link>')
    # Frames that lie elsewhere on the same axes, as ROS has them.
    shifted = RosKinematics(ros_frames(UR), "calib_0")
    factory_imported(run_cli)
    file = write_text(run_cli.tmp / "arm.urdf", _ros_description(shifted))
    run_cli("export", "17", run_cli.tmp / "a.urdf", "--template", file, "--tip-link", "tool0")
    found = read_urdf((run_cli.tmp / "a.urdf").read_text(), tip_link="tool0").model
    assert np.allclose(arm_reach_m(found), arm_reach_m(ARM), rtol=0, atol=1e-9)
    plain = write_text(run_cli.tmp / "bare.urdf", template)
    run_cli("export", "17", run_cli.tmp / "b.urdf", "--template", plain)
    assert np.allclose(
        arm_reach_m(read_urdf((run_cli.tmp / "b.urdf").read_text(), tip_link="flange").model),
        arm_reach_m(ARM),
    )


def _ros_description(kinematics):
    from cellcal.calibration.orientation import values_from

    lines = ['<robot name="arm"><link name="base"/>']
    parent = "base"
    for i, (name, frame) in enumerate(zip(UR.joint_names, kinematics.frames, strict=True)):
        child = f"l{i}"
        xyz = " ".join(map(repr, frame[:3, 3].tolist()))
        rpy = " ".join(map(repr, values_from("ros_rpy", frame[:3, :3]).tolist()))
        lines.append(
            f'<link name="{child}"/><joint name="{name}" type="revolute"><parent link="{parent}"/>'
            f'<child link="{child}"/><origin xyz="{xyz}" rpy="{rpy}"/><axis xyz="0 0 1"/>'
            '<limit lower="-6" upper="6" velocity="1" effort="0"/></joint>'
        )
        parent = child
    lines.append(
        f'<link name="tool0"/><joint name="end" type="fixed"><parent link="{parent}"/><child link="tool0"/></joint>'
    )
    return "".join([*lines, "</robot>"])


def test_a_description_may_begin_elsewhere_than_at_the_base_of_the_robot(run_cli):
    factory_imported(run_cli)
    on_table = bare_urdf(UR).replace(
        '<link name="base" />',
        '<link name="table"/><link name="base"/><joint name="bolts" type="fixed"><parent link="table"/>'
        '<child link="base"/><origin xyz="1 2 0.8" rpy="0 0 0.5"/></joint>',
        1,
    )
    file = write_text(run_cli.tmp / "cell.urdf", on_table)
    with pytest.raises(CalibrationError, match="not where those of ur10e are") as refused:
        run_cli("export", "17", run_cli.tmp / "a.urdf", "--template", file)
    assert "--base-link" in refused.value.remedy
    run_cli("export", "17", run_cli.tmp / "a.urdf", "--template", file, "--base-link", "base")
    text = (run_cli.tmp / "a.urdf").read_text()
    found = read_urdf(text, base_link="base", tip_link="flange").model
    assert np.allclose(arm_reach_m(found), arm_reach_m(ARM), rtol=0, atol=1e-9)
    bolts = found.placements[0] @ np.linalg.inv(read_urdf(text, tip_link="flange").model.placements[0])
    np.testing.assert_allclose(np.linalg.inv(bolts)[:3, 3], [1, 2, 0.8], atol=1e-12)


def test_a_description_of_another_robot_is_refused(run_cli):
    factory_imported(run_cli)
    file = write_text(run_cli.tmp / "other.urdf", bare_urdf(load_model("ur5e")))
    with pytest.raises(CalibrationError, match="not where"):
        run_cli("export", "17", run_cli.tmp / "a.urdf", "--template", file)
    assert not (run_cli.tmp / "a.urdf").exists()


def test_an_impossible_export_is_refused_before_anything_is_written(run_cli):
    run_cli("import", identification_file(run_cli), "--robot", "ur10e", "--serial", "17", "--by", "Ada")
    taken = write_text(run_cli.tmp / "taken", "mine")
    for words, match in (
        (("export", "17", taken), "there already"),
        (("export", "17", run_cli.tmp / "x", "--format", "docx"), "no format"),
        (("export", "17", run_cli.tmp / "x", "--format", "ros-yaml"), "calibration.conf first"),
        (("import", run_cli.tmp / "nothing", "--robot", "ur10e", "--serial", "17", "--by", "Ada"), "no file"),
        (("import", taken, "--robot", "ur10e", "--serial", "17", "--by", "Ada"), "no parameters of an arm"),
        (
            ("import", identification_file(run_cli), "--robot", "ur5e", "--serial", "17", "--by", "Ada"),
            "not of a ur5e",
        ),
        (("show", "99"), "no parameter sets"),
    ):
        with pytest.raises(CalibrationError, match=match):
            run_cli(*words)
    assert taken.read_text() == "mine"
    assert not (run_cli.tmp / "x").exists()


def test_a_makers_form_is_for_the_makers_arms(run_cli):
    found = [{"name": "J2 offset", "unit": "rad", "value": 1e-3, "sigma": 1e-5, "prior": 1e-2}]
    file = identification_file(run_cli, robot="fanuc_m6ib", parameters=found)
    run_cli("import", file, "--robot", "fanuc_m6ib", "--serial", "F1", "--by", "Ada")
    with pytest.raises(CalibrationError, match="Universal Robots"):
        run_cli("export", "F1", run_cli.tmp / "x", "--format", "calibration-conf")
    with pytest.raises(CalibrationError, match="couples"):
        run_cli("export", "F1", run_cli.tmp / "x")
    run_cli("export", "F1", run_cli.tmp / "x", "--geometric-joints")
    model = load_model("fanuc_m6ib")
    errors = np.zeros((6, 5))
    errors[1, 0] = 1e-3
    geometric = JOINTS @ model.joint_coupling.T
    written_arm = read_urdf((run_cli.tmp / "x").read_text(), tip_link="flange").model
    assert np.allclose(
        written_arm.base_flange(geometric), arm_reach_m(model.with_dh_errors(errors)), atol=1e-12
    )
