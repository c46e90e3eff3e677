"""Rows predicted without their fold: the information of the fold is subtracted from that of all rows."""

from dataclasses import replace

import numpy as np

from cellcal.calibration.geometry import Array
from cellcal.calibration.identification.estimator import (
    ArmFit,
    FitProblem,
    errors_m,
    estimate_arm,
    inverse_information,
    is_settled,
    place_columns,
    whitened_residuals,
)
from cellcal.calibration.identification.observations import Rows

_STEPS = 2


def errors_without_folds(fit: ArmFit, problem: FitProblem, weights: Array, folds: Rows) -> Array:
    """Return the error (N,) [m] of every row by least squares of the rows of other folds.

    Parameters
    ----------
    fit : ArmFit
        Of all rows.
    problem : FitProblem
        All rows.
    weights : (N,)
        Of each row's squared residual: zero for those that are not fitted.
    folds : (N,)
        The fold of every row, from zero.

    Notes
    -----
    The information of a fold's rows is subtracted from that of all. Two steps with these columns lead to the estimate
    of the others, the second by the residuals after the first; where it shows that the arm is not linear enough for
    that, the others are fitted from there.
    """
    layout, prior = fit.layout, fit.layout.prior_sigmas
    if not len(layout):
        return errors_m(fit.state, problem)
    root = np.sqrt(weights)
    weighed = replace(problem, root=root)
    columns, residuals = place_columns(layout, fit.state, weighed)
    information_of_folds = [
        _products(columns[..., folds == fold]) * np.outer(prior, prior)
        for fold in range(int(folds.max()) + 1)
    ]
    information = np.eye(len(layout)) + sum(information_of_folds)
    errors = np.empty(len(folds))
    for fold, of_fold in enumerate(information_of_folds):
        training, held_rows = np.flatnonzero(folds != fold), np.flatnonzero(folds == fold)
        inverse = inverse_information(information - of_fold)
        others, left = weighed.select_rows(training), np.where(folds == fold, 0.0, residuals)
        state, step = fit.state, np.zeros(len(layout))
        for step_number in range(_STEPS):
            if step_number:
                left[:, training] = whitened_residuals(state, others) * root[training]
            pull = np.tensordot(columns, left, axes=2) * prior
            step = inverse @ (pull - layout.prior_deviations(state) / prior)
            state = layout.apply_step(state, step * prior)
        if not is_settled(step, np.sqrt(np.diag(inverse)), prior):
            state = estimate_arm(layout, state, others, weights[training]).state
        errors[held_rows] = errors_m(state, problem.select_rows(held_rows))
    return errors


def _products(columns: Array) -> Array:
    flat = columns.reshape(len(columns), -1)
    products: Array = flat @ flat.T
    return products
