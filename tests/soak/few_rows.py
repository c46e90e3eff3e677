"""Do stated deviations hold with 8 to 60 rows at the automatic level, and is a strong misfit warned of?"""

import sys
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from cellcal.calibration.arm.joint_terms import JointTerm, gravity_terms, harmonic_terms, term_values
from cellcal.calibration.arm.kinematics import RobotModel, chain_frames
from cellcal.calibration.geometry import Array
from cellcal.calibration.identification.effect_lint import misfit_notes
from cellcal.calibration.identification.free_parameters import parameter_values
from cellcal.calibration.identification.identify import Identification, identify_arm
from cellcal.calibration.identification.layouts import make_layout
from cellcal.calibration.identification.observations import DevicePlacement, PointObservations
from cellcal.calibration.identification.parameters import GEOMETRY, ArmState
from cellcal.calibration.identification.selection import IdentificationOptions
from tests.soak.campaign_figures import CampaignFigures
from tests.soak.coverage_arms import SIGMA_M, TOOL, TRACKER, DrawnArm

LEAST, MOST = 0.935, 0.97
WARNED = 0.95  # of the rows with a strong misfit
ROWS = (8, 12, 20, 40, 60)
_PLACES = ("base", "anchor", "tool")
_STATED_M = 3e-4  # what a file without a column of deviations is read with


@dataclass(frozen=True, eq=False)
class FewRowsWorld:
    """One arm with its errors, what it does beside, and the readings of a tracker."""

    truth: ArmState
    observations: PointObservations


@dataclass(frozen=True, eq=False)
class FewRows:
    """What one identification stated against the truth."""

    inside: float  # share of the arm's parameters within two stated deviations
    warned: bool


def _with_terms(truth: ArmState, terms: tuple[JointTerm, ...], sizes_rad: Array) -> ArmState:
    return replace(truth, terms=terms, coefficients=sizes_rad)


def _with_sag(truth: ArmState, rng: np.random.Generator) -> ArmState:
    terms = gravity_terms(truth.nominal)
    return _with_terms(truth, terms, rng.standard_normal(len(terms)) * np.deg2rad(0.2))


def _with_ripple(truth: ArmState, rng: np.random.Generator) -> ArmState:
    terms = harmonic_terms(truth.nominal, (1, 2, 3))
    return _with_terms(truth, terms, rng.standard_normal(len(terms)) * np.deg2rad(0.02))


def _link_bending(truth: ArmState, joints: Array, rng: np.random.Generator) -> Array:
    """Return what links do that bend sideways under the weight of the tip (N, 3) [m]."""
    rotations, origins = chain_frames(truth.seen_from(0), joints)
    down, moved = TRACKER[:3, :3] @ np.array([0.0, 0.0, -1.0]), np.zeros((len(joints), 3))
    for frame in range(1, len(rotations) - 1):
        lever = (origins[-1] - origins[frame]).T
        for axis in range(2):
            about = rotations[frame][:, axis].T
            moment = (np.cross(lever, down) * about).sum(axis=1)
            moved += rng.normal(0.0, np.deg2rad(0.1)) * moment[:, None] * np.cross(about, lever)
    return moved


