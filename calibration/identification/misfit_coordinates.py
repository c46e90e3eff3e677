"""One column of the measured positions that is at fault: its unit, its rows, or what it holds.

Each coordinate by itself is linear in the flange's pose, whatever base and target are:
``x = s (r R t + r p) + c``, with twelve products and a constant for unknowns. So each column is held against the
joints without the other two, and how many metres its numbers stand for is found on the way.
"""

import itertools
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from cellcal.calibration.arm.kinematics import RobotModel
from cellcal.calibration.geometry import Array
from cellcal.calibration.identification.misfit_error import MisfitCause, say_column_apart
from cellcal.calibration.identification.misfit_hypotheses import USUAL_LENGTH_UNITS, FileNames
from cellcal.calibration.identification.observations import Observations, PointObservations
from cellcal.calibration.identification.quick_fit import trimmed_rms
from cellcal.calibration.message import make_message

_UNKNOWNS = 13
_FEWEST_ROWS = 26
_ROUNDS = 4
_KEPT_SHARE = 0.75  # of the rows: the others may be outliers
_SAME_UNIT = 0.03  # how far the scales of two columns may differ
_NARROW = 1e-9
_DECISIVE = 10.0  # times worse than the others is a column that does not fit
_APART = (1, -1, 2, -2, 3, -3)
_AXES = 3


@dataclass(frozen=True, slots=True)
class _LineFit:
    """How one column goes with the joints."""

    left_m: float  # of true metres; infinite where the column does not move
    scale: float  # of the column's numbers for one true metre


def coordinate_causes(
    model: RobotModel, series: Observations, names: FileNames, limit_m: float
) -> tuple[MisfitCause, ...]:
    """Return what is wrong with one of the three columns of positions, where the others fit the joints.

    Parameters
    ----------
    series : observations
        All rows, in the order of the file.
    limit_m : float
        What rows that fit leave at most [m].
    """
    if not isinstance(series, PointObservations) or len(series) < _FEWEST_ROWS:
        return ()
    design, columns = _design(model, series.joints_rad), series.positions_m.T
    fits = [_fit_line(design, column) for column in columns]
    good = [axis for axis in range(_AXES) if fits[axis].left_m <= limit_m]
    if len(good) == _AXES:
        return tuple(_repeated(columns, fits, names)) or tuple(_other_unit(fits, names))
    if len(good) != _AXES - 1:
        return ()
    wrong = next(axis for axis in range(_AXES) if axis not in good)
    left_m = max(fits[axis].left_m for axis in good)
    if fits[wrong].left_m < _DECISIVE * left_m:
        return ()
    says, cure = _describe(design, columns, wrong, names, limit_m)
    first, second = (names.position[axis] for axis in good)
    return (
        MisfitCause(
            ("column",),
            make_message("{first} and {second} fit, and {says}", first=first, second=second, says=says),
            cure,
            left_m,
        ),
    )


def _design(model: RobotModel, joints_rad: Array) -> Array:
    """Return what one coordinate is linear in (N, 13)."""
    flanges, count = model.base_flange(joints_rad), len(joints_rad)
    return np.column_stack([flanges[:, :3, :3].reshape(count, 9), flanges[:, :3, 3], np.ones(count)])


def _fit_line(design: Array, column: Array) -> _LineFit:
    weights = np.ones(len(column))
    sizes = solution = np.zeros(0)
    for _ in range(_ROUNDS):
        solution = np.linalg.pinv(design * weights[:, None], rcond=_NARROW) @ (column * weights)
        sizes = np.abs(design @ solution - column)
        weights = (sizes <= np.quantile(sizes, _KEPT_SHARE)).astype(float)
    scale = float(np.linalg.norm(solution[9:12]))
    if scale < _NARROW:
        return _LineFit(float("inf"), 0.0)
    freedom = max(1.0 - _UNKNOWNS / (_KEPT_SHARE * len(column)), 0.1)
    return _LineFit(float(trimmed_rms(sizes)) / scale / float(np.sqrt(freedom)), scale)


def _repeated(columns: Array, fits: Sequence[_LineFit], names: FileNames) -> Iterator[MisfitCause]:
    """Return a column that holds the numbers of another one, which fit as they do there."""
    for first, second in itertools.combinations(range(_AXES), 2):
        if np.array_equal(np.abs(columns[first]), np.abs(columns[second])):
            yield MisfitCause(("column",), *_repeat_texts(names, second, first), fits[first].left_m)


def _repeat_texts(names: FileNames, axis: int, of: int) -> tuple[str, str]:
    return (
        make_message(
            "{column} repeats the numbers of {other}", column=names.position[axis], other=names.position[of]
        ),
        "Put the column as the device wrote it back into the file.",
    )


def _other_unit(fits: Sequence[_LineFit], names: FileNames) -> Iterator[MisfitCause]:
    """Return the one column whose numbers are of another size than those of the other two."""
    scales = [fit.scale for fit in fits]
    wrong = int(np.argmax([abs(np.log(scale / np.median(scales))) for scale in scales]))
    others = [scale for axis, scale in enumerate(scales) if axis != wrong]
    if abs(np.log(others[0] / others[1])) > _SAME_UNIT:
        return
    factor = scales[wrong] / float(np.mean(others))
    if abs(np.log(factor)) <= _SAME_UNIT:
        return
    taken = USUAL_LENGTH_UNITS.get(names.length_unit, 1.0)
    alike = [
        unit
        for unit, metres in USUAL_LENGTH_UNITS.items()
        if unit != names.length_unit and abs(np.log(taken / metres / factor)) <= _SAME_UNIT
    ]
    says = (
        make_message(
            "{column} is in {unit} and the other two are not", column=names.position[wrong], unit=alike[0]
        )
        if alike
        else make_message(
            "{column} is {factor:.4g} times as large as it should be beside the other two",
            column=names.position[wrong],
            factor=factor,
        )
    )
    yield MisfitCause(
        ("column",), says, "Write all three columns in one unit.", max(fit.left_m for fit in fits)
    )


def _describe(design: Array, columns: Array, wrong: int, names: FileNames, limit_m: float) -> tuple[str, str]:
    """Return what the column that does not fit holds, and what to do."""
    name, column = names.position[wrong], columns[wrong]
    for rows in _APART:
        there = slice(rows, None) if rows > 0 else slice(None, rows)
        of = slice(None, -rows) if rows > 0 else slice(-rows, None)
        if _fit_line(design[of], column[there]).left_m <= limit_m:
            return say_column_apart(name, rows), "Put each of its numbers beside the others of its reading."
    if (column >= 0.0).all():
        return make_message(
            "{column}, which is never negative, does not", column=name
        ), "See whether its minus signs were lost, and whether it is the right column (`--show-layout`)."
    return make_message("{column} does not", column=name), (
        "See what this column holds, and whether it was sorted or filled in apart from the others (`--show-layout`)."
    )
