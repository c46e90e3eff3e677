"""What an earlier fit knew is the next one's prior, with its covariance, from the file in which it was stored."""

import json
from dataclasses import replace

import numpy as np
import pytest

from cellcal.calibration.errors import DegenerateDataError
from cellcal.calibration.identification.estimator import estimate_arm
from cellcal.calibration.identification.free_parameters import StartingPoint
from cellcal.calibration.identification.identify import identify_arm
from cellcal.calibration.identification.parameters import GEOMETRY
from cellcal.calibration.identification.selection import IdentificationOptions
from cellcal.calibration.identification.tip_uncertainty import predict_tips
from cellcal.service.cli.app import run_command_line
from cellcal.service.engineering.parameters.calibrated_models import covariance_of
from cellcal.service.engineering.parameters.parameter_set import ParameterSetError, parse_set, to_text
from cellcal.service.engineering.parameters.parameter_sets import ParameterSets
from tests.unit.helpers.simulated_arm import random_joints, tracker_points
from tests.unit.test_identify_report import file_of

OPTIONS = IdentificationOptions(level=GEOMETRY, judge=False)


@pytest.fixture(scope="module")
def earlier_fit():
    simulated = tracker_points(count=80)
    fit = identify_arm(simulated.model, simulated.observations, options=OPTIONS).robust.fit
    arm = [i for i, p in enumerate(fit.layout.parameters) if p.role in ("offset", "geometry")]
    names = tuple(fit.layout.parameters[i].name for i in arm)
    values = dict(zip(names, fit.layout.prior_deviations(fit.state)[arm].tolist(), strict=True))
    return simulated, StartingPoint(values, names=names, covariance=fit.covariance[np.ix_(arm, arm)])


def few_rows(simulated, slip_rad=0.0, count=5):
    joints = random_joints(simulated.model, np.random.default_rng(3), count)
    moved = joints + slip_rad * np.eye(6)[1]
    tips = simulated.truth.seen_from(0).base_flange(moved)[:, :3, 3]
    measured_m = tips + 5e-5 * np.random.default_rng(4).standard_normal(tips.shape)
    return replace(tracker_points(count=count, joints=joints).observations, positions_m=measured_m)


def miss_and_claim_m(simulated, found):
    joints = random_joints(simulated.model, np.random.default_rng(9), 200)
    tips = predict_tips(found.robust.fit, joints)
    truth = simulated.truth.seen_from(0).base_flange(joints)[:, :3, 3]
    miss = np.sqrt(((tips.positions_m - truth) ** 2).sum(axis=1).mean())
    return miss, np.sqrt(np.einsum("nii->n", tips.covariance_m2).mean())


def test_five_rows_add_to_what_was_known_instead_of_blurring_it(earlier_fit):
    simulated, start = earlier_fit
    rows = few_rows(simulated)
    found = identify_arm(simulated.model, rows, options=replace(OPTIONS, start=start))
    miss, claim = miss_and_claim_m(simulated, found)
    assert miss < 2e-4  # five rows place tracker and target, eighty told the arm
    assert 0.3 * claim < miss < 3 * claim
    assert found.contradicted == ()
    assert "J2 offset" not in {item.parameter for item in found.not_identified}
    wide = replace(start, covariance=None)
    with pytest.raises(DegenerateDataError, match="too few"):
        identify_arm(simulated.model, rows, options=replace(OPTIONS, start=wide))
    eight = few_rows(simulated, count=8)
    assert (
        miss_and_claim_m(
            simulated, identify_arm(simulated.model, eight, options=replace(OPTIONS, start=wide))
        )[1]
        > 3 * claim
    )


def test_an_offset_that_slipped_is_found_again_from_five_rows_or_contradicts(earlier_fit):
    simulated, start = earlier_fit
    rows = few_rows(simulated, 5e-3)
    found = identify_arm(simulated.model, rows, options=replace(OPTIONS, start=start))
    assert found.contradicted[0].parameter == "J2 offset"
    assert found.contradicted[0].moved_rad == pytest.approx(5e-3, abs=1e-3)
    named = replace(start, free=("J2 offset",))
    again = identify_arm(simulated.model, rows, options=IdentificationOptions(start=named, judge=False))
    slip = again.state.geometry[1, 0] - start.values["J2 offset"]
    assert slip == pytest.approx(5e-3, abs=3e-4)


def test_two_fits_in_a_row_know_as_much_as_one_of_all_rows(earlier_fit):
    """Gaussian knowledge adds up: no row is counted twice, none is lost."""
    simulated, start = earlier_fit
    rows = tracker_points(
        count=60, seed=1, joints=random_joints(simulated.model, np.random.default_rng(5), 60)
    )
    both = identify_arm(simulated.model, rows.observations, options=replace(OPTIONS, start=start)).robust
    alone = identify_arm(simulated.model, rows.observations, options=OPTIONS).robust
    assert len(both.fit.layout) == len(alone.fit.layout)
    arm = [i for i, p in enumerate(both.fit.layout.parameters) if p.name in start.names]
    expected = np.linalg.inv(
        np.linalg.inv(start.covariance)
        + np.linalg.inv(alone.fit.covariance[np.ix_(arm, arm)])
        - np.diag(1.0 / alone.fit.layout.prior_sigmas[arm] ** 2)
    )
    ratio = np.sqrt(np.diag(both.fit.covariance)[arm] / np.diag(expected))
    assert ratio == pytest.approx(np.ones(len(arm)), rel=0.1)
    # Told in the arm's parameters, the fit is where its own equations put it.
    again = estimate_arm(alone.fit.layout, both.fit.state, alone.problem)
    assert again.cost <= alone.fit.cost * (1 + 1e-6)


def test_a_stored_set_brings_its_covariance_and_refuses_a_bent_one(tmp_path, capsys):
    simulated = tracker_points("ur10", 80)
    path, few = file_of(simulated, tmp_path / "a.csv"), file_of(simulated, tmp_path / "few.csv", slice(0, 5))
    words = ["--robot", "ur10", "--level", "2", "--save", str(tmp_path / "sets"), "--serial", "U1"]
    assert run_command_line(["identify", str(path), *words, "--by", "Ada", "--json"]) == 0
    first = json.loads(capsys.readouterr().out)
    found = ParameterSets(tmp_path / "sets").load_set("U1")
    covariance = covariance_of(found)
    sigma = {item["name"]: item["sigma"] for item in first["parameters"]}
    assert np.sqrt(np.diag(covariance)) == pytest.approx([sigma[value.name] for value in found.values])
    assert np.abs(covariance[np.triu_indices(len(covariance), 1)]).max() > 0
    assert parse_set(to_text(found)) == found
    options = [*words, "--by", "Ada", "--start", "previous", "--json"]
    assert run_command_line(["identify", str(few), *options]) == 0
    second = json.loads(capsys.readouterr().out)
    after = {item["name"]: item["sigma"] for item in second["parameters"]}
    assert after["J3 a"] < 1.05 * sigma["J3 a"]
    bent = tuple(
        replace(v, correlations=(1.0,) * (i - 1) + (-1.0,) * min(i, 1)) for i, v in enumerate(found.values)
    )
    with pytest.raises(ParameterSetError, match="contradict"):
        covariance_of(replace(found, values=bent))
