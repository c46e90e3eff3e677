"""What the measurements cannot determine, what it hides behind, and what would bring it out."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from cellcal.calibration.geometry import Array
from cellcal.calibration.identification.estimator import ArmFit
from cellcal.calibration.identification.parameters import Parameter
from cellcal.calibration.message import join_messages, make_message

_LEARNED = 0.5  # of the prior deviation
_PARTNER = 0.5  # of the variance
_EXPLAINED = 0.9
_FEW_PARTNERS = 3
_MOST_PARTNERS = 8  # the lengths along parallel axes, a tool and a base, which only their sum moves
_STRONG = 0.95
_ONE_SUM_CURE = "none needed while they act together: only their sum moves the tip in these postures"
_ARM_ROLES = ("offset", "geometry", "wire", "gravity")
_PLACE_ROLES = ("base", "anchor", "tool")


class FreeUnknowns(Protocol):
    """The unknowns that were free in a fit."""

    @property
    def parameters(self) -> tuple[Parameter, ...]: ...
    @property
    def prior_sigmas(self) -> Array: ...


class UncertainEstimate(Protocol):
    """A fit of one device or of a cell."""

    @property
    def covariance(self) -> Array: ...
    @property
    def layout(self) -> FreeUnknowns: ...


@dataclass(frozen=True, slots=True)
class NotIdentified:
    """One parameter that the data leave where the prior put it."""

    parameter: str
    partner: str  # what moves with it unseen; empty if it simply does not show
    cure: str
    sigma_over_prior: float
    hidden_share: float  # of its variance, that knowledge of the partner would take away


@dataclass(frozen=True, slots=True)
class CorrelatedPair:
    """Two parameters whose estimates can hardly be told apart."""

    first: str
    second: str
    correlation: float


def is_learnt(sigma: float, prior: float) -> bool:
    """Whether the data determined a parameter: its deviation is below half of the prior one."""
    return sigma <= _LEARNED * prior


def parameter_correlations(fit: UncertainEstimate) -> Array:
    """Return the correlation matrix of all parameters (p, p)."""
    sigma = np.sqrt(np.diag(fit.covariance))
    matrix: Array = fit.covariance / np.outer(sigma, sigma)
    return matrix


def not_identified(fit: ArmFit) -> tuple[NotIdentified, ...]:
    """Return every parameter of arm or wire whose posterior deviation exceeds half its prior deviation.

    Its partners are the places and parameters whose knowledge would determine most of it. Ripple is left out:
    two dozen small terms say nothing to a reader, and their priors keep them harmless.
    """
    sigma = np.sqrt(np.diag(fit.covariance))
    parameters = fit.layout.parameters
    weak = [
        i
        for i, parameter in enumerate(parameters)
        if parameter.role in _ARM_ROLES and not is_learnt(sigma[i], fit.layout.prior_sigmas[i])
    ]
    return tuple(_describe_unknown(fit, i, float(sigma[i] / fit.layout.prior_sigmas[i])) for i in weak)


def _describe_unknown(fit: ArmFit, own: int, ratio: float) -> NotIdentified:
    parameters = fit.layout.parameters
    partners, share = _find_partners(fit, own)
    words = join_messages("; ", map(_describe_parameter, partners))
    return NotIdentified(
        parameters[own].name, words, _suggest_measurement(parameters[own], partners), ratio, share
    )


def _find_partners(fit: ArmFit, own: int) -> tuple[tuple[Parameter, ...], float]:
    parameters = fit.layout.parameters
    rho = np.abs(parameter_correlations(fit)[own])
    blocks, share = hiding_partners(fit, own, lambda p: p.role if p.role in _PLACE_ROLES else p.name)
    return tuple(parameters[max(block, key=lambda i: rho[i])] for block in blocks), share


def hiding_partners(
    fit: UncertainEstimate, own: int, block_of: Callable[[Parameter], str]
) -> tuple[tuple[list[int], ...], float]:
    """Return who hides a parameter: the fewest others that take its variance away if known.

    Three are enough where they take more than half of it away; with more than three (`acts_in_a_sum`) it is one
    term of a long sum. A place is one partner, however many coordinates it has: ``block_of`` names the block of a
    parameter.
    """
    blocks: dict[str, list[int]] = {}
    for i, parameter in enumerate(fit.layout.parameters):
        if i != own and parameter.role != "harmonic":
            blocks.setdefault(block_of(parameter), []).append(i)
    chosen: list[str] = []
    share = 0.0
    while share < (_EXPLAINED if len(chosen) < _FEW_PARTNERS else _PARTNER):
        if len(chosen) == min(_MOST_PARTNERS, len(blocks)):
            break
        candidates = {
            name: [i for c in (*chosen, name) for i in blocks[c]] for name in blocks if name not in chosen
        }
        shares = _variance_shares(fit, own, candidates)
        best = max(shares, key=lambda name: shares[name])
        chosen, share = [*chosen, best], shares[best]
    return (tuple(blocks[name] for name in chosen) if share >= _PARTNER else ()), share


def acts_in_a_sum(partners: Sequence[object]) -> bool:
    """Return whether so many partners hide a parameter that no single measurement brings it out."""
    return len(partners) > _FEW_PARTNERS


def _variance_shares(
    fit: UncertainEstimate, own: int, candidates: Mapping[str, list[int]]
) -> dict[str, float]:
    """Return the share of a parameter's variance that would vanish if the others were known, by candidate."""
    shares = dict.fromkeys(candidates, 0.0)  # in the order of the candidates: of equals the first is chosen
    for size in {len(others) for others in candidates.values()}:
        names = [name for name, others in candidates.items() if len(others) == size]
        others = np.array([candidates[name] for name in names])  # (c, size)
        inner = fit.covariance[others[:, :, None], others[:, None, :]]
        scale = np.sqrt(np.diagonal(inner, axis1=1, axis2=2))
        white = fit.covariance[own, others] / scale
        inverse = np.linalg.pinv(inner / (scale[:, :, None] * scale[:, None, :]), rcond=1e-10)
        variances = np.einsum("ci,cij,cj->c", white, inverse, white)
        shares.update(zip(names, np.minimum(variances / fit.covariance[own, own], 1.0).tolist(), strict=True))
    return shares