def _target_steps(rotations: Array, rng: np.random.Generator) -> Array:
    """Return what a target does that was put on again in the middle of the series (N, 3) [m]."""
    count = len(rotations)
    step = np.arange(count) >= rng.integers(count // 4, 3 * count // 4 + 1)
    return step[:, None] * (rotations @ rng.normal(0.0, 7e-4, 3))


EFFECTS = ("none", "compliance", "ripple", "backlash", "bending", "outliers", "reseating", "drift")
_ARMS: dict[str, Callable[[ArmState, np.random.Generator], ArmState]] = {
    "compliance": _with_sag,
    "ripple": _with_ripple,
}


def draw_world(effect: str, rows: int, rng: np.random.Generator) -> FewRowsWorld:
    """Draw an arm from the priors with one effect, and measure it."""
    arm = DrawnArm.draw(rng)
    truth = ArmState(arm.model, arm.errors, (), np.zeros(0), TOOL, (DevicePlacement(TRACKER, np.zeros(3)),))
    if effect in _ARMS:
        truth = _ARMS[effect](truth, rng)
    joints = arm.draw_joints(rng, rows)
    moved = truth.moved_joints(joints, term_values(arm.model, joints, truth.terms))
    if effect == "backlash":
        moved = moved + np.deg2rad(0.03) * np.sign(rng.standard_normal(joints.shape))
    frames = truth.seen_from(0).base_flange(moved)
    places = frames[:, :3, 3] + rng.normal(0.0, SIGMA_M, (rows, 3))
    if effect == "bending":
        places += _link_bending(truth, moved, rng)
    if effect == "outliers":
        places += (rng.random((rows, 1)) < 0.06) * rng.normal(0.0, 5e-3, (rows, 3))
    if effect == "reseating":
        places += _target_steps(frames[:, :3, :3], rng)
    if effect == "drift":
        places += np.linspace(0.0, 1.0, rows)[:, None] * rng.normal(0.0, 7e-4, 3)
    stated = np.full(rows, _STATED_M)
    return FewRowsWorld(truth, PointObservations(joints, places, stated, np.zeros(rows, dtype=np.intp)))


def true_values(truth: ArmState) -> dict[str, float]:
    """Return the arm's parameters by name; terms that it does not have are zero."""
    model: RobotModel = truth.nominal
    layout = make_layout(model, "point", 1, level=GEOMETRY, terms=truth.terms)
    names = [parameter.name for parameter in layout.parameters]
    return dict(zip(names, layout.prior_deviations(truth).tolist(), strict=True))


def share_inside(found: Identification, truth: ArmState) -> float:
    """Return the share of the arm's fitted parameters that are within two stated deviations of the truth."""
    layout, fit, truth_values = found.robust.fit.layout, found.robust.fit, true_values(truth)
    sigmas = np.sqrt(np.diag(fit.covariance))
    inside = [
        abs(value - truth_values.get(parameter.name, 0.0)) < 2.0 * sigma
        for parameter, value, sigma in zip(
            layout.parameters, parameter_values(layout, found.state), sigmas, strict=True
        )
        if parameter.role not in _PLACES
    ]
    return float(np.mean(inside)) if inside else float("nan")


def identify_few(effect: str, rows: int, seed: int) -> FewRows:
    """Identify one arm from few rows, and compare with the truth."""
    there = draw_world(effect, rows, np.random.default_rng([seed, rows, EFFECTS.index(effect)]))
    found = identify_arm(there.truth.nominal, there.observations, options=IdentificationOptions(judge=False))
    notes = misfit_notes(found.misfit, rows, len(found.rejected))
    return FewRows(
        share_inside(found, there.truth), bool(notes) or bool(found.breaks) or found.level > GEOMETRY
    )


def few_rows(seeds: int) -> CampaignFigures:
    """So many arms for every effect and number of rows: parameters inside two deviations, and warnings."""
    shares, warned = [], []
    for effect in EFFECTS:
        for rows in ROWS:
            found = [identify_few(effect, rows, seed) for seed in range(seeds)]
            inside = float(np.nanmean([each.inside for each in found]))
            warned_share = float(np.mean([each.warned for each in found]))
            sys.stdout.write(f"  {effect}, {rows} rows: inside {inside:.1%}, warned {warned_share:.0%}\n")
            shares.append(inside)
            warned += [each.warned for each in found if effect not in ("none", "outliers")]
    mean, warned_share = float(np.mean(shares)), float(np.mean(warned))
    line = (
        f"few rows: {mean:.1%} of the parameters inside two deviations ({LEAST:.1%} to {MOST:.1%}), from "
        f"{min(shares):.1%} to {max(shares):.1%} by effect and rows; strong misfits warned of {warned_share:.1%} "
        f"(at least {WARNED:.0%})"
    )
    return CampaignFigures(line, LEAST <= mean <= MOST and warned_share >= WARNED)
