"""Figures as people read them: millimetres, degrees, turns."""

import math

_SHOWN = {
    "m": (1e3, "mm", 3),
    "rad": (180.0 / math.pi, "deg", 4),
    "rad/s": (180.0 / math.pi, "deg/s", 4),
    "m/s": (1e3, "mm/s", 3),
    "turn": (1.0, "turns", 3),
    "count": (1.0, "counts", 0),
}


def format_quantity(value: float, unit: str) -> str:
    """Return a figure in SI with its unit as people read it."""
    factor, shown, digits = _SHOWN.get(unit, (1.0, unit, 6))
    scaled = value * factor
    if unit in ("turn", "count") and scaled == round(scaled):
        return f"{scaled:+.0f} {shown}" if unit == "turn" else f"{scaled:.0f}"
    if unit == "1":
        return f"{scaled:.7g}"
    tiny = scaled != 0.0 and abs(scaled) < 10.0**-digits
    return f"{scaled:.2g} {shown}" if tiny else f"{scaled:.{digits}f} {shown}"
