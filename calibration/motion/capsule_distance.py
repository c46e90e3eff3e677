"""Distances from moving segments to segments, boxes and planes, for all postures at once."""

from typing import TypeAlias

import numpy as np

from calibration.geometry import Array

# Both ends of a segment in the base, (3, N) each or (3, 1).
Segment: TypeAlias = tuple[Array, Array]

_TINY = 1e-15
_HALVINGS = 40


def segment_distance(first: Segment, second: Segment) -> Array:
    """Return (N,) the distance between two segments [m]; either may be a point.

    References
    ----------
    C. Ericson, Real-Time Collision Detection, 2005, 5.1.9: closest points of two segments.
    """
    along, other = first[1] - first[0], second[1] - second[0]
    between = first[0] - second[0]
    a, e, b = _dot(along, along), _dot(other, other), _dot(along, other)
    c, f = _dot(along, between), _dot(other, between)
    across = a * e - b * b
    parallel = across <= _TINY + 1e-12 * a * e
    s = np.where(parallel, 0.0, np.clip((b * f - c * e) / np.where(parallel, 1.0, across), 0.0, 1.0))
    t = np.clip((b * s + f) / np.maximum(e, _TINY), 0.0, 1.0)
    s = np.clip((b * t - c) / np.maximum(a, _TINY), 0.0, 1.0)
    return np.asarray(np.linalg.norm(between + s * along - t * other, axis=0), dtype=np.float64)


def box_distance(segment: Segment, base_box: Array, size_m: Array) -> Array:
    """Return (N,) the distance of a segment from a box [m]; zero where it enters.

    The distance from a convex body is convex along a line: its slope is halved down to its zero.
    """
    turn, centre = base_box[:3, :3].T, base_box[:3, 3:4]
    start, stop = turn @ (segment[0] - centre), turn @ (segment[1] - centre)
    along, half = stop - start, np.reshape(size_m, (3, 1)) / 2.0

    def outside(share: Array) -> Array:
        point = start + share * along
        return np.asarray(point - np.clip(point, -half, half), dtype=np.float64)

    low, high = np.zeros(along.shape[1]), np.ones(along.shape[1])
    for _ in range(_HALVINGS):
        middle = (low + high) / 2.0
        falling = _dot(outside(middle), along) < 0.0
        low, high = np.where(falling, middle, low), np.where(falling, high, middle)
    return np.asarray(np.linalg.norm(outside((low + high) / 2.0), axis=0), dtype=np.float64)


def plane_distance(segment: Segment, point_m: Array, normal: Array) -> Array:
    """Return (N,) the height of the lower end of a segment above a plane [m], negative below."""
    unit = normal / np.linalg.norm(normal)
    heights = [unit @ (end - point_m[:, None]) for end in segment]
    return np.minimum(heights[0], heights[1])


def _dot(a: Array, b: Array) -> Array:
    return np.asarray((a * b).sum(axis=0), dtype=np.float64)
