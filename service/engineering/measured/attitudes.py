"""Attitudes of a table by each way to write them that may be meant: conventions, further angles, and inverses."""

from collections.abc import Mapping, Sequence

import numpy as np

from cellcal.calibration.geometry import Array
from cellcal.calibration.message import make_message
from cellcal.calibration.orientation import CONVENTIONS, euler_rotation, rotation_from
from cellcal.service.engineering.measured.errors import MeasurementError
from cellcal.service.engineering.measured.matrix_columns import MATRIX_FORMULAS, matrices_of

_LIKELY = ("ur_rotation_vector", "ros_rpy", "instrument_xyz")  # of equal formulas, the first is named
_BY_AXIS = ("xzy", "yxz", "yzx", "zxy")  # the order of turns; columns are called by their axes
_FURTHER = {f"instrument_{axes}": axes for axes in _BY_AXIS}
_IN_ORDER = {"euler_zxz": "zxz", "euler_xyx": "xyx", "euler_yxy": "yxy"}  # columns in the order of turns
_INVERSE = "_inverse"  # the device seen from the target
_UNIT_QUATERNIONS = {"qi": "qx", "qj": "qy", "qk": "qz", "q_w": "qw", "q_i": "qx", "q_j": "qy", "q_k": "qz"}
_TURN_QUATERNIONS = {"rw": "qw", "rx": "qx", "ry": "qy", "rz": "qz"}
_ROUNDED = 0.01
_MATRIX, _QUATERNION = 9, 4  # numbers of an attitude


def attitude_ways(turns: Array, fields: Sequence[str], convention: str) -> dict[str, Array]:
    """Return rotations (N, 3, 3) of numbers (N, k) [rad or 1] by each convention, or by the one that is named.

    Raises
    ------
    CalibrationError
        The numbers are no attitude.
    MeasurementError
        No such convention.
    """
    inverse = convention.endswith(_INVERSE)
    name = convention.removesuffix(_INVERSE)
    if len(turns.T) == _MATRIX and name in ("", *MATRIX_FORMULAS):
        return dict(matrices_of(turns, name))
    refuse_unknown_convention(name)
    found = _quaternions(turns, fields, name) if len(turns.T) == _QUATERNION else _angles(turns, name)
    turned = {f"{way}{_INVERSE}": np.swapaxes(rotations, 1, 2) for way, rotations in found.items()}
    if convention:
        return turned if inverse else found
    return {**found, **turned}


def formula_of(convention: str) -> str:
    """Return what a way of writing attitudes means."""
    name = convention.removesuffix(_INVERSE)
    axes = _FURTHER.get(name) or _IN_ORDER.get(name)
    if name in MATRIX_FORMULAS:
        formula = MATRIX_FORMULAS[name]
    elif name in _FURTHER and axes:
        formula = " ".join(f"R{axis}(R{axis})" for axis in axes)
    elif axes:
        formula = " ".join(f"R{axis}({number})" for axis, number in zip(axes, "123", strict=True))
    else:
        formula = CONVENTIONS[name].formula
    return f"inverse of {formula}" if convention.endswith(_INVERSE) else formula


def refuse_unknown_convention(convention: str) -> None:
    """Refuse a word that names no way to write attitudes."""
    name = convention.removesuffix("_inverse_pose").removesuffix(_INVERSE)
    if name and name not in ("none", *MATRIX_FORMULAS, *CONVENTIONS, *_FURTHER, *_IN_ORDER):
        conventions = ", ".join((*CONVENTIONS, *_FURTHER, *_IN_ORDER))
        raise MeasurementError(
            make_message("no orientation is called {name!r}.", name=name),
            remedy=make_message(
                "--convention takes none, {known}; with _inverse behind it, the inverse of the attitude; with "
                "_inverse_pose, that of the whole pose.",
                known=conventions,
            ),
        )


def _angles(turns: Array, convention: str) -> dict[str, Array]:
    others = (n for n, c in CONVENTIONS.items() if len(c.fields) == 3 and n not in _LIKELY)
    names = [convention] if convention else [*_LIKELY, *others, *_FURTHER, *_IN_ORDER]
    found = {}
    for name in names:
        if name in CONVENTIONS:
            found[name] = rotation_from(name, turns)
        elif name in _FURTHER:
            found[name] = euler_rotation(
                _FURTHER[name], turns[:, ["xyz".index(axis) for axis in _FURTHER[name]]]
            )
        else:
            found[name] = euler_rotation(_IN_ORDER[name], turns)
    return found


def _by_number(field: str) -> tuple[int, str]:
    """Return the rank of a numbered name: column 9 stands before column 10."""
    digits = "".join(filter(str.isdigit, field))
    return int(digits or 0), field


def _quaternions(turns: Array, fields: Sequence[str], convention: str) -> dict[str, Array]:
    """Return attitudes from quaternions: by their names; numbered ones may begin or end with the scalar."""
    # Printed quaternions are rounded; anything further from unit length is refused later.
    length = np.linalg.norm(turns, axis=1, keepdims=True)
    turns = np.where(np.abs(length - 1.0) < _ROUNDED, turns / np.maximum(length, _ROUNDED), turns)
    named = _TURN_QUATERNIONS if "rw" in fields else _UNIT_QUATERNIONS
    fields = [named.get(field, field) for field in fields]
    if "qw" in fields:
        order = [fields.index(f) for f in ("qw", "qx", "qy", "qz")]
        return {"abb_quaternion": rotation_from("abb_quaternion", turns[:, order])}
    first = [fields.index(f) for f in sorted(fields, key=_by_number)]
    orders: Mapping[str, list[int]] = {"abb_quaternion": first, "ros_quaternion": [first[3], *first[:3]]}
    return {
        name: rotation_from("abb_quaternion", turns[:, order])
        for name, order in orders.items()
        if convention in ("", name)
    }
