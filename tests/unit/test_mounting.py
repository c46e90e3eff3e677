"""A robot on a wall, a ceiling or a slope sags where its weight pulls it, and is kept under a name that says so."""

import json

import numpy as np
import pytest

from cellcal.calibration.arm.joint_terms import (
    gravity_terms,
    harmonic_terms,
    term_values,
    wrist_gravity_terms,
)
from cellcal.calibration.arm.kinematics import load_model
from cellcal.calibration.arm.model_references import is_known_model
from cellcal.calibration.arm.mounting import gravity_of, mounted_name
from cellcal.calibration.arm.robot_models.model_text import read_model_text
from cellcal.calibration.errors import CalibrationError
from cellcal.calibration.geometry import exp_rotation
from cellcal.calibration.identification.free_parameters import all_joint_terms
from cellcal.calibration.identification.identify import identify_arm
from cellcal.calibration.identification.layouts import term_parameters
from cellcal.calibration.identification.observations import DevicePlacement, PointObservations
from cellcal.calibration.identification.parameters import GRAVITY, RIPPLE, ArmState, Priors, nominal_state
from cellcal.calibration.identification.selection import (
    IdentificationOptions,
    possible_levels,
    terms_of_level,
)
from cellcal.calibration.identification.tip_uncertainty import predict_tips
from cellcal.service.cli.app import run_command_line
from cellcal.service.engineering.parameters.calibrated_models import nominal_sha256
from tests.unit.helpers.simulated_arm import TOOL, TRACKER, dh_errors, random_joints, tracker_points
from tests.unit.test_identify_report import file_of


@pytest.mark.parametrize(
    ("words", "turn"),
    [
        ("floor", (0.0, 0.0, 0.0)),
        ("ceiling", (np.pi, 0.0, 0.0)),
        ("wall", (0.0, -np.pi / 2, 0.0)),
        ("tilt:x=30", (np.pi / 6, 0.0, 0.0)),
        ("Tilt:y=-15", (0.0, -np.pi / 12, 0.0)),
        ("0, 0, -3", (0.0, 0.0, 0.0)),
    ],
)
def test_gravity_is_that_of_a_base_that_was_turned_so(words, turn):
    assert gravity_of(words) == pytest.approx(exp_rotation(np.array(turn)).T @ [0.0, 0.0, -1.0], abs=1e-12)


@pytest.mark.parametrize(
    "words", ["", "shelf", "tilt:z=3", "tilt:x", "tilt:x=nan", "0,0,0", "1,2", "inf,0,0", "tilt:x=1e999"]
)
def test_what_is_no_mounting_is_refused(words):
    with pytest.raises(CalibrationError, match="no mounting"):
        gravity_of(words)


def test_the_name_of_a_model_carries_its_mounting():
    assert load_model("ur10").gravity_in_base == (0.0, 0.0, -1.0)
    assert load_model("ur10@wall").gravity_in_base == (-1.0, 0.0, 0.0)
    assert load_model("ur10@wall").name == "ur10@wall"
    assert mounted_name("ur10", "") == "ur10"
    assert mounted_name("ur10", " Wall ") == "ur10@wall"
    with pytest.raises(CalibrationError, match="says how it is mounted"):
        mounted_name("ur10@wall", "ceiling")
    with pytest.raises(CalibrationError, match="no robot model"):
        load_model("ur11@wall")
    assert is_known_model("ur10")
    assert is_known_model("ur10@tilt:x=10")
    assert not is_known_model("ur10@shelf")
    assert not is_known_model("ur11@wall")


def test_a_model_file_says_how_its_robot_is_mounted():
    from importlib.resources import files

    text = files("cellcal.calibration.arm.robot_models").joinpath("ur10.toml").read_text(encoding="utf-8")
    assert read_model_text("mine", 'mounting = "ceiling"\n' + text).fields["gravity_in_base"] == (
        0.0,
        0.0,
        1.0,
    )
    with pytest.raises(CalibrationError, match="no mounting"):
        read_model_text("mine", 'mounting = "shelf"\n' + text)


def test_sets_of_robots_that_are_mounted_otherwise_do_not_fit():
    hashes = {nominal_sha256(load_model(name)) for name in ("ur10", "ur10@wall", "ur10@ceiling")}
    assert len(hashes) == 3
    assert nominal_sha256(load_model("ur10@floor")) == nominal_sha256(load_model("ur10"))


def sagging_robot(name, seed=0, count=140):
    """Return a robot with sag in its joints, measured by a tracker, and where its target truly is elsewhere."""
    model, rng = load_model(name), np.random.default_rng(seed)
    terms = gravity_terms(model)
    state = nominal_state(model, (DevicePlacement(TRACKER, np.zeros(3)),), TOOL)
    size = np.deg2rad(0.15) * rng.choice([-1.0, 1.0], len(terms))
    truth = ArmState(model, dh_errors(model, rng), terms, size, TOOL, state.devices)

    def true_tips(joints):
        moved = truth.moved_joints(joints, term_values(model, joints, terms))
        return truth.seen_from(0).base_flange(moved)[:, :3, 3]

    joints = random_joints(model, rng, count)
    measured_m = true_tips(joints) + 5e-5 * rng.standard_normal((count, 3))
    rows = PointObservations(joints, measured_m, np.full(count, 3e-4), np.zeros(count, dtype=np.intp))
    check = random_joints(model, rng, 100)
    return rows, check, true_tips(check)


