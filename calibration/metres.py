"""Numbers that cannot be metres where an arm is: millimetres, most of the time."""

from collections.abc import Sequence

import numpy as np

from cellcal.calibration.errors import CalibrationError
from cellcal.calibration.geometry import Array
from cellcal.calibration.message import make_message

MOST_OF_TOOL_M = 5.0  # from the flange; the longest lances are three
MOST_OF_CELL_M = 30.0  # from the base, a rail included
MOST_OF_HALL_M = 100.0  # from a tracker, beyond which none measures


def refuse_not_metres(
    values: Array | Sequence[float] | Sequence[Sequence[float]], what: str, most_m: float = MOST_OF_CELL_M
) -> None:
    """Refuse coordinates that no arm reaches.

    Raises
    ------
    CalibrationError
        One is beyond ``most_m``; what is not finite is left to others.
    """
    found = np.abs(np.asarray(values, dtype=float))
    size = float(found.max(initial=0.0, where=np.isfinite(found)))
    if size <= most_m:
        return
    raise CalibrationError(
        make_message("{what}: {size:.6g} m cannot be right, an arm is shorter.", what=what, size=size),
        remedy="Write metres; these numbers look like millimetres.",
    )
