"""Whether all measured positions are too large or too small by one factor, as a device's scale or a unit makes them.

Such a factor and link lengths are partly the same: a fit hides it in them. What tells them apart is how the lengths
deviate. Errors of making are of about one size and of either sign; a factor makes every length deviate in proportion
to itself. So the size of length errors is taken from these rows as well, with a factor and without one, and the two
are compared by how probable they make the rows. One length that alone is wrong (a link that was exchanged or bent)
looks like a factor of the arm's longest link, and is compared as an explanation of its own. The arm may sag under its
weight in every comparison: what sags lies lower the further out it is, which a stiff arm would explain by a factor.
"""

from dataclasses import dataclass, replace

import numpy as np

from cellcal.calibration.arm.joint_terms import gravity_terms
from cellcal.calibration.arm.kinematics import RobotModel
from cellcal.calibration.errors import CalibrationError
from cellcal.calibration.geometry import Array
from cellcal.calibration.identification.distinct_postures import FEWEST_POSTURES, count_postures
from cellcal.calibration.identification.estimator import FitProblem, place_columns
from cellcal.calibration.identification.first_guess import first_guess
from cellcal.calibration.identification.layouts import make_layout
from cellcal.calibration.identification.lints import Lint
from cellcal.calibration.identification.misfit_error import MisfitCause, MisfitError
from cellcal.calibration.identification.observations import (
    LengthObservations,
    Observations,
    PointObservations,
)
from cellcal.calibration.identification.parameters import GEOMETRY, Parameter, ParameterLayout, Priors
from cellcal.calibration.identification.quick_fit import spread_rows
from cellcal.calibration.identification.robust import fit_robustly
from cellcal.calibration.message import join_messages, make_message

_MOST_ROWS = 200
_SPARE_CHANNELS = 12  # more than unknowns
_SMALLEST = 1e-3  # an aluminium arm that is 40 K warmer is 0.9e-3 longer
_NEVER_MADE = (
    2e-3  # from here on an arm cannot be so; a smaller factor may be its links, and is told as perhaps
)
_DECISIVE = 12.0  # twice the difference of log likelihoods: none of 1200 arms without a factor came as far
_SURE = 4.0  # deviations
_DOUBTFUL, _LIKELY = 9.0, 3.0  # from here on a person is told: two of 1200
_LENGTH_ERRORS_M = np.geomspace(3e-5, 5e-3, 25)
_LOOK = (
    "See the scale of the device (scale bar, temperature, air pressure, wavelength) and whether a unit was converted "
    "by a rounded factor."
)
_SCALE_REMEDY = (
    "What these rows cannot tell: an arm whose links are all longer by the same factor measures the same. If the "
    "device is proved right, the named robot is the wrong one."
)
_DH_ROLES = ("offset", "geometry")
_BETA = 4  # column of the DH errors: theta, d, a, alpha, beta
_ARMS_WITH_ONE = 3.0  # of so many arms one has a length that alone is wrong, and it is one of all its lengths
_CROSSING = 0.1  # |sin alpha|: from here on two axes cross, and beta tells nothing new
_WIDE = Priors(length_m=5e-3)  # a factor must have room in the lengths


@dataclass(frozen=True, slots=True)
class PositionScale:
    """By which factor measured positions are too large, and how sure that is."""

    factor: float
    sigma: float
    evidence: float  # twice the difference of log likelihoods, with the factor and without

    def is_beyond(self, deviations: float, evidence: float) -> bool:
        """Whether the factor is off by more than temperature makes it, so surely, by so much evidence."""
        away = abs(self.factor - 1.0)
        return away > max(_SMALLEST, deviations * self.sigma) and self.evidence > evidence

    @property
    def words(self) -> str:
        """The factor for people."""
        percent = abs(self.factor - 1.0) * 1e2
        figures = make_message(
            "factor {factor:.4f}, standard deviation {sigma:.4f}", factor=self.factor, sigma=self.sigma
        )
        if self.factor > 1.0:
            return make_message("too large by {percent:.2f} % ({figures})", percent=percent, figures=figures)
        return make_message("too small by {percent:.2f} % ({figures})", percent=percent, figures=figures)


def position_scale(model: RobotModel, observations: Observations) -> PositionScale | None:
    """Return the common factor of measured positions, or None where rows are too few, alike or of another kind."""
    some = observations.select_rows(spread_rows(len(observations), _MOST_ROWS))
    if isinstance(some, LengthObservations):
        return None
    once = np.zeros(len(some), dtype=np.intp)
    places = PointObservations(some.joints_rad, some.positions_m, some.sigma_m, once)
    layout = make_layout(model, places.kind, 1, level=GEOMETRY, priors=_WIDE)
    if 3 * len(places) < len(layout) + _SPARE_CHANNELS:
        return None
    if count_postures(places.joints_rad, FEWEST_POSTURES) < FEWEST_POSTURES:
        return None
    try:
        start = first_guess(model, places)[0]
        found = fit_robustly(layout, start, FitProblem.from_observations(start, places))
    except (CalibrationError, np.linalg.LinAlgError):
        return None
    kept_rows = np.setdiff1d(np.arange(len(places)), found.rejected)
    sag = gravity_terms(model)
    layout = make_layout(model, places.kind, 1, level=GEOMETRY, terms=sag, priors=_WIDE)
    state = replace(found.fit.state, terms=sag, coefficients=np.zeros(len(sag)))
    problem = FitProblem.from_observations(state, found.problem.observations).select_rows(kept_rows)
    columns, residuals = place_columns(layout, state, problem)
    deviations = layout.prior_deviations(state)
    sigma_m = problem.observations.sigma_m
    predicted = places.positions_m[kept_rows].T - residuals * sigma_m  # (3, N), as predicted
    factor = (predicted - predicted.mean(axis=1, keepdims=True)) / sigma_m
    flat = columns.reshape(len(layout), -1)
    values = residuals.reshape(-1) + deviations @ flat
    needed = np.logical_not(_redundant_angles(model, layout))
    parameters = [each for each, used in zip(layout.parameters, needed, strict=True) if used]
    return _compared(flat[needed], values, factor.reshape(-1), parameters)


