"""Damped least-squares steps of many small systems at once, components first and the pose last.

Six equations and six or more unknowns per pose. The normal matrix is positive definite by its damping, so
Cholesky needs no pivots and every operation runs over all poses: several times the speed of a solver that is
called once per pose, and than LU with pivots.
"""

import numpy as np

from cellcal.calibration.geometry import Array


def damped_step(columns: Array, error: Array, damping: Array) -> Array:
    """Return the shortest damped steps ``J' (J J' + damping I)^-1 e``.

    Parameters
    ----------
    columns : (n, m, N)
        ``columns[k]`` is the derivative of the m equations by unknown k; m <= n.
    error : (m, N)
        What the step shall make up for.
    damping : (N,)
        Positive, in squared units of the Jacobian: 1e-12 of its scale or more keeps the factors real.

    Returns
    -------
    step : (n, N)
    """
    factor = normal_matrix(columns, damping)
    _factorise_cholesky(factor)
    solution = error.copy()
    _solve_by_factor(factor, solution)
    step: Array = np.einsum("kin,in->kn", columns, solution)
    return step


def normal_matrix(columns: Array, damping: Array) -> Array:
    """Return the lower triangle of ``J J' + damping I``, (m, m, N); what is above it means nothing."""
    m = columns.shape[1]
    matrix = np.empty((m, m, columns.shape[2]))
    for i in range(m):
        np.einsum("kn,kjn->jn", columns[:, i], columns[:, : i + 1], out=matrix[i, : i + 1])
        matrix[i, i] += damping
    return matrix


def _factorise_cholesky(matrix: Array) -> None:
    """Replace the lower triangle by its Cholesky factor."""
    for j in range(len(matrix)):
        np.sqrt(matrix[j, j], out=matrix[j, j])
        matrix[j + 1 :, j] /= matrix[j, j]
        for i in range(j + 1, len(matrix)):
            matrix[i, j + 1 : i + 1] -= matrix[i, j] * matrix[j + 1 : i + 1, j]


def _solve_by_factor(factor: Array, right: Array) -> None:
    """Replace the right side by the solution of ``L L' x = right``."""
    m = len(factor)
    for j in range(m):
        right[j] /= factor[j, j]
        right[j + 1 :] -= factor[j + 1 :, j] * right[j]
    for j in reversed(range(m)):
        right[j] /= factor[j, j]
        right[:j] -= factor[j, :j] * right[j]
