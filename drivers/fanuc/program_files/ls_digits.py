"""Right-aligned numbers of one width, many at once: a column of characters a number.

A controller prints every coordinate into a field of the same width, so a line's numbers are columns of digits. What
is not written so is told apart, and left to the readers that take one number after another.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from cellcal.calibration.geometry import Array
from cellcal.drivers.fanuc.program_files.ls_numbers import LARGEST

Characters = NDArray[np.uint8]
Flags = NDArray[np.bool_]
_BLANK, _MINUS, _POINT, _ZERO = (ord(sign) for sign in " -.0")
_TIE = (
    1e-6  # of the last decimal: so near to a tie only the exact decimals of a double tell which way it goes
)


@dataclass(frozen=True, eq=False)
class DigitFields:
    """The contents of N fields."""

    values: Array  # (N,) as a float of the text would be
    plain: Flags  # (N,) blanks, a minus or none, digits, the point, digits; the value counts where this holds
    wide: Flags  # (N,) two blanks or more stand before the number
    bare: Flags  # (N,) no digit stands before the point
    full: Flags  # (N,) a zero stands there, of a number that is not zero


def read_digits(texts: Characters, point: int) -> DigitFields:
    """Read fields (width, N) whose point is in row ``point``."""
    digits = texts - np.uint8(_ZERO)  # wraps: what is no digit becomes more than nine
    is_digit = digits <= 9
    before = texts[:point]
    blanks = (before == _BLANK).sum(axis=0, dtype=np.uint8)
    signs = (before == _MINUS).sum(axis=0, dtype=np.uint8)
    whole = is_digit[:point].sum(axis=0, dtype=np.uint8)
    # Digits up to the point leave blanks and a sign for the places before them, and blanks stand first.
    plain = (blanks + signs + whole == point) & (signs <= 1) & (texts[point] == _POINT)
    place = np.arange(point, dtype=np.uint8)[:, None]
    plain &= (is_digit[:point] == (place >= blanks + signs)).all(axis=0)
    plain &= ((before == _BLANK) == (place < blanks)).all(axis=0) & is_digit[point + 1 :].all(axis=0)
    digits[~is_digit] = 0
    sizes = (_digit_weights(len(texts), point) @ digits) / 10.0 ** (len(texts) - point - 1)
    return DigitFields(
        values=np.where(signs > 0, -sizes, sizes),
        plain=plain,
        wide=blanks >= 2,
        bare=whole == 0,
        full=(whole == 1) & (digits[point - 1] == 0) & (sizes > 0),
    )


def written_digits(values: Array, shape: tuple[int, int], leading_zero: Flags) -> tuple[Characters, Flags]:
    """Return fields (width, N) that say values (N,), and whether each has room with a blank before it.

    Parameters
    ----------
    values : (N,)
        In the file's unit; what is not finite or too large for any controller has no room.
    shape : (width, point)
        Of the fields.
    leading_zero : (N,)
        Whether 0.154 is written, or .154; zero itself is 0.000 and has no sign.
    """
    width, point = shape
    possible = np.abs(values) < LARGEST  # not of NaN
    numbers = _scale_values(np.where(possible, values, 0.0), width - point - 1)
    every = 10 ** np.arange(width - 2, -1, -1, dtype=np.int64)[:, None]
    whole = (numbers >= every[:point]).sum(axis=0)
    whole = np.maximum(whole, leading_zero | (numbers == 0))
    negative = (values < 0) & (numbers > 0)
    fits_width = possible & (whole + negative < point) & (numbers < 10 * every[0])
    texts = np.empty((width, len(values)), dtype=np.uint8)
    texts[point] = _POINT
    rest = numbers
    for row in range(width - 1, -1, -1):
        if row != point:
            rest, digit = rest // 10, rest % 10
            texts[row] = digit + _ZERO
    texts[:point][np.arange(point)[:, None] < point - whole] = _BLANK
    signed = np.flatnonzero(negative & fits_width)
    texts[point - whole[signed] - 1, signed] = _MINUS
    return texts, fits_width


def _digit_weights(width: int, point: int) -> Array:
    """Return what a digit in each column counts; the point counts nothing."""
    powers = 10.0 ** np.arange(width - 2, -1, -1)
    return np.insert(powers, point, 0.0)


def _scale_values(values: Array, decimals: int) -> NDArray[np.int64]:
    """Return sizes in units of the last decimal, rounded as printing rounds."""
    scaled = np.abs(values) * 10.0**decimals
    numbers = np.rint(scaled).astype(np.int64)
    for i in np.flatnonzero(np.abs(scaled - np.floor(scaled) - 0.5) < _TIE).tolist():
        numbers[i] = int(f"{abs(values[i]):.{decimals}f}".replace(".", ""))
    return numbers
