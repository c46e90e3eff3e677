"""Which of several further touches tells most."""

from collections.abc import Sequence

import numpy as np

from cellcal.calibration.geometry import Array

_POWER = 8  # a sum of powers stands for the worst: it falls with every touch, where a maximum may stand still


def most_informative_touch(shares_after: Sequence[Array]) -> int:
    """Return the index of the touch that lowers the worst uncertainty most.

    Parameters
    ----------
    shares_after : for each touch that could be next, (m,)
        The uncertainties that it would leave, over their limits.
    """
    return int(np.argmin([float((shares**_POWER).sum()) for shares in shares_after]))
