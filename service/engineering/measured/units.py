"""Units that files are written in, in SI."""

import numpy as np

from cellcal.calibration.identification.misfit_hypotheses import LENGTH_UNITS

ANGLE_UNITS = {
    "rad": 1.0,
    "deg": float(np.deg2rad(1.0)),
    "mrad": 1e-3,
    "mdeg": float(np.deg2rad(1e-3)),
    "gon": float(np.pi / 200),
}

__all__ = ["ANGLE_UNITS", "LENGTH_UNITS"]
