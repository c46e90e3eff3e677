"""How surely a fit tells where the target is, at any posture; and how surely it tells a table of numbers."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from cellcal.calibration.arm.joint_terms import term_values
from cellcal.calibration.arm.kinematics import RobotModel, chain_frames, cross_product, placement_columns
from cellcal.calibration.arm.standard_dh import hayati_dh, parallel_rows
from cellcal.calibration.geometry import Array
from cellcal.calibration.identification.estimator import ArmFit
from cellcal.calibration.identification.parameters import ArmState, ParameterLayout

_SHARE = 1e-3  # of a prior deviation: small enough to be linear, large enough to be seen
_LARGEST = 1e-4  # metres or radians
_STRONG = 0.95
_COLUMNS = (("offset", "rad"), ("d", "m"), ("a", "m"), ("alpha", "rad"), ("beta", "rad"))


@dataclass(frozen=True, eq=False)
class TipPrediction:
    """Places of the target in the device's frame; for lengths, in the robot's base."""

    positions_m: Array  # (N, 3)
    covariance_m2: Array  # (N, 3, 3), of the model's parameters alone


def predict_tips(fit: ArmFit, joints_rad: Array, *, mounting: int = -1) -> TipPrediction:
    """Return where the target is at postures (N, n), with the covariance that the parameters leave."""
    state = fit.state
    chain = state.seen_from(mounting % state.mounting_count)
    moved = state.moved_joints(joints_rad, term_values(state.nominal, joints_rad, state.terms))
    slopes = tip_slopes(fit.layout, state, joints_rad, mounting=mounting)
    return TipPrediction(
        chain.base_flange(moved)[:, :3, 3],
        np.einsum("pin,pq,qjn->nij", slopes, fit.covariance, slopes, optimize=True),
    )


def tip_slopes(layout: ParameterLayout, state: ArmState, joints_rad: Array, *, mounting: int = -1) -> Array:
    """Return how the target's place follows every free parameter (p, 3, N) [m]."""
    at = mounting % state.mounting_count
    values = term_values(state.nominal, joints_rad, state.terms)
    rotations, origins = chain_frames(state.seen_from(at), state.moved_joints(joints_rad, values))
    placed = placement_columns(rotations, origins, origins[-1])
    turned = cross_product(rotations[:-1, :, 2], origins[-1] - origins[:-1])
    if (slides := state.nominal.sliding) is not None:
        turned[slides] = rotations[:-1, :, 2][slides]
    joints = np.array([term.joint for term in state.terms], dtype=np.intp)
    columns = np.concatenate([placed.reshape(-1, *origins.shape[1:]), turned[joints] * values[:, None]])
    tangent = layout.tangent_rows(state, at)[:, : len(columns)]  # behind them stand columns of a wire's own
    slopes: Array = np.tensordot(tangent, columns, axes=1)
    return slopes


def offset_slopes(fit: ArmFit) -> dict[str, Array]:
    """Return how the joint offsets follow the free parameters (p,): as a table of four numbers a joint has them.

    Where axes are not parallel an offset and its row's beta do the same, and only the table's offset is one
    number. A model without a table has its offsets as they are fitted. Offsets that no free parameter moves are
    left out.
    """
    free = [p.name for p in fit.layout.parameters]
    names = [f"J{i + 1} offset" for i in range(fit.state.nominal.axis_count)]
    if fit.state.nominal.dh is None:
        return {name: np.eye(len(free))[free.index(name)] for name in names if name in free}
    nominal = fit.state.nominal
    slopes = _parameter_slopes(fit, lambda model: hayati_dh(model, nominal).table.to_rows()[:, 0])
    return {name: slopes[:, i] for i, name in enumerate(names) if name in free}


@dataclass(frozen=True, slots=True)
class TableEntry:
    """One number of a DH table: nominal, identified, and how surely."""

    name: str
    unit: str  # rad | m
    nominal: float
    value: float
    sigma: float


@dataclass(frozen=True, eq=False)
class HayatiTable:
    """An identified arm in four numbers a joint, and the pairs of them that can hardly be told apart."""

    entries: tuple[TableEntry, ...]
    correlated: tuple[tuple[str, str, float], ...]


def hayati_table(fit: ArmFit) -> HayatiTable:
    """Return the rigid arm of a fit as DH, with beta instead of d where nominal axes are parallel.

    Raises
    ------
    CalibrationError
        The nominal model has no DH table.
    """
    nominal = fit.state.nominal

    def table_of(model: RobotModel) -> Array:
        return hayati_dh(model, nominal).table.to_rows()

    found, slopes = table_of(fit.state.arm_model), _parameter_slopes(fit, table_of)
    covariance = np.einsum("pab,pq,qcd->abcd", slopes, fit.covariance, slopes)
    shown = _table_entries(nominal)
    sigma = {(i, j): float(np.sqrt(max(covariance[i, j, i, j], 0.0))) for i, j in shown}
    nominal_rows = nominal.dh.to_rows() if nominal.dh is not None else found
    entries = tuple(
        TableEntry(
            f"J{i + 1} {_COLUMNS[j][0]}",
            _COLUMNS[j][1],
            float(nominal_rows[i, j]),
            float(found[i, j]),
            sigma[i, j],
        )
        for i, j in shown
    )
    names = dict(zip(shown, (entry.name for entry in entries), strict=True))
    free = {p.name for p in fit.layout.parameters}
    fitted = [entry for entry in shown if names[entry] in free]
    pairs = []
    for at, one in enumerate(fitted):
        for other in fitted[at + 1 :]:
            scale = sigma[one] * sigma[other]
            rho = float(covariance[(*one, *other)]) / scale if scale > 0 else 0.0
            if abs(rho) > _STRONG:
                pairs.append((names[one], names[other], rho))
    return HayatiTable(entries, tuple(sorted(pairs, key=lambda pair: -abs(pair[2]))))


def _table_entries(nominal: RobotModel) -> list[tuple[int, int]]:
    """Return the entries that a table of four numbers a joint has; the last row ends in the tool."""
    parallel = parallel_rows(nominal)
    last = nominal.axis_count - 1
    return [
        (i, j)
        for i in range(nominal.axis_count)
        for j in range(5)
        if (i != last and j != (1 if i in parallel else 4)) or (i == last and j < 2)
    ]


def _parameter_slopes(fit: ArmFit, function: Callable[[RobotModel], Array]) -> Array:
    """Return derivatives (p, …) of what an arm model has by every free parameter, by central differences."""
    steps = np.minimum(_SHARE * fit.layout.prior_sigmas, _LARGEST)
    slopes = np.zeros((len(steps), *function(fit.state.arm_model).shape))
    for i, step in enumerate(steps):
        change = np.zeros(len(steps))
        change[i] = step
        there, back = (fit.layout.apply_step(fit.state, sign * change) for sign in (1.0, -1.0))
        # Places and joint terms leave the model as it is.
        if not np.array_equal(there.geometry, back.geometry):
            slopes[i] = (function(there.arm_model) - function(back.arm_model)) / (2 * step)
    return slopes
