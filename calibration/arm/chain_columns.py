"""Frames along a chain of placements and joints, and derivatives of the tip, for thousands of poses at once.

Components stand first and the pose last, so that every operation runs along memory.
"""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from cellcal.calibration.geometry import Array


def frames_of_placements(
    placements: Array,
    angles_rad: Array,
    *,
    out: Array | None = None,
    sliding: NDArray[np.bool_] | None = None,
    starts: Sequence[tuple[slice, Array]] | None = None,
) -> tuple[Array, Array]:
    """Return the frames of `chain_frames` for placements (n + 1, 4, 4) and their axis positions (n, N) [rad].

    Joints that are ``sliding`` (n,) move along their axes by metres. ``starts`` are first placements (4, 4) of some
    rows that differ from those of the others.

    ``out``, (n + 1, 4, 3, N), is where the frames are kept: iterations that give the same array again save
    touching fresh memory, which costs more than the arithmetic.
    """
    count = angles_rad.shape[1]
    # One product per placement gives the three next axes and, as fourth row, the step to the next origin.
    mixers = np.ascontiguousarray(placements[:, :3, :].transpose(0, 2, 1))
    frames = np.empty((len(placements), 4, 3, count)) if out is None else out
    frames[0] = mixers[0][:, :, None]
    for rows, placement in starts or ():
        frames[0][:, :, rows] = placement[:3].T[:, :, None]
    turned, part = np.empty((3, 3, count)), np.empty((2, 3, count))
    turning = angles_rad if sliding is None else np.where(sliding[:, None], 0.0, angles_rad)
    for k, (cos, sin) in enumerate(zip(*cosine_and_sine(turning), strict=True)):
        plane = frames[k, :2]
        np.multiply(plane, cos, out=turned[:2])
        np.multiply(plane, sin, out=part)
        turned[0] += part[1]
        turned[1] -= part[0]
        turned[2] = frames[k, 2]
        np.matmul(mixers[k + 1], turned.reshape(3, -1), out=frames[k + 1].reshape(4, -1))
        frames[k + 1, 3] += frames[k, 3]
        if sliding is not None and sliding[k]:
            frames[k + 1, 3] += frames[k, 2] * angles_rad[k]
    return frames[:, :3].swapaxes(1, 2), frames[:, 3]


def cosine_and_sine(angles_rad: Array) -> tuple[Array, Array]:
    """Return both from the tangent of half the angle, right to the last digit (3e-16) for any angle.

    numpy evaluates a tangent with vector instructions where there are any, and cosine and sine one by one.
    """
    tangent = np.tan(0.5 * angles_rad)
    versine = 2.0 / (
        1.0 + tangent * tangent
    )  # 1 + cosine; tangents of doubles end at 2e16, and do not overflow
    return versine - 1.0, tangent * versine


def placement_columns(rotations: Array, origins: Array, tip: Array, *, out: Array | None = None) -> Array:
    """Return (n + 1, 6, 3, N): d tip / d right twist (v, w) of each placement, from frames and tips (3, N).

    ``reshape(6 * (n + 1), 3 * N)`` is free and gives the rows of the transposed design matrix. Iterations may
    pass the last result as ``out``: touching fresh memory costs more than the arithmetic.
    """
    axes = rotations.swapaxes(1, 2)
    columns = np.empty((len(rotations), 6, *origins.shape[1:])) if out is None else out
    columns[:, :3] = axes
    cross_product(axes, (tip - origins)[:, None], out=columns[:, 3:])
    return columns


def independent_columns(rotations: Array, origins: Array, *, out: Array, scale: Array | None = None) -> Array:
    """Return the rows of `placement_columns` that are not combinations of others, for a tip at the last frame.

    A joint turns about, or slides along, the z axis of the frame before it, so that sliding along and turning about
    this axis are also twists of the next placement. What is left, (4 n + 3, 3, N), is x and y sliding,
    x and y turning of each frame, and the three ways of the tip; further rows of ``out`` become zero.
    ``scale`` (N,) multiplies all columns of a posture: as a part of the axes it costs nothing.
    """
    n, count = len(origins) - 1, origins.shape[-1]
    factor = np.ones(count) if scale is None else scale
    columns = out[: 4 * n].reshape(n, 4, 3, count)
    np.multiply(rotations[:-1].swapaxes(1, 2)[:, :2], factor, out=columns[:, :2])
    cross_product(columns[:, :2], (origins[-1] - origins[:-1])[:, None], out=columns[:, 2:])
    np.multiply(rotations[-1].swapaxes(0, 1), factor, out=out[4 * n : 4 * n + 3])
    out[4 * n + 3 :] = 0.0
    return out


def twists_by_independent_columns(placements: Array) -> Array:
    """Return (6 (n + 1), 4 n + 6): every twist of a placement by those of `independent_columns`.

    Behind the tip's three ways stand its three turns, which move nothing but an attitude.
    """
    n = len(placements) - 1
    combine = np.zeros((n + 1, 6, 4 * n + 6))
    k = np.arange(n)
    for row, column in ((0, 0), (1, 1), (3, 2), (4, 3)):
        combine[k, row, 4 * k + column] = 1.0
    combine[n, :, 4 * n :] = np.eye(6)
    x, y, z = placements[1:, :3, :3].swapaxes(0, 1)  # rows: axes before a placement, seen after it
    slide_turn = np.zeros((n, 2, 6))
    slide_turn[:, 0, :3] = slide_turn[:, 1, 3:] = z
    slide_turn[:, 1, :3] = placements[1:, :1, 3] * y - placements[1:, 1:2, 3] * x
    for i in reversed(range(n)):
        combine[i, 2::3] = slide_turn[i] @ combine[i + 1]
    return combine.reshape(6 * (n + 1), -1)


def cross_product(a: Array, b: Array, *, out: Array | None = None) -> Array:
    """Return a x b for arrays (…, 3, N) whose components are next to last, without numpy's axis shuffling."""
    result = np.empty(np.broadcast_shapes(a.shape, b.shape)) if out is None else out
    part = np.empty_like(result[..., 0, :])
    for i, j, k in ((0, 1, 2), (1, 2, 0), (2, 0, 1)):
        np.multiply(a[..., j, :], b[..., k, :], out=result[..., i, :])
        result[..., i, :] -= np.multiply(a[..., k, :], b[..., j, :], out=part)
    return result