def correlated_pairs(fit: UncertainEstimate) -> tuple[CorrelatedPair, ...]:
    """Return pairs with a correlation beyond 0.95, strongest first, places of devices and tools left out."""
    rho, parameters = parameter_correlations(fit), fit.layout.parameters
    shown = [
        i
        for i, parameter in enumerate(parameters)
        if parameter.role in ("offset", "geometry", "wire", "gravity")
    ]
    pairs = [
        CorrelatedPair(parameters[i].name, parameters[j].name, float(rho[i, j]))
        for at, i in enumerate(shown)
        for j in shown[at + 1 :]
        if abs(rho[i, j]) > _STRONG
    ]
    return tuple(sorted(pairs, key=lambda pair: -abs(pair.correlation)))


def _describe_parameter(parameter: Parameter) -> str:
    axis = parameter.name.split()[-1]
    if parameter.role == "base":
        turns = axis.startswith("r")
        return (
            make_message("rotation of the base about {axis}", axis=axis[1:])
            if turns
            else make_message("shift of the base along {axis}", axis=axis)
        )
    if parameter.role == "anchor":
        return make_message("place of the wire's anchor ({axis})", axis=axis)
    if parameter.role == "tool":
        return make_message(
            "{detail} of the tool in the flange ({axis})",
            detail="rotation" if axis.startswith("r") else "place",
            axis=axis,
        )
    return parameter.name


def _suggest_measurement(parameter: Parameter, partners: tuple[Parameter, ...]) -> str:
    if acts_in_a_sum(partners):
        return _ONE_SUM_CURE
    roles = {partner.role for partner in partners}
    together = roles | {parameter.role}
    if roles & {"base", "anchor"}:
        return "record a point in the base frame, or measure the device's place from the base"
    if "tool" in roles:
        return "use a target off the last axis whose place on the flange is known"
    if partners and "wire" in together:
        return "check the wire's zero and scale against a known length"
    if partners and (together == {"geometry"} or _is_one_rotation(parameter, partners)):
        return _ONE_SUM_CURE
    return _suggest_rotation(parameter, partners)


def _is_one_rotation(parameter: Parameter, partners: tuple[Parameter, ...]) -> bool:
    """Return whether only an offset and the beta of one row are meant: without parallel axes they are one turn."""
    words = {p.name.split()[-1] for p in (parameter, *partners)}
    return words == {"offset", "beta"} and {p.joint for p in partners} == {parameter.joint}


def _suggest_rotation(parameter: Parameter, partners: tuple[Parameter, ...]) -> str:
    joints = sorted({p.joint + 1 for p in (parameter, *partners) if p.joint >= 0})
    names = " and ".join(f"J{joint}" for joint in joints) or "the arm"
    if not partners:
        return make_message(
            "these postures hardly show it: measure with {names} over a wider range", names=names
        )
    if len(joints) == 1:
        return make_message(
            "turn {names} and its neighbours further, with the tool in other attitudes", names=names
        )
    return make_message("measure postures that turn {names} separately and further", names=names)
