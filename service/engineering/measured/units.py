"""Units that files are written in, in SI."""

import re

import numpy as np

from cellcal.calibration.geometry import Array
from cellcal.calibration.identification.misfit_hypotheses import LENGTH_UNITS, USUAL_LENGTH_UNITS

_FAHRENHEIT = re.compile(r"°\s*f\b|℉|fahrenheit|[\[(]\s*(deg\s*)?f\s*[\])]|[\s_](deg)?f$", re.IGNORECASE)
_KELVIN = re.compile(r"kelvin|[\[(]\s*k\s*[\])]|[\s_]k$", re.IGNORECASE)

ANGLE_UNITS = {
    "rad": 1.0,
    "deg": float(np.deg2rad(1.0)),
    "mrad": 1e-3,
    "0.1deg": float(np.deg2rad(1e-1)),
    "0.01deg": float(np.deg2rad(1e-2)),
    "mdeg": float(np.deg2rad(1e-3)),
    "0.0001deg": float(np.deg2rad(1e-4)),
    "0.000001deg": float(np.deg2rad(1e-6)),
    "gon": float(np.pi / 200),
    "rev": float(2 * np.pi),
    "arcmin": float(np.deg2rad(1.0) / 60.0),
    "arcsec": float(np.deg2rad(1.0) / 3600.0),
}

__all__ = ["ANGLE_UNITS", "LENGTH_UNITS", "USUAL_LENGTH_UNITS", "to_celsius"]


def to_celsius(temperatures: Array, heading: str) -> Array:
    """Return temperatures in degrees Celsius, from the unit that their heading names."""
    if _FAHRENHEIT.search(heading):
        return (temperatures - 32.0) / 1.8
    if _KELVIN.search(heading):
        return temperatures - 273.15
    return temperatures
