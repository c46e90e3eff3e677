"""A device whose scale is off, and a joint whose direction nothing shows, are named and not hidden in the arm."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from cellcal.calibration.arm.joint_terms import gravity_terms
from cellcal.calibration.arm.kinematics import load_model
from cellcal.calibration.geometry import homogeneous_matrix
from cellcal.calibration.identification.estimator import FitProblem, whitened_residuals
from cellcal.calibration.identification.last_joint import last_joint_note
from cellcal.calibration.identification.misfit import refuse_misfit
from cellcal.calibration.identification.misfit_error import MisfitError
from cellcal.calibration.identification.observations import PointObservations
from cellcal.calibration.identification.position_scale import (
    is_wrong,
    position_scale,
    refuse_wrong_scale,
    scale_note,
)
from cellcal.service.cli.app import run_command_line
from cellcal.service.engineering.identification.identify_check import prepare_measurements
from cellcal.service.engineering.measured.measurements import ReadOptions
from cellcal.service.exit_codes import ExitCode
from tests.unit.helpers import simulated_arm
from tests.unit.helpers.simulated_arm import tracker_points, wire_lengths

ROBOTS = ("abb_irb120", "fanuc_m6ib", "kuka_kr6_r900", "ur10e")
DATA = Path(__file__).parents[1] / "data"
REAL = DATA / "ipa_ur10" / "series_b_joint_configurations.csv"


def arm(robot: str, seed: int, length_m: float = 2e-4, count: int = 40):
    """Return a series of an arm whose lengths are off by about so much."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(
            simulated_arm, "dh_errors", lambda model, rng, errors=simulated_arm.dh_errors: errors(
                model, rng, length_m=length_m
            ),
        )  # fmt: skip
        return tracker_points(robot, count, seed=seed)


@pytest.mark.parametrize("robot", ROBOTS)
@pytest.mark.parametrize("factor", [1.003, 0.997, 1.01])
def test_a_factor_is_found_with_its_deviation_and_mostly_refused(robot: str, factor: float) -> None:
    refused = 0
    for seed in range(5):
        true = arm(robot, seed)
        spoilt = replace(true.observations, positions_m=true.observations.positions_m * factor)
        scale = position_scale(true.model, spoilt)
        assert scale is not None
        assert abs(scale.factor - factor) < 4.0 * scale.sigma
        is_reported = is_wrong(scale) or bool(scale_note(scale))
        assert is_reported, (seed, scale)
        refused += is_wrong(scale)
    assert refused >= 3


@pytest.mark.parametrize("length_m", [2e-4, 1e-3])
@pytest.mark.parametrize("robot", ROBOTS)
def test_an_arm_whose_lengths_are_off_has_no_factor(robot: str, length_m: float) -> None:
    notes = 0
    for seed in range(10, 20):
        true = arm(robot, seed, length_m)
        scale = position_scale(true.model, true.observations)
        assert not is_wrong(scale), (seed, scale)
        notes += len(scale_note(scale))
    assert notes <= 1, "by chance, and told as perhaps"


@pytest.mark.parametrize("robot", ROBOTS)
@pytest.mark.parametrize("error_m", [5e-4, -1.5e-3])
def test_one_wrong_link_is_no_factor(robot: str, error_m: float) -> None:
    for seed in range(3):

        def one_length(model, rng):
            errors = np.zeros((model.axis_count, 5))
            errors[:, 0] = np.deg2rad([0.1, -0.2, 0.15, 0.06, -0.12, 0.0])
            errors[np.argmax(np.abs(model.dh.a_m)), 2] = error_m
            return errors

        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(simulated_arm, "dh_errors", one_length)
            true = tracker_points(robot, 80, seed=seed, sigma_m=2e-5)
        scale = position_scale(true.model, true.observations)
        assert not is_wrong(scale), scale
        assert scale_note(scale) == []


def test_a_factor_that_links_may_have_is_told_and_not_refused() -> None:
    reported_count = 0
    for seed in range(5):
        true = arm("fanuc_m6ib", seed, length_m=2e-5, count=80)
        spoilt = replace(true.observations, positions_m=true.observations.positions_m * 1.0017)
        scale = position_scale(true.model, spoilt)
        assert not is_wrong(scale), "a public series of an IRB 120 is so, by three targets"
        reported_count += len(scale_note(scale))
    assert reported_count >= 4


SAG_DEG_PER_M = 0.2  # of a collaborative arm


def sagging_arm(robot: str, seed: int, factor: float):
    """Return a series of an arm whose links pull every joint down, and positions with a factor."""
    true = arm(robot, seed, count=60)
    terms = gravity_terms(true.model)
    pull = np.abs(np.random.default_rng(seed).standard_normal(len(terms))) * np.deg2rad(SAG_DEG_PER_M)
    truth = replace(true.truth, terms=terms, coefficients=pull)
    problem = FitProblem.from_observations(truth, true.observations)
    sagging_m = true.observations.positions_m - whitened_residuals(truth, problem).T * 5e-5
    noise_m = true.observations.positions_m - true.tips_m
    return true.model, replace(true.observations, positions_m=(sagging_m + noise_m) * factor)


