"""Tables for other programs: named columns with units, rows of numbers and text, in SI as the journal has them."""

from collections.abc import Sequence
from dataclasses import dataclass

from cellcal.calibration.errors import CellError

Value = str | float | int | bool | None


class ExportError(CellError):
    """Something cannot be exported."""

    code = "usage"


@dataclass(frozen=True, slots=True)
class ExportColumn:
    """One column; ``unit`` is empty where there is none."""

    name: str
    unit: str = ""


@dataclass(frozen=True, slots=True)
class ExportTable:
    """One table."""

    title: str
    columns: tuple[ExportColumn, ...]
    rows: tuple[Sequence[Value], ...]

    def __post_init__(self) -> None:
        if any(len(row) != len(self.columns) for row in self.rows):
            raise ValueError(f"a row of {self.title} has not as many cells as there are columns")


_UNITS = {
    "m": "m",
    "rad": "rad",
    "s": "s",
    "kg": "kg",
    "mm": "mm",
    "deg": "deg",
    "rad_s": "rad/s",
    "m_s": "m/s",
    "rad_per_m": "rad/m",
    "hpa": "hPa",
    "pa": "Pa",
    "c": "°C",
    "k": "K",
    "percent": "%",
    "hz": "Hz",
}


def unit_of(name: str) -> str:
    """Return the unit that the last part of a fact's name says, as all names here do; empty where it says none."""
    words = name.split("_")
    for count in (3, 2, 1):
        unit = _UNITS.get("_".join(words[-count:]).lower()) if len(words) > count else None
        if unit is not None:
            return unit
    return ""
