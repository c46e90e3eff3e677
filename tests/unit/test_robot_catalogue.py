"""The catalogue: every robot against its source's joints, its DH rows, and Pinocchio on what we export of it."""

import importlib.util
import json
import zlib
from types import SimpleNamespace

import numpy as np
import pinocchio as pin
import pytest

from cellcal.calibration.arm.joint_kinds import beyond_limits
from cellcal.calibration.arm.kinematics import load_model, model_names
from cellcal.calibration.arm.model_references import model_of_text
from cellcal.calibration.arm.robot_models import known_names
from cellcal.calibration.arm.robot_models.catalogue_index import (
    catalogue_entries,
    catalogue_robot,
    find_robots,
    is_called,
    nearest_names,
    usable_names,
)
from cellcal.calibration.arm.robot_models.common_names import COMMON_NAMES, SOLD_AS
from cellcal.calibration.arm.robot_models.model_text import model_of_data
from cellcal.calibration.arm.robot_models.shipped_models import model_text
from cellcal.calibration.arm.urdf import bare_urdf, read_urdf
from cellcal.calibration.errors import CalibrationError
from cellcal.service.cli.app import app, run_command_line
from cellcal.service.cli.model_argument import complete_robot
from tests.unit.helpers.robot_tables import FOLDER, flange_by_joints, flange_by_rows, tables, withheld

OWN = {"abb_irb120": "abb_irb120_3_58", "kuka_kr6_r900": "kuka_kr6_r900_sixx"}
OWN |= {name: f"universal_robots_{name}" for name in model_names() if name.startswith("ur")}
NAMES = sorted(usable_names())
POSTURES = 20


def table_of(name):
    return tables()[OWN.get(name, name)]


def joints_of(model, seed):
    return np.random.default_rng(seed).uniform(model.lower_rad, model.upper_rad, (POSTURES, model.axis_count))


def seed_of(name):
    return zlib.crc32(name.encode())


def test_the_catalogue_is_as_large_as_its_tables_allow():
    makers = {entry.maker for entry in catalogue_entries() if entry.usable}
    assert len(NAMES) >= 330
    assert len(makers) >= 18
    assert {OWN.get(name, name) for name in NAMES} == tables().keys() - withheld().keys()
    assert set(model_names()) <= set(NAMES) == known_names()


def test_the_catalogue_that_ships_is_what_its_tables_make(tmp_path, monkeypatch):
    place = FOLDER / "build.py"
    spec = importlib.util.spec_from_file_location("build_robot_catalogue", place)
    build = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(build)
    shipped = build.CATALOGUE
    monkeypatch.setattr(build, "CATALOGUE", tmp_path)
    build.main()
    made = {path.name: path.read_text(encoding="utf-8") for path in tmp_path.iterdir()}
    assert made == {path.name: path.read_text(encoding="utf-8") for path in shipped.glob("*.json")}


def test_every_robot_is_where_the_joints_of_its_source_put_it():
    apart = {}
    for name in NAMES:
        joints = joints_of(load_model(name), seed_of(name))
        ours = load_model(name).base_flange(joints)
        apart[name] = np.abs(ours - flange_by_joints(table_of(name), joints)).max()
    assert not {name: far for name, far in apart.items() if not far < 1e-9}


def test_every_robot_is_where_its_dh_rows_put_it():
    apart = {}
    for name in NAMES:
        joints = joints_of(load_model(name), seed_of(name) + 1)
        ours = load_model(name).base_flange(joints)
        apart[name] = np.abs(ours - flange_by_rows(table_of(name), joints)).max()
    assert not {name: far for name, far in apart.items() if not far < 1e-9}


def test_pinocchio_reads_every_exported_robot_alike():
    apart = {}
    for name in NAMES:
        model = load_model(name)
        joints = joints_of(model, seed_of(name) + 2)
        apart[name] = np.abs(model.base_flange(joints) - by_pinocchio(model, joints)).max()
    assert not {name: far for name, far in apart.items() if not far < 1e-9}


