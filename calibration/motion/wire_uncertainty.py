"""By how much a draw-wire may be nearer to the arm than computed, while its joints are known to within a doubt."""

from collections.abc import Sequence
from itertools import pairwise

import numpy as np

from cellcal.calibration.geometry import Array
from cellcal.calibration.motion.capsule_distance import Segment, pair_distances
from cellcal.calibration.motion.position_uncertainty import AxisUncertainty

_PIECES = 8  # of the wire, looked at one by one


def wire_approaches(
    axis_uncertainty: AxisUncertainty, wire: Segment, bars: Sequence[tuple[Segment, int]]
) -> list[Array]:
    """Return, of each bar and its link, (N,): by how much a draw-wire may be nearer to it than computed [m].

    Seen from the link its hook hardly moves and its anchor much: piece by piece, between the two in proportion.
    """
    anchor, hook = wire
    count = hook.shape[-1]
    hook_off = axis_uncertainty.displacements_from_links([hook], len(axis_uncertainty.axes))
    anchor_off = axis_uncertainty.base_displacements(anchor)
    marks = np.linspace(0.0, 1.0, _PIECES + 1)
    points = [anchor + mark * (hook - anchor) for mark in marks]
    pieces = list(pairwise(points))
    apart = pair_distances([(wire, bar) for bar, _ in bars], count)
    every = pair_distances([(piece, bar) for bar, _ in bars for piece in pieces], count)
    approaches = []
    for k, (_, link) in enumerate(bars):
        off = [(1.0 - mark) * anchor_off[link] + mark * hook_off[link] for mark in marks]
        nearest = np.full(count, np.inf)
        for piece, ends in enumerate(pairwise(off)):
            np.minimum(nearest, every[k * len(pieces) + piece] - np.maximum(*ends), out=nearest)
        approaches.append(apart[k] - nearest)
    return approaches
