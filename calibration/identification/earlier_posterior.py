"""What an earlier fit left known about an arm, as the prior of the next: all parameters together.

An arm's parameters are known together far better than each: an offset and its row's beta turn the same way. Priors
of the estimator are independent, so the fit is made in coordinates in which the earlier posterior is, and told in
the parameters again.
"""

from dataclasses import dataclass, replace

import numpy as np
import scipy  # loads a part of it when that is first used

from cellcal.calibration.geometry import Array
from cellcal.calibration.identification.estimator import ArmFit, estimate_arm
from cellcal.calibration.identification.free_parameters import PartLayout
from cellcal.calibration.identification.parameters import ArmState, ParameterLayout
from cellcal.calibration.identification.robust import RobustFit

_BY_CHANCE = 1e-3
_JITTER = 1e-12  # of a variance: stored numbers are rounded


@dataclass(frozen=True, eq=False)
class EarlierPosterior:
    """Covariance of some of an arm's parameters, by their names."""

    names: tuple[str, ...]
    covariance: Array  # (k, k) SI


@dataclass(frozen=True, eq=False)
class DecorrelatedLayout(ParameterLayout):
    """The unknowns of a layout in coordinates z in which the earlier posterior is independent: x = mean + L z."""

    plain: PartLayout
    root: Array  # L (p, p)

    def prior_deviations(self, state: ArmState) -> Array:
        """Return z (p,)."""
        z: Array = np.asarray(np.linalg.solve(self.root, self.plain.prior_deviations(state)), dtype=float)
        return z

    def tangent_rows(self, state: ArmState, mounting: int) -> Array:
        """Return what each z does."""
        rows: Array = self.root.T @ self.plain.tangent_rows(state, mounting)
        return rows

    def apply_step(self, state: ArmState, change: Array) -> ArmState:
        """Return the state after a step of z (p,)."""
        return self.plain.apply_step(state, self.root @ change)


def decorrelate_layout(plain: PartLayout, posterior: EarlierPosterior) -> DecorrelatedLayout:
    """Return a layout with the earlier posterior as its prior; what it does not name keeps its own."""
    root = np.diag(plain.prior_sigmas)
    at = [i for i, parameter in enumerate(plain.parameters) if parameter.name in posterior.names]
    if at:
        rows = [posterior.names.index(plain.parameters[i].name) for i in at]
        covariance = posterior.covariance[np.ix_(rows, rows)]
        # No arm is known worse than an arm without any earlier data.
        scale = np.minimum(np.sqrt(np.diag(covariance)), plain.prior_sigmas[at])
        size = np.sqrt(np.diag(covariance))
        correlation = covariance / np.outer(size, size) + _JITTER * np.eye(len(at))
        root[np.ix_(at, at)] = scale[:, None] * np.linalg.cholesky(correlation)
    parameters = tuple(replace(parameter, prior=1.0) for parameter in plain.parameters)
    return DecorrelatedLayout(
        parameters, plain.kind, plain.mountings, plain.geometry, plain.terms, plain=plain, root=root
    )


def to_arm_parameters(fit: ArmFit) -> ArmFit:
    """Return a fit in the parameters of the arm, whatever coordinates it was made in."""
    layout = fit.layout
    if not isinstance(layout, DecorrelatedLayout):
        return fit
    covariance = layout.root @ fit.covariance @ layout.root.T
    return replace(fit, layout=layout.plain, covariance=covariance, deviations=layout.root @ fit.deviations)


@dataclass(frozen=True, slots=True)
class OffsetContradiction:
    """A joint offset that rows want elsewhere than an earlier fit has it."""

    parameter: str
    moved_rad: float
    by_chance: float  # probability


def contradicted_offsets(robust: RobustFit, posterior: EarlierPosterior) -> tuple[OffsetContradiction, ...]:
    """Return joint offsets whose earlier value rows contradict, worst first: mastering is lost one joint at a time.

    Each offset is let go alone; Fisher's F tells whether what is gained could be chance, so that noise may be of
    any size.
    """
    layout, fit = robust.fit.layout, robust.fit
    if not isinstance(layout, DecorrelatedLayout):
        return ()
    weights = np.ones(len(robust.problem.observations))
    weights[robust.rejected] = 0.0
    freedom = max(robust.degrees_of_freedom - 1.0, 1.0)
    found = []
    for i, parameter in enumerate(layout.plain.parameters):
        if parameter.role != "offset" or parameter.name not in posterior.names:
            continue
        at = posterior.names.index(parameter.name)
        loose = posterior.covariance.copy()
        loose[at, :] = loose[:, at] = 0.0
        loose[at, at] = parameter.prior**2
        free = estimate_arm(
            decorrelate_layout(layout.plain, replace(posterior, covariance=loose)),
            fit.state,
            robust.problem,
            weights,
        )
        gain = (fit.cost - free.cost) / max(free.cost / freedom, 1e-300)
        chance = float(scipy.special.fdtrc(1.0, freedom, max(gain, 0.0)))
        if chance < _BY_CHANCE:
            moved = float(layout.plain.prior_deviations(free.state)[i])
            found.append(OffsetContradiction(parameter.name, moved, chance))
    return tuple(sorted(found, key=lambda item: item.by_chance))