def by_pinocchio(model, joints):
    """Return the flange (N, 4, 4) that Pinocchio finds in our description of a model."""
    text = bare_urdf(model, geometric_joints=True)
    arm = pin.buildModelFromXML(text)
    data = arm.createData()
    driven = joints @ model.joint_coupling.T if "joint_coupling @" in text else joints
    found = []
    for row in driven:
        q = pin.neutral(arm)
        for joint, value in zip(model.joint_names, row, strict=True):
            k = arm.getJointId(joint)
            i, wide = arm.idx_qs[k], arm.nqs[k]
            q[i : i + wide] = [value] if wide == 1 else [np.cos(value), np.sin(value)]
        pin.framesForwardKinematics(arm, data, q)
        found.append(data.oMf[arm.getFrameId("flange")].homogeneous.copy())
    return np.array(found)


@pytest.mark.parametrize("name", ["denso_hsr065a1_n32", "comau_ns16hand", "franka_fr3", "fanuc_crx10ia"])
def test_our_own_reader_reads_exported_robots_alike(name):
    model = load_model(name)
    joints = joints_of(model, 4)
    again = read_urdf(bare_urdf(model, geometric_joints=True)).model
    driven = joints @ model.joint_coupling.T if model.combined_limits else joints
    assert np.abs(again.base_flange(driven) - model.base_flange(joints)).max() < 1e-12
    assert again.kinds == model.kinds


@pytest.mark.parametrize("name", model_names())
def test_robots_with_a_file_of_their_own_are_those_of_the_catalogue(name):
    """To the micrometre: the catalogue was read from descriptions, the file from the maker's own documents."""
    model, listed = load_model(name), model_of_text(name, model_of_data(name, catalogue_robot(name)))
    joints = joints_of(model, 7)
    assert np.abs(model.base_flange(joints) - listed.base_flange(joints)).max() < 1e-6
    assert np.abs(model.joint_coupling - listed.joint_coupling).max() == 0


def test_every_robot_says_where_it_comes_from():
    for name in NAMES:
        robot = catalogue_robot(name)
        source = robot["source"]
        assert source["repo"].count("/") == 1, name
        assert len(source["commit"]) == 40, name
        assert source["licence"] not in ("", "none stated"), name
        assert robot["maker"], name
        assert {entry.name: entry.doubts for entry in find_robots(name)}[name] == len(robot["doubts"])


def test_what_does_not_ship_has_a_reason_and_no_numbers():
    for entry in catalogue_entries():
        assert entry.usable == (entry.name not in withheld())
        if not entry.usable:
            with pytest.raises(CalibrationError, match="without its numbers") as refused:
                load_model(entry.name)
            assert refused.value.remedy
            assert entry.withheld.endswith(".")
    assert "kawasaki_rs030n" in withheld()
    assert sum("licence" in entry["reason"] for entry in withheld().values()) == 31


def test_no_table_without_a_licence_is_kept():
    assert not [name for name, table in tables().items() if table["source"]["licence"] == "none stated"]


def test_limits_of_fanuc_arms_are_of_joints_and_of_their_sum():
    model = load_model("fanuc_crx10ia")
    (limit,) = model.combined_limits
    assert limit.name == "J2+J3"
    assert np.allclose(np.degrees([limit.lower_rad, limit.upper_rad]), (-71.0, 251.0), atol=1e-3)
    inside, outside = np.zeros(6), np.radians([0, 90, 170, 0, 0, 0])  # each joint alone is inside
    excess = beyond_limits(model, np.array([inside, outside]))
    assert (excess[:, :6] <= 0).all()
    assert excess[0, 6] <= 0 < excess[1, 6]
    assert np.isclose(excess[1, 6], np.radians(260 - 251), atol=1e-6)


def test_the_rods_of_an_irb_2400_hold_the_forearm_against_the_base():
    """Motor 2 alone: a parallelogram lets the forearm keep its direction, and the wrist moves along an arc."""
    model = load_model("abb_irb2400")
    tilted = np.zeros((2, 6))
    tilted[1, 1] = 0.4
    upright, leaning = model.base_flange(tilted)
    assert np.abs(upright[:3, :3] - leaning[:3, :3]).max() < 1e-12
    assert np.linalg.norm(upright[:3, 3] - leaning[:3, 3]) > 0.1
    assert any("parallelogram" in doubt for doubt in catalogue_robot("abb_irb2400")["doubts"])


