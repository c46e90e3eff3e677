"""Robots' bases seen from one another, from all their alignments with one fixture in one fit.

Two alignments taken with one wire share its scale, lip and slow linearity, and every robot found the same points of
the same fixture: what the drawing has wrong is the same for all, and falls out between bases.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from cellcal.calibration.errors import CalibrationError
from cellcal.calibration.geometry import Array, Pose, adjoint_matrix, exp_twist, skew_matrix
from cellcal.calibration.points.alignment import Alignment, WirePoints
from cellcal.calibration.points.fixture import BaseToBase, base_through_fixture
from cellcal.calibration.uncertainty import chi_square_limit

_MAX_ITERATIONS, _SETTLED = 20, 1e-13


@dataclass(frozen=True, slots=True)
class JointBases:
    """Every base but the first, seen from the first; and whether all robots found the fixture's shape."""

    bases: tuple[BaseToBase, ...]
    jointly: bool  # False: chained one by one, because an alignment does not say what its wire told
    chi_square: float  # of the points found against one drawing; 0 where they were chained
    degrees_of_freedom: int

    def is_consistent(self) -> bool:
        """Return whether all robots found one shape of the fixture at 99.9 %."""
        return self.degrees_of_freedom == 0 or self.chi_square <= chi_square_limit(self.degrees_of_freedom)


def bases_together(alignments: Sequence[Alignment]) -> JointBases:
    r"""Return robots' bases seen from the first robot's, through a fixture that all are aligned with.

    Each alignment is a Gaussian over the points it found and its wire's numbers. Without what was believed of
    the wire before, which counts once for each wire, they are multiplied; then ``found_rk = T_r (p_k + d_k) + e_rk``
    with the drawing's errors d common to the robots and seats e of each, by generalised least squares over all T.

    Parameters
    ----------
    alignments : sequence of Alignment, n >= 2
        Of robots with the same points of the same fixture; the first robot's base is the one seen from.

    Returns
    -------
    JointBases
        n - 1 bases. Where an alignment does not say what its wire told, Eq. 9 with independent alignments.

    Raises
    ------
    CalibrationError
        Fewer than two alignments, or points that differ.

    Notes
    -----
    The fast part of the wire's linearity, which two surveys with one wire share as well, is taken as independent:
    that states U 1 to 2 % too small (from the covariances of facing robots).

    References
    ----------
    F. S. Cheng, Calibration of Robot Reference Frames for Enhanced Robot Positioning Accuracy, 2008, Eq. 9. The fit
    is the generalised least squares of `calibration.points.fixture.place_points`, for several frames.
    """
    if len(alignments) < 2:
        raise CalibrationError("a base is seen from another one: two alignments are needed")
    if any(a.points_in_fixture_m != alignments[0].points_in_fixture_m for a in alignments):
        raise CalibrationError("the alignments name different points of the fixture")
    points_of_robots = [alignment.points for alignment in alignments]
    measured_points = [points for points in points_of_robots if points is not None]
    if len(measured_points) < len(points_of_robots):
        return _chain_alignments(alignments)
    drawing = np.array(alignments[0].points_in_fixture_m)
    poses = [alignment.base_fixture.to_matrix() for alignment in alignments]
    found, covariance = _points_together(measured_points)
    weight = np.linalg.inv(covariance + _seat_covariance(measured_points, poses, len(drawing)))
    for _ in range(_MAX_ITERATIONS):
        residual, jacobian = _fixture_misfit(poses, drawing, found)
        spread = np.asarray(np.linalg.inv(jacobian.T @ weight @ jacobian), dtype=np.float64)
        step = spread @ jacobian.T @ weight @ residual
        poses = [pose @ exp_twist(step[6 * r : 6 * r + 6]) for r, pose in enumerate(poses)]
        if np.abs(step).max() < _SETTLED:
            break
    residual, _ = _fixture_misfit(poses, drawing, found)
    bases = tuple(_base_between(poses, spread, other) for other in range(1, len(poses)))
    return JointBases(bases, True, float(residual @ weight @ residual), len(residual) - 6 * len(poses))


