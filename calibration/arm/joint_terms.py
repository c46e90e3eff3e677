"""What a joint does beside turning by its angle: sagging under weight, ripple and a wrong ratio of its gear.

A term adds ``coefficient * f(q)`` to one DH angle. ``f`` is taken from the nominal arm, so that it is a fixed
column of numbers for given joints: its own change with the errors being sought is of second order.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from cellcal.calibration.arm.kinematics import RobotModel, chain_frames, cross_product
from cellcal.calibration.geometry import Array
from cellcal.calibration.message import make_message

_SHORTEST_LEVER_M = 0.02
_ASIDE = ("x", "y")  # axes of the flange
_ASIDE_M = 0.1
_POSTURES = np.linspace(-1.5, 1.5, 13)


@dataclass(frozen=True, slots=True)
class JointTerm:
    """One term: which joint it moves (0-based), by what."""

    kind: str  # gravity | harmonic | gear
    joint: int
    link: int = 0  # gravity: the link whose weight it is
    order: int = 0  # harmonic: periods per turn of the joint
    phase: str = ""  # harmonic: cos | sin
    source: int = 0  # gear: the joint whose angle it follows
    aside: str = ""  # gravity: x | y, a weight beside the flange's axis in place of a link's

    @property
    def name(self) -> str:
        """A name for people: joints and links count from one."""
        joint = self.joint + 1
        if self.kind == "gravity" and self.aside:
            return make_message("J{joint} sag under payload {aside}", joint=joint, aside=self.aside)
        if self.kind == "gravity":
            return make_message("J{joint} sag under link {link}", joint=joint, link=self.link + 1)
        if self.kind == "gear" and self.source == self.joint:
            return make_message("J{joint} gear ratio", joint=joint)
        if self.kind == "gear":
            return make_message("J{joint} coupling to J{source}", joint=joint, source=self.source + 1)
        return make_message(
            "J{joint} ripple {phase} {order}", joint=joint, phase=self.phase, order=self.order
        )


def gravity_terms(model: RobotModel) -> tuple[JointTerm, ...]:
    """Return the sag of every joint that carries links and is not upright, except the last two of the wrist.

    Joint i sags by ``c_ik z_i . (g x l_k)``: the lever of link vector l_k under its weight, for each link k
    at or after the joint. Levers that never reach 20 mm are left out: an upright joint has none, and a link
    along the joint's own axis has none either.
    """
    n = model.axis_count
    turning = _turning(model)
    candidates = tuple(
        JointTerm("gravity", joint, link)
        for joint in range(n - 2)
        if turning[joint]
        for link in range(joint, n - 2)
    )
    levers = np.abs(term_values(model, _POSTURES[:, None] * np.ones(n), candidates)).max(axis=1)
    return tuple(term for term, lever in zip(candidates, levers, strict=True) if lever > _SHORTEST_LEVER_M)


def wrist_gravity_terms(model: RobotModel) -> tuple[JointTerm, ...]:
    """Return the sag that `gravity_terms` leaves out: of the wrist's joints, and under its links and the payload.

    A payload's centre of mass along the flange's axis is the last link's weight; beside the axis it is a lever of
    100 mm along x or y of the flange, so that a coefficient means as much as that of a link.
    """
    n = model.axis_count
    near = {(term.joint, term.link) for term in gravity_terms(model)}
    turning = _turning(model)
    links = [(j, k) for j in range(n) if turning[j] for k in range(j, n) if (j, k) not in near]
    candidates = tuple(JointTerm("gravity", joint, link) for joint, link in links)
    candidates += tuple(
        JointTerm("gravity", j, n, aside=axis) for j in range(n) if turning[j] for axis in _ASIDE
    )
    levers = np.abs(term_values(model, _POSTURES[:, None] * np.ones(n), candidates)).max(axis=1)
    return tuple(term for term, lever in zip(candidates, levers, strict=True) if lever > _SHORTEST_LEVER_M)


def harmonic_terms(model: RobotModel, orders: tuple[int, ...] = (1, 2)) -> tuple[JointTerm, ...]:
    """Return cosine and sine of every turning joint's angle, for each order."""
    return tuple(
        JointTerm("harmonic", joint, order=order, phase=phase)
        for joint in np.flatnonzero(_turning(model)).tolist()
        for order in orders
        for phase in ("cos", "sin")
    )


def gear_terms(model: RobotModel) -> tuple[JointTerm, ...]:
    """Return ``(1 + e) q_i`` of every joint, and ``c_ik q_k`` where gears and linkages do couple joints.

    Those are J3 behind J2 (a linkage, or a motor at the shoulder), and the wrist's last two joints, whose shafts
    run through the joints before them.
    """
    n = model.axis_count
    coupled = [(2, 1)] if n > 2 else []
    coupled += [(joint, source) for joint in range(max(n - 2, 3), n) for source in range(n - 3, joint)]
    turning = _turning(model)
    coupled = [(joint, source) for joint, source in coupled if turning[joint] and turning[source]]
    ratios = (JointTerm("gear", joint, source=joint) for joint in range(n))
    return (*ratios, *(JointTerm("gear", joint, source=source) for joint, source in coupled))


def _turning(model: RobotModel) -> NDArray[np.bool_]:
    """Return which joints turn: one that slides has no lever, and no periods of a turn."""
    return np.ones(model.axis_count, dtype=bool) if model.sliding is None else ~model.sliding


def term_values(
    model: RobotModel,
    joints_rad: Array,
    terms: tuple[JointTerm, ...],
    gravity_in_base: tuple[float, float, float] | None = None,
) -> Array:
    """Return ``f`` of every term for every posture, (K, N): metres of lever, 1, or radians.

    Gravity pulls as the model is mounted, unless a direction is given.
    """
    joints = np.asarray(joints_rad, dtype=float)
    values = np.empty((len(terms), len(joints)))
    if any(term.kind == "gravity" for term in terms):
        rotations, origins = chain_frames(model, joints)
        links = np.diff(origins, axis=0)
        axes = rotations[:-1, :, 2]
        down = np.asarray(model.gravity_in_base if gravity_in_base is None else gravity_in_base)
        # z . (l x g) = g . (z x l)
        beside = {axis: _ASIDE_M * rotations[-1][:, i] for i, axis in enumerate(_ASIDE)}
        across = {
            t: down @ cross_product(axes[t.joint], beside[t.aside] if t.aside else links[t.link])
            for t in terms
            if t.kind == "gravity"
        }
    for row, term in enumerate(terms):
        if term.kind == "gravity":
            values[row] = across[term]
        elif term.kind == "gear":
            values[row] = joints[:, term.source]
        else:
            wave = np.cos if term.phase == "cos" else np.sin
            values[row] = wave(term.order * joints[:, term.joint])
    return values