def test_frames_of_the_source_can_be_chosen():
    robot = table_of("fanuc_crx10ia")
    joints = joints_of(load_model("fanuc_crx10ia"), 3)
    ours = load_model("fanuc_crx10ia?base=base_link&tip=flange").base_flange(joints)
    theirs = flange_by_joints({**robot, "controller_base": {}, "tip": robot["other_tips"]["flange"]}, joints)
    assert np.abs(ours - theirs).max() < 1e-9
    with pytest.raises(CalibrationError, match="no tip frame 'nose'") as refused:
        load_model("fanuc_crx10ia?tip=nose")
    assert "flange" in refused.value.remedy


@pytest.mark.parametrize(
    ("words", "first"),
    [
        ("kr210", "kuka_kr210l150"),
        ("KR 210 R3100", "kuka_kr210_r3100_2"),
        ("irb 120", "abb_irb120"),
        ("crx-10ia", "fanuc_crx10ia"),
        ("UR 10 e", "ur10e"),
        ("yaskawa gp25", "yaskawa_gp25"),
        ("kr21o", "kuka_kr210l150"),
        ("tx2-90l", "staubli_tx2_90l"),
        ("panda", "franka_fer"),
        ("Franka Emika Panda", "franka_fer"),
        ("panda arm", "franka_fer"),
        ("frankaemika panda", "franka_fer"),
        ("pnada", "franka_fer"),
        ("pand", "franka_fer"),
        ("FR-3", "franka_fr3"),
        ("iiwa", "kuka_lbr_iiwa7_r800"),
        ("LBR iiwa 14", "kuka_lbr_iiwa14_r820"),
        ("iiwaa", "kuka_lbr_iiwa7_r800"),
        ("KR-210", "kuka_kr210l150"),
        ("IRB_120", "abb_irb120"),
        ("irb12o", "abb_irb120"),
        ("UR-10 e", "ur10e"),
        ("motman gp25", "yaskawa_gp25"),
        ("omron tm5 700", "techman_tm5_700"),
        ("kuka 7 axis", "kuka_lbr_iiwa7_r800"),
        ("mitsubishi scara", "mitsubishi_rh6crh6020"),
        ("Stäubli TX2-90L", "staubli_tx2_90l"),
        ("kuka seven axis", "kuka_lbr_iiwa7_r800"),
    ],
)
def test_words_find_robots_in_any_spelling(words, first):
    assert find_robots(words)[0].name == first


@pytest.mark.parametrize(
    ("words", "every"),
    [
        ("scara", lambda entry: entry.kind == "scara"),
        ("7 axis", lambda entry: entry.axes == 7),
        ("5-axis", lambda entry: entry.axes == 5),
        ("parallelogram", lambda entry: entry.kind == "linkage"),
        ("melfa", lambda entry: entry.maker.startswith("Mitsubishi")),
    ],
)
def test_kinds_and_numbers_of_axes_are_words(words, every):
    found = find_robots(words)
    assert found
    assert set(found) == {entry for entry in catalogue_entries() if every(entry)}


def test_letters_do_not_begin_in_one_word_and_end_in_another():
    """The WAM arm is none of Yaskawa's MH."""
    assert not any(is_called(entry, "wam") for entry in find_robots("wam"))
    assert is_called(find_robots("lrmate")[0], "lrmate")


@pytest.mark.parametrize("name", [*SOLD_AS, "Franka Emika Panda", "Panda"])
def test_a_robot_is_loaded_by_the_name_under_which_it_was_sold(name):
    assert load_model(name).name == "franka_fer"


def test_every_common_name_means_a_robot_that_ships():
    for word in COMMON_NAMES:
        assert any(entry.usable for entry in find_robots(word)), word


def test_words_that_fit_nothing_name_the_nearest_robots(capsys):
    assert run_command_line(["models", "hc99dtp"]) != 0
    assert "The nearest names: yaskawa_hc" in " ".join(capsys.readouterr().err.split())