@pytest.mark.parametrize("name", ["ur10@wall", "abb_irb120@tilt:x=35"])
def test_sag_of_a_robot_on_a_wall_is_found_if_its_mounting_is_stated(name):
    rows, check, there = sagging_robot(name)
    options = IdentificationOptions(judge=False, level=GRAVITY, find_breaks=False)

    def unseen_error_m(model):
        fit = identify_arm(load_model(model), rows, options=options).robust.fit
        return float(np.linalg.norm(predict_tips(fit, check).positions_m - there, axis=1).mean())

    error_stated, error_unstated = unseen_error_m(name), unseen_error_m(name.split("@")[0])
    assert error_stated < 1e-4
    assert error_unstated > 3 * error_stated


def test_the_first_joint_sags_on_a_wall_and_stands_on_the_floor():
    assert 0 not in {term.joint for term in gravity_terms(load_model("ur10"))}
    assert 0 in {term.joint for term in gravity_terms(load_model("ur10@wall"))}


def test_wrist_and_payload_sag_as_their_levers_say():
    model = load_model("abb_irb120")
    terms = wrist_gravity_terms(model)
    assert {term.joint for term in terms} >= {1, 2, 3, 4, 5}
    assert not {t.name for t in terms} & {t.name for t in gravity_terms(model)}
    assert len({t.name for t in all_joint_terms(model)}) == len(all_joint_terms(model))
    joints = random_joints(model, np.random.default_rng(0), 30)
    payload = next(t for t in terms if t.name == "J6 sag under payload x")
    value = term_values(model, joints, (payload,))[0]
    flange = model.base_flange(joints)
    by_hand = np.cross(0.1 * flange[:, :3, 0], [0.0, 0.0, -1.0])
    assert value == pytest.approx((by_hand * flange[:, :3, 2]).sum(axis=1), abs=1e-12)


def test_few_rows_try_one_and_two_waves_a_turn_and_many_try_more():
    model = load_model("fanuc_r2000ic_165f")
    few = random_joints(model, np.random.default_rng(0), 36)
    many = random_joints(model, np.random.default_rng(0), 200)
    assert {t.order for t in terms_of_level(model, few, RIPPLE) if t.kind == "harmonic"} == {1, 2}
    assert {t.order for t in terms_of_level(model, many, RIPPLE) if t.kind == "harmonic"} == set(range(1, 9))
    priors = {p.name: p.prior for p in term_parameters(harmonic_terms(model, (1, 2, 3)), Priors())}
    assert priors["J1 ripple cos 1"] > priors["J1 ripple cos 2"] > priors["J1 ripple cos 3"]
    sizes = {0: 9, 1: 15, 2: 39, 3: 43, 4: 83, 5: 92}
    assert 4 in possible_levels(sizes, 108)[0]
    assert 4 not in possible_levels({**sizes, 4: 150}, 200)[0]


@pytest.mark.parametrize(("ripple_deg", "gains"), [(0.012, True), (0.0, False)])
def test_waves_of_a_turn_are_chosen_where_unseen_rows_gain_and_not_otherwise(ripple_deg, gains):
    model, rng = load_model("fanuc_r2000ic_165f"), np.random.default_rng(4)
    sag, waves = gravity_terms(model), harmonic_terms(model, (1, 2))
    size = np.deg2rad([0.05] * len(sag) + [ripple_deg] * len(waves)) * rng.standard_normal(
        len(sag) + len(waves)
    )
    terms = (*sag, *waves)
    devices = (DevicePlacement(TRACKER, np.zeros(3)),)
    truth = ArmState(model, dh_errors(model, rng), terms, size, TOOL, devices)
    joints = random_joints(model, rng, 108, reach=1.2)
    places = truth.seen_from(0).base_flange(truth.moved_joints(joints, term_values(model, joints, terms)))
    measured_m = places[:, :3, 3] + 1e-4 * rng.standard_normal((108, 3))
    rows = PointObservations(joints, measured_m, np.full(108, 3e-4), np.zeros(108, dtype=np.intp))
    found = identify_arm(model, rows, options=IdentificationOptions(find_breaks=False))
    assert (found.level >= RIPPLE) is gains
    if gains:
        fixed_level_fit = identify_arm(
            model, rows, options=IdentificationOptions(find_breaks=False, level=GRAVITY)
        ).held_out.rmse_m
        assert found.held_out.rmse_m < 0.8 * fixed_level_fit


def test_the_command_takes_a_mounting_and_keeps_it_in_the_name(tmp_path, capsys):
    path = file_of(tracker_points("ur10", 40), tmp_path / "points.csv")
    words = ["identify", str(path), "--robot", "ur10", "--level", "1", "--json"]
    assert run_command_line([*words, "--mounting", "wall"]) == 0
    assert json.loads(capsys.readouterr().out)["robot"] == "ur10@wall"
    assert run_command_line([*words, "--mounting", "shelf"]) != 0
    assert "floor, wall" in capsys.readouterr().err


@pytest.mark.parametrize("option", ["--save", "--urdf"])
def test_a_residual_model_that_would_be_lost_is_refused_at_once(option, tmp_path, capsys):
    missing = tmp_path / "no such file.csv"  # the refusal comes before the work
    words = ["identify", str(missing), "--robot", "ur10", "--residual-model", option, str(tmp_path / "kept")]
    words += ["--serial", "4711", "--by", "Ada"] if option == "--save" else []
    assert run_command_line(words) != 0
    message = " ".join(capsys.readouterr().err.split())
    assert f"cannot be kept by {option}" in message
    assert "program compensate" in message
    assert not (tmp_path / "kept").exists()
