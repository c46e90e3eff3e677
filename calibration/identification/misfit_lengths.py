"""Lengths that all lack the same piece, or are too long by a factor: zero and scale of a draw-wire, far off."""

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from cellcal.calibration.arm.kinematics import RobotModel
from cellcal.calibration.geometry import Array
from cellcal.calibration.identification.misfit_error import MisfitCause
from cellcal.calibration.identification.observations import LengthObservations
from cellcal.calibration.identification.quick_fit import has_enough_lengths, length_scores, refine_number
from cellcal.calibration.message import make_message

_PIECES_M = (0.02, 1e-3, 1e-4)
_FACTORS = (0.01, 1e-3, 1e-4)
_LONGEST_M, _LARGEST = 2.0, 0.25
_LEAST_M, _LEAST = 5e-3, 4e-3  # what a fit finds by itself


def length_readings(
    model: RobotModel, some: LengthObservations
) -> Iterator[tuple[LengthObservations, MisfitCause]]:
    """Return the lengths with the piece and with the factor that fit best, and what to say of each."""
    if not has_enough_lengths(len(some)):
        return
    flanges, read = model.base_flange(some.joints_rad), some.lengths_m
    piece = _best(flanges, (_LONGEST_M, _PIECES_M), np.ones_like(read), read)
    if abs(piece) >= _LEAST_M:
        yield (
            replace(some, lengths_m=read + piece),
            MisfitCause(
                ("zero",),
                make_message(
                    "all lengths are about {piece_mm:+.0f} mm longer than they were read",
                    piece_mm=piece * 1e3,
                ),
                make_message(
                    "See where the device has its zero, and add it to the lengths in the file (about "
                    "{piece_mm:+.0f} mm).",
                    piece_mm=piece * 1e3,
                ),
                0.0,
            ),
        )
    part = _best(flanges, (_LARGEST, _FACTORS), read, read)
    if abs(part) >= _LEAST:
        yield (
            replace(some, lengths_m=read * (1.0 + part)),
            MisfitCause(
                ("scale",),
                make_message(
                    "all lengths are {factor:.3f} times as long as they were read", factor=1.0 + part
                ),
                make_message(
                    "See the scale of the device (counts or volts for each mm), and multiply the lengths in the file "
                    "(by about {factor:.3f}).",
                    factor=1.0 + part,
                ),
                0.0,
            ),
        )


def _best(flanges: Array, search: tuple[float, tuple[float, ...]], along: Array, read: Array) -> float:
    """Return how much of ``along`` (N,) is to be added to lengths (N,) so that they fit the flange (N, 4, 4) best.

    Zero where no such part makes lengths of them, as of a joint's angles.
    """
    if not (read + search[0] * along > 0.0).all():
        return 0.0

    def scores_of(parts: Array) -> Array:
        lengths = read + parts[:, None] * along
        is_length = (lengths > 0.0).all(axis=1)
        some, scores = lengths[is_length], np.full(len(parts), np.inf)
        # Errors of longer lengths are larger for the same fit.
        fitted = length_scores(np.broadcast_to(flanges, (len(some), *flanges.shape)), some)
        scores[is_length] = fitted / np.std(some, axis=1)
        return scores

    return refine_number(scores_of, *search, spread=2.0)
