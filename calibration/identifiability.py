"""What the measurements cannot determine, what it hides behind, and what would bring it out."""

from dataclasses import dataclass

import numpy as np

from calibration.estimator import Fit
from calibration.geometry import Array
from calibration.parameters import Parameter

_LEARNED = 0.5  # of the prior deviation: above, the prior speaks rather than the data
_PARTNER = 0.5
_STRONG = 0.95


@dataclass(frozen=True, slots=True)
class NotIdentified:
    """One parameter that the data leave where the prior put it."""

    parameter: str
    partner: str  # what moves with it unseen; empty if it simply does not show
    cure: str
    sigma_over_prior: float
    correlation: float


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

    Ripple is left out: two dozen small terms say nothing to a reader, and their priors keep them harmless.
    """
    rho = correlations(fit)
    sigma = np.sqrt(np.diag(fit.covariance))
    parameters = fit.layout.parameters
    found = []
    for i, parameter in enumerate(parameters):
        ratio = float(sigma[i] / parameter.prior)
        if parameter.role in ("base", "anchor", "tool", "harmonic") or ratio <= _LEARNED:
            continue
        j = _partner(rho[i], i, parameters)
        together = abs(float(rho[i, j])) >= _PARTNER
        other = parameters[j] if together else None
        partner = "" if other is None else _words(other, parameters)
        found.append(NotIdentified(parameter.name, partner, _cure(parameter, other), ratio, float(rho[i, j])))
    return tuple(found)


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


def _partner(rho: Array, own: int, parameters: tuple[Parameter, ...]) -> int:
    strength = np.abs(rho)
    strength[own] = 0.0
    # Of equals, the place of a device or tool explains more to a reader than another small parameter.
    bonus = np.array([0.05 * (parameter.role in ("base", "anchor", "tool")) for parameter in parameters])
    return int(np.argmax(strength + bonus * (strength > _PARTNER)))


def _words(parameter: Parameter, parameters: tuple[Parameter, ...]) -> str:
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