@pytest.mark.parametrize(
    ("words", "name"),
    [
        ("IRB 120-3/0.58", "abb_irb120"),
        ("irb120_3_58", "abb_irb120"),
        ("abb_irb120_3_58", "abb_irb120"),
        ("IRB 6700-235/2.65", "abb_irb6700_235_265"),
        ("IRB 6700-205/2.80", "abb_irb6700_200_260"),
        ("IRB 7600-500/2.55", "abb_irb7600_150_350"),
        ("KR 6 R900-2", "kuka_kr6_r900_2"),
        ("KR3 AGILUS", "kuka_kr3r540"),
        ("LR Mate 200iD/7L", "fanuc_lrmate200id7l"),
        ("M-10iA/12", "fanuc_m10ia"),
        ("VS-060A3-AV6", "denso_vs060"),
        ("UR10 e-Series", "ur10e"),
        ("UR10 CB3", "ur10"),
        ("Franka Research 3", "franka_fr3"),
    ],
)
def test_a_name_as_its_maker_writes_it_leads_to_the_robot(words, name, capsys):
    assert run_command_line(["models", words, "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["models"][0]["name"] == name
    assert nearest_names(words)[0] == name


def test_names_that_are_only_near_are_not_listed_as_if_they_were_meant(capsys):
    assert run_command_line(["models", "m720ic"]) == 0
    assert "No robot is called 'm720ic'; these names are near to it." in capsys.readouterr().out
    assert run_command_line(["models", "m720ic", "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["nearly"] is True
    assert run_command_line(["models", "M-710iC", "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["nearly"] is False


def test_a_search_of_a_maker_leaves_out_the_others():
    assert {entry.maker for entry in find_robots("6", "staubli")} == {"Staubli"}
    assert find_robots("no such robot at all") == ()


def test_the_command_finds_shows_and_refuses(capsys):
    assert run_command_line(["models", "kr210", "--json"]) == 0
    listed = json.loads(capsys.readouterr().out)["models"]
    assert listed[0]["maker"] == "KUKA"
    assert {robot["axes"] for robot in listed} == {6}
    assert run_command_line(["models", "staubli_tx2_60", "--json"]) == 0
    (one,) = json.loads(capsys.readouterr().out)["models"]
    assert one["source"]["repo"].startswith("ros-industrial/")
    assert len(one["dh"]) == len(one["joints"]) == 6
    assert run_command_line(["models", "jaka"]) == 2
    assert "states no licence" in capsys.readouterr().err
    assert run_command_line(["models", "zz9", "--maker", "abb"]) == 2
    assert run_command_line(["models", "--all", "--json"]) == 0
    every = json.loads(capsys.readouterr().out)["models"]
    assert len(every) == len(catalogue_entries()) > len(NAMES)


def test_a_sliding_joint_is_shown_in_millimetres(capsys):
    assert run_command_line(["models", "denso_hsr065a1_n32", "--json"]) == 0
    (one,) = json.loads(capsys.readouterr().out)["models"]
    assert one["joints"][2] == {
        "name": "joint_3",
        "type": "prismatic",
        "unit": "mm",
        "limits": [-100.0, 220.0],
        "speed_per_s": 1900.0,
    }


def test_a_robot_that_ships_is_a_model_file_too():
    text = model_text("fanuc_r2000ic_165f")
    assert set(text.tips) == {"flange"}
    assert "base_link" in text.bases


@pytest.mark.parametrize(
    ("word", "found"),
    [("fanuc_crx", "fanuc_crx10ia"), ("kr210", "kuka_kr210l150"), ("ur1", "ur10e"), ("irb120", "abb_irb120")],
)
def test_the_shell_completes_names_and_parts_of_names(word, found):
    offered = complete_robot(SimpleNamespace(incomplete=word))
    assert found in offered
    assert len(offered) <= 60
    assert all(title for title in offered.values())


def test_the_completion_asks_the_command_itself():
    script = app.generate_completion(shell="bash")
    assert "__complete" in script
