"""CONFIG against what a virtual controller made of sixteen joint sets of an M-20iD/25."""

import numpy as np
import pytest

from cellcal.calibration.arm.kinematics import DhTable, RobotModel, load_model
from cellcal.calibration.errors import CalibrationError
from cellcal.calibration.orientation import rotation_from
from cellcal.drivers.fanuc.program_files.configuration import FanucConfigurations

RULE = FanucConfigurations()

# J1 … J6 [deg]; CONFIG; X Y Z [mm] W P R [deg] of the flange, as the controller wrote them (ROBOGUIDE; published with
# LeroyDu56/CrossArm, tests/fixtures/probes/results/CFGPROBE_roboguide.LS, joints in tools/make_config_probes.py).
MEASURED = (
    ((0, 0, 0, 0, -90, 0), "N U T, 0, 0, 0", (965.0, 0.0, 965.0, -180.0, 0.0, 0.0)),
    ((0, 0, 0, 0, 90, 0), "F U T, 0, 0, 0", (965.0, 0.0, 1145.0, 0.0, 0.0, -180.0)),
    ((0, 0, 0, 0, -30, 0), "N U T, 0, 0, 0", (1042.942, 0.0, 1010.0, 180.0, -60.0, 0.0)),
    ((0, 0, 0, 0, 30, 0), "F U T, 0, 0, 0", (1042.942, 0.0, 1100.0, 0.0, -60.0, 180.0)),
    ((0, 0, 0, 185, -90, 0), "N U T, 0, 1, 0", (965.0, 7.844, 1144.657, -5.0, 0.0, 0.0)),
    ((0, 0, 0, -185, -90, 0), "N U T, 0, -1, 0", (965.0, -7.844, 1144.657, 5.0, 0.0, 0.0)),
    ((0, 0, 0, 0, -90, 190), "N U T, 0, 0, 1", (965.0, 0.0, 965.0, 180.0, 0.0, -170.0)),
    ((0, 0, 0, 0, -90, -190), "N U T, 0, 0, -1", (965.0, 0.0, 965.0, -180.0, 0.0, 170.0)),
    ((0, 0, 0, 0, -90, 350), "N U T, 0, 0, 1", (965.0, 0.0, 965.0, 180.0, 0.0, -10.0)),
    ((0, 40, 60, 0, -90, 0), "N D T, 0, 0, 0", (951.688, 0.0, 1476.74, 180.0, -60.0, 0.0)),
    ((0, 40, -60, 0, -90, 0), "N U T, 0, 0, 0", (1168.195, 0.0, -64.785, -180.0, 60.0, 0.0)),
    ((0, -60, -80, 0, -90, 0), "N D B, 0, 0, 0", (-374.813, 0.0, -434.773, -180.0, 80.0, 0.0)),
    ((0, -60, 80, 0, -90, 0), "N U B, 0, 0, 0", (-621.015, 0.0, 1318.185, 180.0, -80.0, 0.0)),
    ((0, 60, 80, 0, -90, 0), "N D T, 0, 0, 0", (833.907, 0.0, 1318.185, 180.0, -80.0, 0.0)),
    ((90, 0, 0, 0, -90, 0), "N U T, 0, 0, 0", (0.0, 965.0, 965.0, -180.0, 0.0, 90.0)),
    ((-150, 0, 0, 0, -90, 0), "N U T, 0, 0, 0", (-835.714, -482.5, 965.0, -180.0, 0.0, -150.0)),
)
JOINTS = np.radians([joints for joints, _, _ in MEASURED])
TEXTS = tuple(text for _, text, _ in MEASURED)
# CURPOS.DG of a real ArcTool robot, F number E33151, V7.7027, published by a school's web-server example.
REAL = np.radians([[86.75, -45.63, -10.99, 56.19, -81.55, -94.01]])


def m20id_model() -> RobotModel:
    """Return the arm of the sixteen sets: 75 / 840 / 215 / 890 mm, flange at 90 mm."""
    degrees = np.radians
    rows = np.array(
        [
            [0.0, 0.0, 0.075, degrees(-90), 0],
            [degrees(-90), 0.0, 0.840, degrees(180), 0],
            [0.0, 0.0, 0.215, degrees(-90), 0],
            [0.0, -0.890, 0.0, degrees(90), 0],
            [0.0, 0.0, 0.0, degrees(-90), 0],
            [0.0, -0.090, 0.0, degrees(180), 0],
        ]
    )
    coupling = np.eye(6)
    coupling[2, 1] = 1.0
    return RobotModel.from_dh(DhTable.from_rows(rows), name="m20id", joint_coupling=coupling)


