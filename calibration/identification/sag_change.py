"""A payload that was changed within a series: from one row on, the arm sags in another measure."""

from dataclasses import replace

import numpy as np
from numpy.linalg import LinAlgError

from cellcal.calibration.arm.joint_terms import gravity_terms, wrist_gravity_terms
from cellcal.calibration.errors import CalibrationError
from cellcal.calibration.geometry import Array
from cellcal.calibration.identification.estimator import FitProblem, estimate_arm, place_columns
from cellcal.calibration.identification.identify import Identification
from cellcal.calibration.identification.layouts import make_layout
from cellcal.calibration.identification.lints import Lint
from cellcal.calibration.identification.observations import LengthObservations, Rows
from cellcal.calibration.identification.parameters import GRAVITY
from cellcal.calibration.identification.quick_fit import spread_rows
from cellcal.calibration.identification.target_change import FEWEST_ROWS, orthonormal_columns
from cellcal.calibration.message import make_message

_MOST_ROWS = 400
_READINGS_PER_UNKNOWN = 2
_BETTER = 1.3  # times less must be left, than without a change and than with one of device or target
_RIDGE = 1e-9


def find_sag_change(found: Identification, file_rows: Rows) -> list[Lint]:
    """Return a note where the sag of the joints changed from one row on, and nothing simpler explains the rows.

    ``file_rows`` (N,) are the numbers of the identification's rows in the file.
    """
    rows = np.setdiff1d(spread_rows(len(file_rows), _MOST_ROWS), found.rejected)
    some = found.robust.problem.observations.select_rows(rows)
    model = found.state.nominal
    terms = (*gravity_terms(model), *wrist_gravity_terms(model))
    layout = make_layout(model, some.kind, found.state.mounting_count, level=GRAVITY, terms=terms)
    if (
        isinstance(some, LengthObservations)
        or not terms
        or len(found.state.devices) > 1
        or some.channels * len(some) < _READINGS_PER_UNKNOWN * (len(layout) + len(terms))
    ):
        return []
    state = replace(found.state, terms=terms, coefficients=np.zeros(len(terms)))
    try:
        problem = FitProblem.from_observations(state, some)
        state = estimate_arm(layout, state, problem).state
        columns, left = place_columns(layout, state, problem)
        best = _best_row(columns, left, layout.target_slice(0), len(terms))
    except (CalibrationError, LinAlgError):
        return []
    if best is None:
        return []
    at, before, after = best
    millimetres = float(np.median(some.sigma_m)) * 1e3 * np.sqrt(3.0)
    row = int(file_rows[rows[at]])
    says = make_message(
        "the arm sags otherwise from about row {row} on (counted from 0): the payload or the tool was changed. "
        "One sag for all rows leaves {before_mm:.3f} mm, two leave {after_mm:.3f} mm. Divide the file there and "
        "identify each part.",
        row=row,
        before_mm=before * millimetres,
        after_mm=after * millimetres,
    )
    return [Lint("payload", says, (row,))]


def _best_row(columns: Array, left: Array, target: slice, terms: int) -> tuple[int, float, float] | None:
    """Return from which row on the sag changed, and what is left without and with that, in deviations."""
    channels, count = left.shape
    plain = columns.transpose(2, 1, 0)  # (N, channels, p)
    base = orthonormal_columns(plain.reshape(channels * count, -1))
    values = left.T.reshape(-1)
    rest = values - base @ (base.T @ values)
    freedom = max(channels * count - base.shape[1], 1)
    of_base, rest_rows = base.reshape(count, channels, -1), rest.reshape(count, channels)
    square = float(rest @ rest)

    def drops(part: Array) -> Array:
        """Return by how much the square sum falls if these unknowns change at each row."""
        own = _sums_to_end(np.einsum("nci,ncj->nij", part, part))
        shared = _sums_to_end(np.einsum("nck,nci->nki", of_base, part))
        right = _sums_to_end(np.einsum("nci,nc->ni", part, rest_rows))
        matrix = own - shared.transpose(0, 2, 1) @ shared
        sizes = np.einsum("nii->ni", own)[:, :, None] * np.eye(part.shape[2])
        cuts = slice(FEWEST_ROWS, count - FEWEST_ROWS + 1)
        solved = np.linalg.solve(matrix[cuts] + _RIDGE * sizes[cuts], right[cuts][..., None])[..., 0]
        fallen: Array = np.einsum("ni,ni->n", right[cuts], solved)
        return fallen

    if count < 2 * FEWEST_ROWS:
        return None
    sag = drops(plain[..., -terms:])
    scatter = (square - float(sag.max())) / max(freedom - terms - 1, 1)
    rivals = [
        (square - float(drops(other).max())) / max(freedom - other.shape[2] - 1, 1)
        for other in (plain[..., :6], plain[..., target])
    ]
    ramp = np.linspace(0.0, 1.0, count)[:, None, None] * plain[..., :6]
    moved = orthonormal_columns(np.concatenate([base, ramp.reshape(channels * count, -1)], axis=1))
    drifted = rest - moved @ (moved.T @ rest)
    rivals.append(float(drifted @ drifted) / max(freedom - 6, 1))
    if _BETTER**2 * scatter > min(square / freedom, *rivals):
        return None
    return FEWEST_ROWS + int(np.argmax(sag)), float(np.sqrt(square / freedom)), float(np.sqrt(scatter))


def _sums_to_end(parts: Array) -> Array:
    found: Array = np.cumsum(parts[::-1], axis=0)[::-1]
    return found