def _redundant_angles(model: RobotModel, layout: ParameterLayout) -> Array:
    """Return a mask (p,) of DH angles beta between axes that cross: theta, d, a and alpha hold all such axes do.

    A second angle there exchanges with lengths, at the price of an angle: a factor could hide in it.
    """
    redundant = np.zeros(len(layout), dtype=bool)
    if model.dh is None:
        return redundant
    crossing = np.abs(np.sin(model.dh.alpha_rad)) > _CROSSING
    places = [each for each, parameter in enumerate(layout.parameters) if parameter.role in _DH_ROLES]
    for each, (axis, column) in zip(places, layout.geometry, strict=True):
        redundant[each] = column == _BETA and crossing[axis]
    return redundant


def _compared(columns: Array, values: Array, factor: Array, parameters: list[Parameter]) -> PositionScale:
    """Compare the linear models ``values = columns x`` with and without a factor, at the best size of lengths.

    Without a factor means: all lengths off by about one size, or one of them off by any amount beside that.
    """
    lengths = np.array([each.role == "geometry" and each.unit == "m" for each in parameters])
    gram, goal = columns @ columns.T, columns @ values
    with_factor = columns @ factor
    statements: list[tuple[float, float, float, float]] = []
    for size_m in _LENGTH_ERRORS_M:
        prior = np.where(lengths, size_m, np.array([each.prior for each in parameters]))
        scaled = prior[:, None] * gram * prior + np.eye(len(prior))
        whitened = prior[:, None] * np.column_stack([goal, with_factor, gram[:, lengths]])
        solve = np.linalg.solve(scaled, whitened)
        plain = float(whitened[:, 0] @ solve[:, 0]) - float(np.linalg.slogdet(scaled)[1])
        sight = float(factor @ factor - whitened[:, 1] @ solve[:, 1])
        slope = float(factor @ values - whitened[:, 1] @ solve[:, 0])
        one_sight = np.diag(gram)[lengths] - np.sum(whitened[:, 2:] * solve[:, 2:], axis=0)
        one_slope = goal[lengths] - whitened[:, 2:].T @ solve[:, 0]
        one = np.where(one_sight > 0.0, one_slope**2 / np.where(one_sight > 0.0, one_sight, 1.0), 0.0)
        best_one = max(
            0.0, float(np.max(one, initial=0.0)) - 2.0 * float(np.log(_ARMS_WITH_ONE * max(1, one.size)))
        )
        statements.append((plain + best_one, plain + slope**2 / sight, slope / sight, sight**-0.5))
    without = max(each[0] for each in statements)
    best = max(statements, key=lambda each: each[1])
    return PositionScale(1.0 + best[2], best[3], best[1] - without)


def is_wrong(scale: PositionScale | None) -> bool:
    """Whether a factor is there that no arm is made with, and lengths of any size do not explain it."""
    return scale is not None and abs(scale.factor - 1.0) > _NEVER_MADE and scale.is_beyond(_SURE, _DECISIVE)


def refuse_wrong_scale(model: RobotModel, scale: PositionScale | None) -> None:
    """Refuse positions that fit the arm only with a factor.

    Raises
    ------
    MisfitError
        With the factor, what may have made it, and what these rows cannot tell.
    """
    if scale is None or not is_wrong(scale):
        return
    says = make_message("all measured positions are {words}", words=scale.words)
    cure = make_message(
        "{look} Then measure again, or divide X, Y and Z by {factor:.4f} in the file. {remedy} "
        "Nothing was stored.",
        look=_LOOK,
        factor=scale.factor,
        remedy=_SCALE_REMEDY,
    )
    raise MisfitError(
        make_message("the measurements fit {model_name} only if {says}.", model_name=model.label, says=says),
        remedy=cure,
        causes=(MisfitCause(("scale",), says, cure, 0.0),),
    )


def scale_note(scale: PositionScale | None) -> list[Lint]:
    """Return a note where a factor is likely and not sure."""
    if scale is None or is_wrong(scale) or not scale.is_beyond(_LIKELY, _DOUBTFUL):
        return []
    doubt = make_message("perhaps all measured positions are {scale_words}.", scale_words=scale.words)
    return [Lint("scale", join_messages(" ", (doubt, _LOOK, _SCALE_REMEDY)))]