@pytest.mark.parametrize("robot", ["kuka_lbr_iiwa14_r820", "fanuc_r2000ic_165f", "ur10"])
def test_an_arm_that_sags_has_no_factor_and_hides_none(robot: str) -> None:
    for seed in range(100, 104):
        scale = position_scale(*sagging_arm(robot, seed, 1.0))
        assert scale is not None
        assert not is_wrong(scale), (seed, scale)
        assert scale_note(scale) == []
        found = position_scale(*sagging_arm(robot, seed, 1.003))
        assert found is not None
        assert is_wrong(found), (seed, found)
        assert abs(found.factor - 1.003) < 3.0 * found.sigma


def test_what_temperature_explains_is_no_factor() -> None:
    true = arm("fanuc_m6ib", 2, 1e-5)
    warm = replace(true.observations, positions_m=true.observations.positions_m * (1.0 + 23e-6 * 35.0))
    assert not is_wrong(position_scale(true.model, warm))


def test_lengths_and_few_rows_have_none() -> None:
    wire = wire_lengths("fanuc_m6ib", 60)
    assert position_scale(wire.model, wire.observations) is None
    few = arm("fanuc_m6ib", 1, count=8)
    assert position_scale(few.model, few.observations) is None


def test_the_refusal_says_the_cure_and_what_the_rows_cannot_tell() -> None:
    true = arm("fanuc_m6ib", 3)
    spoilt = replace(true.observations, positions_m=true.observations.positions_m * 1.003)
    scale = position_scale(true.model, spoilt)
    assert scale is not None
    with pytest.raises(MisfitError) as refused:
        refuse_wrong_scale(true.model, scale)
    assert refused.value.causes[0].kinds == ("scale",)
    assert f"too large by {(scale.factor - 1.0) * 1e2:.2f} %" in refused.value.message
    for words in (
        "scale bar",
        f"divide X, Y and Z by {scale.factor:.4f}",
        "cannot tell",
        "Nothing was stored",
    ):
        assert words in refused.value.remedy


def written(path: Path, rows: PointObservations) -> Path:
    lines = ["J1,J2,J3,J4,J5,J6,X [mm],Y [mm],Z [mm]"]
    for joints, place in zip(np.rad2deg(rows.joints_rad), rows.positions_m * 1e3, strict=True):
        lines.append(",".join(f"{value:.6f}" for value in (*joints, *place)))
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")
    return path


def test_the_command_ends_as_with_any_other_misfit(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    true = arm("fanuc_m6ib", 3)
    spoilt = replace(true.observations, positions_m=true.observations.positions_m * 1.003)
    file = written(tmp_path / "large.csv", spoilt)
    assert run_command_line(["identify", str(file), "--robot", "fanuc_m6ib"]) == ExitCode.REFUSED
    assert "too large by" in " ".join(capsys.readouterr().err.split())


def test_real_measurements_have_none() -> None:
    model = load_model("ur10")
    scale = position_scale(model, prepare_measurements(REAL, model, ReadOptions()).observations)
    assert scale is not None
    assert not is_wrong(scale)
    assert scale_note(scale) == []


@pytest.mark.parametrize("radius_m", [0.0, 0.0005])
@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_the_direction_of_a_joint_that_turns_the_target_about_itself_is_unseen(
    monkeypatch: pytest.MonkeyPatch, radius_m: float, sign: float
) -> None:
    monkeypatch.setattr(simulated_arm, "TOOL", homogeneous_matrix(np.eye(3), np.array([radius_m, 0.0, 0.12])))
    true = arm("fanuc_m6ib", 2, count=60)
    read = true.observations.joints_rad * [1, 1, 1, 1, 1, sign]
    notes = last_joint_note(true.model, replace(true.observations, joints_rad=read))
    assert [note.code for note in notes] == ["direction"]
    assert "direction of J6 cannot be seen from these data" in notes[0].message


def test_off_the_axis_it_is_seen() -> None:
    true = arm("fanuc_m6ib", 2, count=60)
    assert last_joint_note(true.model, true.observations) == []


def test_nothing_is_said_of_the_target_where_the_arm_itself_is_wrong() -> None:
    """The target is off the axis, but a link that is 150 mm longer hides what the last joint moves."""
    true = arm("fanuc_m6ib", 2, count=60)
    placements = true.model.placements.copy()
    placements[3, :3, 3] += [0.15, 0.05, 0.1]
    assert last_joint_note(replace(true.model, dh=None, placements=placements), true.observations) == []


@pytest.mark.parametrize("jitter_m", [0.0, 1e-6])
def test_places_that_never_change_are_refused_in_words(jitter_m: float) -> None:
    true = arm("fanuc_m6ib", 1)
    rng = np.random.default_rng(0)
    still = np.tile(true.observations.positions_m[:1], (40, 1)) + jitter_m * rng.standard_normal((40, 3))
    with pytest.raises(MisfitError) as refused:
        refuse_misfit(true.model, replace(true.observations, positions_m=still))
    assert "the same in all rows" in refused.value.message
    assert "inf" not in refused.value.message
    wire = wire_lengths("fanuc_m6ib", 60)
    with pytest.raises(MisfitError, match="measured lengths are the same"):
        refuse_misfit(wire.model, replace(wire.observations, lengths_m=np.full(60, 1.2)))
