"""A wire bent around the lip of its exit is longer, and no line of the record tells by how much."""

from dataclasses import replace

import numpy as np

from cellcal.calibration.arm.kinematics import load_model
from cellcal.calibration.wires.model import (
    WirePoses,
    WirePrior,
    disturbance_covariance,
    disturbance_of_sets,
    wire_terms,
)
from cellcal.calibration.wires.reference import parameter_sigmas

MODEL = load_model("abb_irb120")
PRIOR = WirePrior((0.4, -0.35, 0.1), (0.06, 0.05, 0.12))
WITHOUT = replace(PRIOR, sigma_exit_m=0.0)


def terms_at(joints):
    nominal = np.zeros(len(parameter_sigmas(MODEL, PRIOR)))
    nominal[:8] = [*PRIOR.anchor_in_base_m, *PRIOR.hook_in_flange_m, PRIOR.zero_m, 1.0]
    return wire_terms(MODEL, nominal, WirePoses.from_record_side(joints, 1e-4))


def test_lengths_share_the_bend_at_the_exit_as_far_as_their_wires_leave_alike():
    terms = terms_at(np.random.default_rng(1).uniform(-1.0, 1.0, (30, 6)))
    bend = disturbance_covariance(PRIOR, terms, terms) - disturbance_covariance(WITHOUT, terms, terms)
    assert np.allclose(np.diag(bend), PRIOR.sigma_exit_m**2)
    assert np.linalg.eigvalsh(bend).min() > -1e-15
    apart = np.arccos(np.clip(terms.directions @ terms.directions.T, -1.0, 1.0))
    assert (bend[apart > np.deg2rad(80.0)] < 0.05 * PRIOR.sigma_exit_m**2).all()
    assert (bend[apart < np.deg2rad(10.0)] > 0.9 * PRIOR.sigma_exit_m**2).all()


def test_sets_of_captures_share_the_bend_as_single_ones_do():
    terms = terms_at(np.random.default_rng(2).uniform(-1.0, 1.0, (8, 6)))
    whole = disturbance_covariance(PRIOR, terms, terms)
    sets = disturbance_of_sets(PRIOR, terms, 4)
    assert np.allclose(sets, [whole[:4, :4], whole[4:, 4:]], rtol=0.0, atol=1e-18)
