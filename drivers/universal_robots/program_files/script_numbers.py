"""Six numbers of a pose or of a posture, as URScript and PolyScope write them, and new ones in their clothes.

PolyScope prints poses with a fixed number of decimals and no leading zero (``-.143968656714``) and joints as Java
prints a double, as short as it can be (``-0.808``, ``1.2E-4``). Decimals of such a double say nothing of its
resolution, and a person who writes ``0.4`` does not mean 10 cm: a new number gets all the digits of a double where
one of the six has them, else nine decimals at least.
"""

import re
from collections.abc import Sequence

import numpy as np

from cellcal.calibration.geometry import Array, exp_rotation, homogeneous_matrix, log_rotation

LEAST_DECIMALS = 9  # a nanometre; 1e-9 rad
DOUBLE_STEP = 1e-12  # m or rad: less is rounding, and keeps the old text
LONGEST_M, LARGEST_RAD = 1e3, 1e2  # beyond, a coordinate is a damaged one
_DOUBLE_DECIMALS = 13
_SAME_ROTATION = 1e-14
_NUMBER = re.compile(r"[^\s,\\]+")
_BETWEEN = re.compile(r"#[^\r\n]*+|\\(?=\r?\n)")  # what may stand between the numbers of several lines


def without_comments(text: str) -> str:
    """Return a list's text with blanks for comments and for the signs that a line goes on."""
    return _BETWEEN.sub(lambda found: " " * len(found[0]), text) if "#" in text or "\\" in text else text


def number_spans(text: str, start: int, end: int) -> list[tuple[int, int]]:
    """Return where the numbers of a list stand, without the blanks between them."""
    numbers = without_comments(text[start:end])
    return [(start + found.start(), start + found.end()) for found in _NUMBER.finditer(numbers)]


def renew_numbers(old: Sequence[str], values: Sequence[float]) -> list[str]:
    """Return new values in the old numbers' format; a number that already says its value stays.

    Raises
    ------
    ValueError
        A value is not finite, or beyond what a coordinate can be.
    """
    if not all(abs(value) <= LONGEST_M for value in values):  # NaN fails, too
        raise ValueError("a coordinate must be finite, and below 1000")
    double = any(_from_double(text) for text in old)
    write = _double_text if double else _fixed_text
    return [write(text, value) for text, value in zip(old, values, strict=True)]


def kept_steps(lists: Sequence[str]) -> Array:
    """Return (N,) the coarsest step to which `renewed` keeps any number of each list of six [their unit]."""
    text = np.frombuffer((",".join(lists) + ",").encode("latin-1"), dtype=np.uint8)
    digits = np.concatenate([[0], np.cumsum((text >= ord("0")) & (text <= ord("9")))])
    ends = np.flatnonzero(text == ord(","))
    points = np.flatnonzero(text == ord("."))
    which = np.searchsorted(ends, points)
    decimals = np.zeros(len(ends), dtype=np.int64)
    decimals[which] = digits[ends[which]] - digits[points]
    powers = np.searchsorted(ends, np.flatnonzero((text | 32) == ord("e")))
    decimals[powers] = _DOUBLE_DECIMALS
    six = decimals.reshape(-1, 6)
    fixed = 10.0 ** -np.maximum(LEAST_DECIMALS, six.min(axis=1)).astype(float)
    return np.where((six >= _DOUBLE_DECIMALS).any(axis=1), DOUBLE_STEP, fixed)


def java_text(value: float) -> str:
    """Return a double as Java prints it: all its digits, an exponent below 0.001 and from 10 000 000 on."""
    size = abs(value)
    if size == 0.0 or 1e-3 <= size < 1e7:
        return np.format_float_positional(value, trim="0")
    return np.format_float_scientific(value, trim="0", exp_digits=1).replace("e+", "E").replace("e", "E")


def poses_of(six: Array) -> Array:
    """Return (N, 4, 4) from (N, 6) x, y, z [m] and a rotation vector [rad]."""
    return homogeneous_matrix(exp_rotation(six[:, 3:]), six[:, :3])


def six_of(poses: Array, like: Array) -> Array:
    """Return (N, 6) for poses (N, 4, 4), rotation vectors on the branch of the old ones (N, 6).

    A rotation vector may be turned on by whole turns about its axis; controllers write angles beyond pi. Of all that
    say the same rotation, the nearest to the old one is taken; the old one itself where the rotation is the same.
    """
    old = like[:, 3:]
    vector = log_rotation(poses[:, :3, :3])
    angle = np.linalg.norm(vector, axis=1, keepdims=True)
    old_angle = np.linalg.norm(old, axis=1, keepdims=True)
    old_axis = old / np.where(old_angle > 0, old_angle, 1.0)
    axis = np.where(angle > DOUBLE_STEP, vector / np.where(angle > DOUBLE_STEP, angle, 1.0), old_axis)
    along = (axis * old).sum(axis=1, keepdims=True)
    turned = (angle + 2 * np.pi * np.round((along - angle) / (2 * np.pi))) * axis
    apart = np.abs(poses[:, :3, :3] - exp_rotation(old)).max(axis=(1, 2), keepdims=False)[:, None]
    rotation = np.where(apart <= _SAME_ROTATION, old, turned)
    return np.concatenate([poses[:, :3, 3], rotation], axis=1)


def _from_double(text: str) -> bool:
    return len(text.partition(".")[2]) >= _DOUBLE_DECIMALS or "e" in text or "E" in text


def _double_text(text: str, value: float) -> str:
    return text if abs(value - float(text)) <= DOUBLE_STEP else java_text(value)


def _fixed_text(text: str, value: float) -> str:
    decimals = max(LEAST_DECIMALS, len(text.partition(".")[2]))
    if abs(value - float(text)) <= 0.5 * 10.0**-decimals * (1 - 1e-9):
        return text
    new = f"{value:.{decimals}f}"
    if text.lstrip("+-").startswith("."):
        new = new.replace("0.", ".", 1) if new.startswith(("0.", "-0.")) else new
    return f"+{new}" if text.startswith("+") and not new.startswith("-") else new