def test_the_arm_s_poses_are_the_controller_s_so_joints_and_w_p_r_mean_what_they_mean_there():
    poses = m20id_model().base_flange(JOINTS)
    written = np.array([pose for _, _, pose in MEASURED])
    assert np.abs(1e3 * poses[:, :3, 3] - written[:, :3]).max() < 6e-4
    assert np.abs(poses[:, :3, :3] - rotation_from("fanuc_wpr", np.radians(written[:, 3:]))).max() < 2e-5


def test_the_rule_spells_what_the_controller_wrote():
    assert RULE.write_configurations(m20id_model(), JOINTS, ["F D B, 9, 9, 9"] * len(TEXTS)) == TEXTS


def test_the_rule_agrees_with_the_controller_and_with_no_other_set_s_text():
    for other in set(TEXTS):
        agrees = RULE.matches_postures(m20id_model(), JOINTS, [other] * len(TEXTS))
        assert agrees.tolist() == [text == other for text in TEXTS]


def test_without_turns_only_the_letters_count():
    agrees = RULE.matches_postures(m20id_model(), JOINTS, ["N U T, 5, 5, 5"] * len(TEXTS), turns=False)
    assert agrees.tolist() == [text.startswith("N U T") for text in TEXTS]
    assert not RULE.matches_postures(m20id_model(), JOINTS, ["N U T, 5, 5, 5"] * len(TEXTS)).any()


@pytest.mark.parametrize("name", ["fanuc_m6ib", "fanuc_r2000ic_165f"])
def test_a_real_robot_s_current_position_is_what_its_controller_called_it(name: str):
    assert RULE.matches_postures(load_model(name), REAL, ["N U T, 0, 0, 0"]).all()
    assert RULE.write_configurations(load_model(name), REAL, ["F D B,0,0,0"]) == ("N U T,0,0,0",)


def test_an_old_text_keeps_its_spelling_and_what_it_leaves_open():
    joints = np.radians([[0, 0, 0, 190, 40, -200]] * 5)
    like = ["N U T, 0, 0, 0", "NUT,0,0,0", "N D B", "", "F U T,,,"]
    assert RULE.write_configurations(m20id_model(), joints, like) == (
        "F U T, 0, 1, -1",
        "FUT,0,1,-1",
        "F U T",
        "",
        "F U T,,,",
    )
    assert RULE.matches_postures(
        m20id_model(), joints, ["", "F", ", , 1,", "F U T, 0, 1, -1", "N"]
    ).tolist() == [True] * 4 + [False]


def test_what_is_spelled_agrees_for_postures_everywhere():
    rng = np.random.default_rng(4)
    joints = rng.uniform(-1, 1, (4000, 6)) * np.radians([180, 100, 180, 400, 140, 720])
    for model in (m20id_model(), load_model("fanuc_m6ib"), load_model("fanuc_r2000ic_165f")):
        texts = RULE.write_configurations(model, joints, ["N U T, 0, 0, 0"] * len(joints))
        assert RULE.matches_postures(model, joints, texts).all()
        assert len({text[:5] for text in texts}) == 8
        turned = joints + np.radians([0, 0, 0, 360, 0, 0])
        assert not RULE.matches_postures(model, turned, texts).any()
        assert RULE.matches_postures(model, turned, texts, turns=False).all()


def test_on_the_border_of_two_turn_numbers_or_letters_both_agree_and_half_a_thousandth_of_a_degree_beside_it_one():
    half = np.radians([[0, 0, 0, 0, -90, 180], [0, 0, 0, 0, -90, 179.9993], [0, 0, 0, 0, -90, -180]])
    assert RULE.matches_postures(m20id_model(), half, ["N U T, 0, 0, 0"] * 3).tolist() == [True, True, True]
    assert RULE.matches_postures(m20id_model(), half, ["N U T, 0, 0, 1"] * 3).tolist() == [True, False, False]
    assert RULE.write_configurations(m20id_model(), half, ["N U T, 0, 0, 0"] * 3) == (
        "N U T, 0, 0, 1",
        "N U T, 0, 0, 0",
        "N U T, 0, 0, -1",
    )
    straight = np.zeros((1, 6))
    assert RULE.matches_postures(m20id_model(), straight, ["N U T, 0, 0, 0"]).all()
    assert RULE.matches_postures(m20id_model(), straight, ["F U T, 0, 0, 0"]).all()


def test_an_arm_that_is_no_six_axis_one_is_refused():
    with pytest.raises(CalibrationError, match="six finite joints"):
        RULE.matches_postures(m20id_model(), np.zeros((1, 5)), ["N U T, 0, 0, 0"])
    with pytest.raises(CalibrationError, match="six finite joints"):
        RULE.write_configurations(m20id_model(), np.full((1, 6), np.nan), [""])
