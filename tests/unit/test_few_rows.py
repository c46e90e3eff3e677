"""With few rows deviations are wide enough, the geometry is chosen with its priors, and misfits are named."""

from dataclasses import replace

import numpy as np
import pytest

from cellcal.calibration.identification.effect_lint import misfit_notes
from cellcal.calibration.identification.effect_mixture import KINDS, average_over_misfits
from cellcal.calibration.identification.identify import identify_arm
from cellcal.calibration.identification.observations import pose_from_points
from cellcal.calibration.identification.parameters import FRAMES, GEOMETRY
from cellcal.calibration.identification.selection import IdentificationOptions
from tests.soak.few_rows import EFFECTS, draw_world, identify_few, share_inside


@pytest.mark.parametrize("rows", [8, pytest.param(60, marks=pytest.mark.soak)])
def test_two_stated_deviations_hold_with_few_rows(rows):
    shares = [identify_few(effect, rows, seed).inside for effect in EFFECTS for seed in range(2)]
    assert 0.9 < np.nanmean(shares) < 0.99


@pytest.mark.parametrize("rows", [60, pytest.param(100, marks=pytest.mark.soak)])
def test_deviations_hold_where_ripple_is_larger_than_usual(rows):
    assert np.mean([identify_few("ripple", rows, seed).inside for seed in range(2)]) > 0.9


def test_the_geometry_with_its_priors_is_chosen_for_eight_rows():
    there = draw_world("none", 8, np.random.default_rng(4))
    found = identify_arm(there.truth.nominal, there.observations, options=IdentificationOptions(judge=False))
    assert found.level == GEOMETRY
    joints = np.random.default_rng(5).uniform(-1.0, 1.0, (50, 6))
    places = there.truth.seen_from(0).base_flange(joints)[:, :3, 3]
    errors = {
        state: np.linalg.norm(state.seen_from(0).base_flange(joints)[:, :3, 3] - places, axis=1)
        for state in (found.state, found.frames)
    }
    assert errors[found.state].mean() < 0.4 * errors[found.frames].mean()


@pytest.mark.parametrize(
    ("effect", "kind"),
    [("compliance", "joints"), ("ripple", "joints"), ("backlash", "play"), ("drift", "order")],
)
def test_model_errors_are_reported_by_kind(effect, kind):
    there = draw_world(effect, 40, np.random.default_rng(11))
    options = IdentificationOptions(judge=False, level=GEOMETRY, find_breaks=False)
    found = identify_arm(there.truth.nominal, there.observations, options=options)
    chances = dict(zip(KINDS, found.misfit.probability, strict=True))
    assert chances[kind] > 0.9
    assert max(chances, key=chances.get) == kind
    assert [note.code for note in misfit_notes(found.misfit, 40, 0)].count("misfit") >= 1


def test_clean_rows_have_no_misfit_and_eight_rows_leave_it_open():
    there = draw_world("none", 60, np.random.default_rng(12))
    found = identify_arm(
        there.truth.nominal, there.observations, options=IdentificationOptions(judge=False, find_breaks=False)
    )
    assert max(found.misfit.probability) < 0.1
    assert found.misfit.noise_m == pytest.approx(5e-5, rel=0.3)
    assert misfit_notes(found.misfit, 60, 0) == []
    there = draw_world("none", 8, np.random.default_rng(12))
    found = identify_arm(
        there.truth.nominal, there.observations, options=IdentificationOptions(judge=False, find_breaks=False)
    )
    assert [note.code for note in misfit_notes(found.misfit, 8, 0)] == ["misfit_open"]


def test_blunders_are_a_note_of_their_own():
    assert [note.code for note in misfit_notes(None, 40, 3)] == ["outliers"]
    assert misfit_notes(None, 400, 3) == []


def test_many_rows_keep_their_own_deviations():
    there = draw_world("none", 121, np.random.default_rng(3))
    found = identify_arm(
        there.truth.nominal, there.observations, options=IdentificationOptions(judge=False, level=GEOMETRY)
    )
    assert found.misfit is None


def test_a_device_that_was_moved_is_seen_though_no_level_helps():
    there = draw_world("none", 40, np.random.default_rng(3))
    places = there.observations.positions_m + np.where(np.arange(40) < 20, 0.0, 0.05)[:, None]
    found = identify_arm(
        there.truth.nominal,
        replace(there.observations, positions_m=places),
        options=IdentificationOptions(judge=False),
    )
    assert found.level == FRAMES or found.breaks
    chances = dict(zip(KINDS, found.misfit.probability, strict=True))
    assert chances["order"] > 0.9
    assert "order of measuring" in " ".join(note.message for note in misfit_notes(found.misfit, 40, 0))


def test_deviations_of_few_rows_do_not_depend_on_the_stated_size_of_noise():
    there = draw_world("none", 30, np.random.default_rng(8))
    options = IdentificationOptions(judge=False, level=GEOMETRY, find_breaks=False)
    found = identify_arm(there.truth.nominal, there.observations, options=options)
    louder = replace(there.observations, sigma_m=5 * there.observations.sigma_m)
    again = average_over_misfits(
        identify_arm(there.truth.nominal, louder, options=options).robust, there.observations
    )
    assert np.sqrt(np.diag(again.covariance)) == pytest.approx(
        np.sqrt(np.diag(found.robust.fit.covariance)), rel=0.2
    )
    assert share_inside(found, there.truth) > 0.8


def test_attitudes_far_more_precise_than_the_priors_leave_deviations_that_are_finite():
    there = draw_world("none", 40, np.random.default_rng(5))
    turns = there.truth.seen_from(0).base_flange(there.observations.joints_rad)[:, :3, :3]
    poses = pose_from_points(there.observations, turns, np.full(40, 2e-9))
    options = IdentificationOptions(judge=False, level=GEOMETRY, find_breaks=False)
    found = identify_arm(there.truth.nominal, poses, options=options)
    sigmas = np.sqrt(np.diag(found.misfit.covariance))
    assert np.isfinite(sigmas).all()
    assert (sigmas < 3.0 * found.robust.fit.layout.prior_sigmas).all()
