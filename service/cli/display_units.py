"""Units in which commands show parameters, beside the SI units of the calculations."""

import math

DEGREES_PER_RADIAN = math.degrees(1.0)
# SI unit of a parameter -> the unit shown, and how many of it are one SI unit
DISPLAY_UNITS = {
    "rad": ("deg", DEGREES_PER_RADIAN),
    "m": ("mm", 1e3),
    "rad/m": ("deg/m", DEGREES_PER_RADIAN),
    "1": ("ppm", 1e6),
}
