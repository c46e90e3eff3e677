"""What residuals of a frame from drawn points do not tell by themselves: an exchange of points, another scale."""

import math
from collections.abc import Sequence

import numpy as np

from cellcal.calibration.geometry import Array, log_rotation
from cellcal.calibration.message import make_message
from cellcal.calibration.point_order import best_rotation, find_alike_orders
from cellcal.calibration.registration import scale_of_points

_CORNER_DEG = 20.0  # a smaller turn comes of no exchange of a pattern's points
_SURE = 5.0  # standard deviations: a scale so far from one is no chance


def point_remarks(labels: Sequence[str], drawn_m: Array, found_m: Array) -> tuple[str, ...]:
    """Return remarks on pairs of points (n, 3) [m]: another order fits as well, or one set is larger."""
    remarks: list[str] = []
    if alike := find_alike_orders(drawn_m, found_m):
        remarks.append(
            make_message(
                "nothing here tells whether points were exchanged: in the order {order} they fit as well, and the "
                "frame would be turned by {turn_deg:.0f} deg; a further point off the pattern would tell",
                order=", ".join(labels[index] for index in alike[0].order),
                turn_deg=_turn_deg(best_rotation(drawn_m, found_m), alike[0].target_source),
            )
        )
    scale = scale_of_points(drawn_m, found_m)
    if scale is not None and abs(scale.value - 1.0) > _SURE * scale.sigma:
        remarks.append(
            make_message(
                "the measured points are {scale:.5f} times as far from each other as the drawn ones: temperature, "
                "shrinkage or the scale of an instrument, which more points do not cure",
                scale=scale.value,
            )
        )
    return tuple(remarks)


def smaller_turn_remarks(
    labels: Sequence[str], in_frame_m: Array, found_m: Array, base_old: Array
) -> tuple[str, ...]:
    """Return a remark where another order of points (n, 3) [m] fits as well and turns the frame much less.

    ``base_old`` (3, 3) is the attitude of the frame before: a workpiece that moved seldom turned by a whole corner.
    """
    turned_deg = _turn_deg(base_old, best_rotation(in_frame_m, found_m))
    turns = {_turn_deg(base_old, each.target_source): each for each in find_alike_orders(in_frame_m, found_m)}
    least_deg = min(turns, default=math.inf)
    if turned_deg < _CORNER_DEG or least_deg > turned_deg / 2.0:
        return ()
    return (
        make_message(
            "in the order {order} the points fit as well, and the workpiece turned by {least_deg:.1f} deg, not by "
            "{turned_deg:.1f} deg: see that none were exchanged",
            order=", ".join(labels[index] for index in turns[least_deg].order),
            least_deg=least_deg,
            turned_deg=turned_deg,
        ),
    )


def with_remarks(text: str, remarks: Sequence[str]) -> str:
    """Return a text that is shown before a decision, with the remarks behind it."""
    for remark in remarks:
        text = make_message("{text} Beware: {remark}.", text=text, remark=remark)
    return text


def _turn_deg(one: Array, other: Array) -> float:
    return math.degrees(float(np.linalg.norm(log_rotation(one.T @ other))))
