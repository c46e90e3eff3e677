"""What residuals of a frame from drawn points do not tell by themselves: an exchange of points, another scale."""

import math
from collections.abc import Sequence

from cellcal.calibration.geometry import Array
from cellcal.calibration.message import make_message
from cellcal.calibration.point_order import find_alike_order
from cellcal.calibration.registration import scale_of_points

_SURE = 5.0  # standard deviations: a scale so far from one is no chance


def point_remarks(labels: Sequence[str], drawn_m: Array, found_m: Array) -> tuple[str, ...]:
    """Return remarks on pairs of points (n, 3) [m]: another order fits as well, or one set is larger."""
    remarks: list[str] = []
    if (alike := find_alike_order(drawn_m, found_m)) is not None:
        remarks.append(
            make_message(
                "nothing here tells whether points were exchanged: in the order {order} they fit as well, and the "
                "frame would be turned by {turn_deg:.0f} deg; a further point off the pattern would tell",
                order=", ".join(labels[index] for index in alike.order),
                turn_deg=math.degrees(alike.turn_rad),
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
