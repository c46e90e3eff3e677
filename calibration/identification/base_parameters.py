"""The parameters that measurements can tell apart at all: a base subset, chosen in order of preference."""

from dataclasses import replace

import numpy as np

from cellcal.calibration.geometry import Array
from cellcal.calibration.identification.estimator import FitProblem, place_columns
from cellcal.calibration.identification.observations import Observations
from cellcal.calibration.identification.parameters import ArmState, ParameterLayout

_INDEPENDENT = 1e-6  # of a column's length, in prior deviations: the gap is ten orders wide


def base_subset(layout: ParameterLayout, state: ArmState, observations: Observations) -> ParameterLayout:
    """Return the layout without every geometry parameter that earlier parameters can imitate.

    Parameters
    ----------
    layout : Layout
        In order of preference: devices and tool, offsets, then the rest of the geometry.
    state : ArmState
        Where to look: structure does not depend on small errors.
    observations : Observations
        A few hundred random postures for what the arm allows, or those measured for what they allow.

    Returns
    -------
    Layout
        With the same devices, tool and joint terms.

    Notes
    -----
    Columns are scaled by prior deviations first: millimetres and radians decide rank on one scale.
    """
    columns, _ = place_columns(layout, state, FitProblem.from_observations(state, observations))
    scaled = columns.reshape(len(columns), -1) * layout.prior_sigmas[:, None]
    first = layout.shared_count + (6 if layout.kind == "pose" else 3)
    count = len(layout.geometry)
    offsets = [i for i in range(count) if layout.parameters[first + i].role == "offset"]
    order = [*offsets, *(i for i in range(count) if i not in offsets)]
    fixed = [*range(first), *range(first + count, len(layout))]
    basis = _orthonormal_basis(scaled[fixed])
    subset = []
    for i in order:
        column = scaled[first + i]
        # Twice is enough: one projection leaves rounding of the first behind.
        rest = _component_outside(_component_outside(column, basis), basis)
        size = float(np.linalg.norm(rest))
        if size > _INDEPENDENT * float(np.linalg.norm(column)):
            subset.append(i)
            basis = np.vstack([basis, rest / size])
    subset.sort()
    parameters = [
        p for i, p in enumerate(layout.parameters) if not first <= i < first + count or i - first in subset
    ]
    return replace(layout, parameters=tuple(parameters), geometry=tuple(layout.geometry[i] for i in subset))


def _component_outside(column: Array, basis: Array) -> Array:
    rest: Array = column - (column @ basis.T) @ basis
    return rest


def _orthonormal_basis(rows: Array) -> Array:
    basis: Array = np.linalg.qr(rows.T)[0].T
    return basis
