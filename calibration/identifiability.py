"""What the measurements cannot determine, what it hides behind, and what would bring it out."""

from dataclasses import dataclass

import numpy as np

from calibration.estimator import Fit
from calibration.geometry import Array
from calibration.parameters import Parameter

_LEARNED = 0.5  # of the prior deviation: above, the prior speaks rather than the data
_PARTNER = 0.5  # of the variance
_STRONG = 0.95
_ARM_ROLES = ("offset", "geometry", "wire", "gravity")
_PLACE_ROLES = ("base", "anchor", "tool")


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


def correlations(fit: Fit) -> Array:
    """Return the correlation matrix of all parameters (p, p)."""
    sigma = np.sqrt(np.diag(fit.covariance))
    matrix: Array = fit.covariance / np.outer(sigma, sigma)
    return matrix


def not_identified(fit: Fit) -> tuple[NotIdentified, ...]:
    """Return every parameter of the arm or wire whose posterior deviation exceeds half its prior deviation.

    Its partner is the place of device or tool, or the one other parameter, whose knowledge would determine most
    of it. Ripple is left out: two dozen small terms say nothing to a reader, and priors keep them harmless.
    """
    sigma = np.sqrt(np.diag(fit.covariance))
    parameters = fit.layout.parameters
    learnt = sigma / fit.layout.prior
    weak = [
        i for i, parameter in enumerate(parameters) if parameter.role in _ARM_ROLES and learnt[i] > _LEARNED
    ]
    return tuple(_describe(fit, i, float(learnt[i])) for i in weak)


def _describe(fit: Fit, own: int, ratio: float) -> NotIdentified:
    parameters = fit.layout.parameters
    rho = correlations(fit)[own]
    partner, share = _partner(fit, own)
    if partner is None:
        return NotIdentified(parameters[own].name, "", _cure(parameters[own], None), ratio, 0.0)
    if partner.role in _PLACE_ROLES:
        same = [i for i, parameter in enumerate(parameters) if parameter.role == partner.role]
        partner = parameters[max(same, key=lambda i: abs(rho[i]))]
    return NotIdentified(parameters[own].name, _words(partner), _cure(parameters[own], partner), ratio, share)


def _partner(fit: Fit, own: int) -> tuple[Parameter | None, float]:
    """Return who hides a parameter: the share of its variance that would vanish if the other were known."""
    parameters, covariance = fit.layout.parameters, fit.covariance
    shares: dict[int, float] = {}
    for i, parameter in enumerate(parameters):
        if i == own or parameter.role == "harmonic":
            continue
        same = [j for j, other in enumerate(parameters) if other.role == parameter.role and j != own]
        block = same if parameter.role in _PLACE_ROLES else [i]
        cross, inner = covariance[own, block], covariance[np.ix_(block, block)]
        scale = np.sqrt(np.diag(inner))
        white = cross / scale
        known = white @ np.linalg.pinv(inner / np.outer(scale, scale), rcond=1e-10) @ white
        shares[i] = float(known / covariance[own, own])
    best = max(shares, key=lambda i: shares[i], default=-1)
    if best < 0 or shares[best] < _PARTNER:
        return None, 0.0
    return parameters[best], min(shares[best], 1.0)


def correlated_pairs(fit: Fit) -> tuple[CorrelatedPair, ...]:
    """Return pairs with a correlation beyond 0.95, strongest first, places of devices and tools left out."""
    rho, parameters = correlations(fit), fit.layout.parameters
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


def _words(parameter: Parameter) -> str:
    axis = parameter.name.split()[-1]
    if parameter.role == "base":
        motion = (
            f"rotation of the base about {axis[1]}"
            if axis.startswith("r")
            else f"shift of the base along {axis}"
        )
        return motion
    if parameter.role == "anchor":
        return f"place of the wire's anchor ({axis})"
    if parameter.role == "tool":
        motion = "rotation" if axis.startswith("r") else "place"
        return f"{motion} of the tool in the flange ({axis})"
    return parameter.name


def _cure(parameter: Parameter, partner: Parameter | None) -> str:
    if partner is None:
        where = f"with J{parameter.joint + 1} and its neighbours" if parameter.joint >= 0 else "with the arm"
        return f"these postures hardly show it: measure {where} over a wider range"
    if partner.role in ("base", "anchor"):
        return "record a point in the base frame, or measure the device's place from the base"
    if partner.role == "tool":
        return "use a target off the last axis whose place on the flange is known"
    if "wire" in (parameter.role, partner.role):
        return "check the wire's zero and scale against a known length"
    if parameter.role == "geometry" and partner.role == "geometry":
        return "none needed while the two act together: only their sum moves the tip in these postures"
    joints = sorted({p.joint + 1 for p in (parameter, partner) if p.joint >= 0})
    names = " and ".join(f"J{joint}" for joint in joints)
    return f"measure postures that turn {names} separately and further"
