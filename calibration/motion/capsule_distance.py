"""Distances from moving segments to segments, boxes and planes, for all postures at once."""

from collections.abc import Sequence
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from cellcal.calibration.geometry import Array

# Both ends of a segment in the base, (3, N) each or (3, 1); of several at once (3, S, N).
Segment: TypeAlias = tuple[Array, Array]

_TINY = 1e-15
MANY_POSTURES = 256


def segment_distance(first: Segment, second: Segment) -> Array:
    """Return (N,) or (S, N) the distance between two segments [m]; either may be a point.

    References
    ----------
    C. Ericson, Real-Time Collision Detection, 2005, 5.1.9: closest points of two segments.
    """
    along, other = first[1] - first[0], second[1] - second[0]
    between = first[0] - second[0]
    a, e, b = _dot_product(along, along), _dot_product(other, other), _dot_product(along, other)
    c, f = _dot_product(along, between), _dot_product(other, between)
    across = a * e - b * b
    parallel = across <= _TINY + 1e-12 * a * e
    s = np.where(parallel, 0.0, np.clip((b * f - c * e) / np.where(parallel, 1.0, across), 0.0, 1.0))
    t = np.clip((b * s + f) / np.maximum(e, _TINY), 0.0, 1.0)
    s = np.clip((b * t - c) / np.maximum(a, _TINY), 0.0, 1.0)
    return np.asarray(np.linalg.norm(between + s * along - t * other, axis=0), dtype=np.float64)


def join_segments(segments: Sequence[Segment], count: int) -> Segment:
    """Return segments of N = ``count`` postures together: both ends (3, S, N)."""
    ends = np.empty((2, 3, len(segments), count))
    for k, (start, stop) in enumerate(segments):
        ends[0, :, k], ends[1, :, k] = start, stop
    return ends[0], ends[1]


def pair_distances(pairs: Sequence[tuple[Segment, Segment]], count: int) -> Sequence[Array]:
    """Return (N,) the distance of each pair of segments, of N = ``count`` postures [m].

    Of few postures all pairs at once, because calls cost more than numbers; of many one by one, for the cache.
    """
    if count > MANY_POSTURES:
        return [segment_distance(first, second) for first, second in pairs]
    firsts, seconds = ([pair[k] for pair in pairs] for k in (0, 1))
    return list(segment_distance(join_segments(firsts, count), join_segments(seconds, count)))


def box_distance(segment: Segment, base_box: Array, size_m: Array) -> Array:
    """Return (N,) the distance of a segment from a box [m]; zero where it enters.

    Along the segment the squared distance is convex, and its slope is straight between the planes of the box's faces:
    the zero lies on the straight piece where the sign changes.
    """
    turn, centre = base_box[:3, :3].T, base_box[:3, 3:4]
    start, stop = turn @ (segment[0] - centre), turn @ (segment[1] - centre)
    along, half = stop - start, np.reshape(size_m, (3, 1)) / 2.0
    moves = np.abs(along) > _TINY
    step = np.where(moves, along, 1.0)
    faces = np.concatenate([np.where(moves, (side - start) / step, 0.0) for side in (-half, half)])
    ends = np.broadcast_to([[0.0], [1.0]], (2, faces.shape[1]))
    shares = np.sort(np.concatenate([ends, np.clip(faces, 0.0, 1.0)]), axis=0)

    def outside_vector(share: Array) -> Array:
        point = start + share[..., None, :] * along
        return np.asarray(point - np.clip(point, -half, half), dtype=np.float64)

    slopes = (outside_vector(shares) * along).sum(axis=-2)
    last = np.maximum(
        (slopes < 0.0).sum(axis=0) - 1, 0
    )  # of the shares where it still falls; they come first
    low, high = (_pick_row(shares, k) for k in (last, np.minimum(last + 1, len(shares) - 1)))
    falls, rises = (_pick_row(slopes, k) for k in (last, np.minimum(last + 1, len(shares) - 1)))
    piece = np.where((falls < 0.0) & (rises > falls), -falls / np.maximum(rises - falls, _TINY), 0.0)
    return np.asarray(
        np.linalg.norm(outside_vector(low + np.clip(piece, 0.0, 1.0) * (high - low)), axis=0),
        dtype=np.float64,
    )


def plane_distance(segment: Segment, point_m: Array, normal: Array) -> Array:
    """Return (N,) the height of the lower end of a segment above a plane [m], negative below."""
    unit = normal / np.linalg.norm(normal)
    heights = [unit @ (end - point_m[:, None]) for end in segment]
    return np.minimum(heights[0], heights[1])


def _pick_row(table: Array, rows: NDArray[np.intp]) -> Array:
    return np.asarray(np.take_along_axis(table, rows[None, :], axis=0)[0], dtype=np.float64)


def _dot_product(a: Array, b: Array) -> Array:
    return np.asarray((a * b).sum(axis=0), dtype=np.float64)