def _chain_alignments(alignments: Sequence[Alignment]) -> JointBases:
    """Chain every alignment with the first one's, as if they shared nothing."""
    first = alignments[0]
    bases = tuple(
        base_through_fixture(
            other.base_fixture, np.array(other.covariance), first.base_fixture, np.array(first.covariance)
        )
        for other in alignments[1:]
    )
    return JointBases(bases, False, 0.0, 0)


def _points_together(measured_points: Sequence[WirePoints]) -> tuple[Array, Array]:
    """Return all points (3 n k,) [m] and their covariance, what is believed of a wire counted once."""
    wires = [points.wire or f"unnamed {r}" for r, points in enumerate(measured_points)]
    names, size = list(dict.fromkeys(wires)), 3 * len(measured_points[0].found_m)
    every, own_numbers = size * len(measured_points), len(measured_points[0].of_wire)
    whole = every + own_numbers * len(names)
    information, pull = np.zeros((whole, whole)), np.zeros(whole)
    for r, points in enumerate(measured_points):
        at = every + own_numbers * names.index(wires[r])
        index = [*range(size * r, size * r + size), *range(at, at + own_numbers)]
        mean = np.array([*np.ravel(points.found_m), *points.of_wire])
        own = np.linalg.inv(np.array(points.covariance))
        first = wires.index(wires[r]) == r  # the others bring no belief of their own
        believed, weight = _wire_prior(points, size)
        information[np.ix_(index, index)] += own if first else own - weight
        pull[index] += own @ mean if first else own @ mean - weight @ believed
    covariance = np.asarray(np.linalg.inv(information), dtype=np.float64)
    together: Array = covariance @ pull
    return together[:every], covariance[:every, :every]


def _wire_prior(points: WirePoints, size: int) -> tuple[Array, Array]:
    """Return the prior mean and information matrix (inverse covariance) of a wire's parameters."""
    believed = np.array([*np.zeros(size), *points.believed])
    return believed, np.diag([*np.zeros(size), *(sigma**-2 for sigma in points.sigma)])


def _seat_covariance(measured_points: Sequence[WirePoints], poses: Sequence[Array], count: int) -> Array:
    """Return (3 n k, 3 n k) [m^2]: seats of each robot's own, and the drawing's errors, which all robots saw."""
    seats = np.repeat([points.sigma_seat_m**2 for points in measured_points], 3 * count)
    common = np.vstack(
        [
            points.sigma_drawing_m * np.kron(np.eye(count), pose[:3, :3])
            for points, pose in zip(measured_points, poses, strict=True)
        ]
    )
    total: Array = np.diag(seats) + common @ common.T
    return total


def _fixture_misfit(poses: Sequence[Array], drawing: Array, found: Array) -> tuple[Array, Array]:
    size = 3 * len(drawing)
    jacobian, fitted = np.zeros((size * len(poses), 6 * len(poses))), []
    for r, pose in enumerate(poses):
        rotation = pose[:3, :3]
        fitted.append((drawing @ rotation.T + pose[:3, 3]).ravel())
        columns = [np.broadcast_to(rotation, (len(drawing), 3, 3)), -rotation @ skew_matrix(drawing)]
        block = np.concatenate(columns, axis=2).reshape(-1, 6)
        jacobian[size * r : size * (r + 1), 6 * r : 6 * r + 6] = block
    return found - np.concatenate(fitted), jacobian


def _base_between(poses: Sequence[Array], spread: Array, other: int) -> BaseToBase:
    """Return another base seen from the first: ``A_0 exp(a_0) exp(-a) A^-1``, all covariances of both."""
    first, own = slice(0, 6), slice(6 * other, 6 * other + 6)
    turns = spread[first, first] + spread[own, own] - spread[first, own] - spread[own, first]
    twist_adjoint = adjoint_matrix(poses[other])
    total = twist_adjoint @ turns @ twist_adjoint.T
    pose = Pose.from_matrix(poses[0] @ np.linalg.inv(poses[other]))
    return BaseToBase(pose, tuple(tuple(float(v) for v in row) for row in (total + total.T) / 2.0))
