"""Numbers as a file writes them: a new value in the old one's clothes."""

import re
from dataclasses import dataclass
from math import isfinite

from cellcal.calibration.message import make_message

_NUMBER = re.compile(r"^([+-]?)(\d*)(?:(\.)(\d*))?(?:([eE])([+-]?)(\d+))?$")


@dataclass(frozen=True, slots=True)
class NumberFormat:
    """The form of one number in a file: decimals, leading zero, width, exponent, plus sign.

    ``of(".154").write(-0.2)`` is ``-.200``; a number that has no fraction gets none.
    """

    decimals: int
    leading_zero: bool
    width: int  # at least so many characters, filled with blanks in front; 0 for none
    exponent: str  # "e" or "E" where the number was written with one, else ""
    exponent_digits: int
    plus: bool
    point: bool

    @classmethod
    def from_text(cls, text: str) -> "NumberFormat":
        """Read the format of a number; blanks in front count as its width.

        Raises
        ------
        ValueError
            This is not a number.
        """
        bare = text.lstrip(" ")
        found = _NUMBER.match(bare)
        if found is None or not (found[2] or found[4]):
            raise ValueError(make_message("{text!r} is not a number", text=text))
        return cls(
            decimals=len(found[4] or ""),
            leading_zero=bool(found[2]),
            width=len(text) if len(text) > len(bare) else 0,
            exponent=found[5] or "",
            exponent_digits=len(found[7] or ""),
            plus=found[1] == "+",
            point=bool(found[3]),
        )

    @property
    def unit_step(self) -> float:
        """Return one unit of the last decimal (of the mantissa, where there is an exponent)."""
        return float(10.0**-self.decimals)

    def write_value(self, value: float) -> str:
        """Write a value in this format.

        Raises
        ------
        ValueError
            The value is not finite.
        """
        if not isfinite(value):
            raise ValueError("a number in a program must be finite")
        if self.exponent:
            text = self._with_exponent(value)
        else:
            text = f"{value:.{self.decimals}f}"
            text += "." if self.point and not self.decimals else ""
        if not self.leading_zero:
            text = re.sub(r"^(-?)0\.", r"\1.", text)
        if self.plus and not text.startswith("-"):
            text = "+" + text
        return text.rjust(self.width)

    def _with_exponent(self, value: float) -> str:
        mantissa, power = f"{value:.{self.decimals}e}".split("e")
        sign = "-" if power.startswith("-") else ("+" if self.exponent_digits > 1 else "")
        return f"{mantissa}{self.exponent}{sign}{abs(int(power)):0{self.exponent_digits}d}"
