"""Joints and measured values that belong to each other in another order: turned round, in parts, or displaced."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace

import numpy as np

from cellcal.calibration.arm.kinematics import RobotModel
from cellcal.calibration.geometry import Array
from cellcal.calibration.identification.misfit_error import MisfitCause, MisfitScore
from cellcal.calibration.identification.observations import (
    LengthObservations,
    Observations,
    PointObservations,
    Rows,
)
from cellcal.calibration.identification.quick_fit import (
    has_enough_lengths,
    length_scores,
    point_residuals,
    spread_rows,
    trimmed_joint_scores,
)
from cellcal.calibration.message import make_message

_FEWEST_ROWS = 16
_MOST_ROWS = 60
_MOST_TURNS = 600  # parts that may have changed places: a longer series is tried at its halves and ends
_FAR_END = 50
_FEWEST_ANCHORED = 12  # rows of an end that are in order, by which the others are judged
_DISPLACED = (1, -1, 2, -2, 3, -3)
_IN_ORDER = 0.9  # of the rows
_MOST_PLACES = 60  # of a displacement in a series of lengths
_MOST_LIKELY = 4  # orders of lengths are fitted
_AT_ONCE = 200
_ROUGH = 3.0  # times what may be left: ranking fits no zeros

Fit = Callable[[RobotModel, Observations], MisfitScore]


@dataclass(frozen=True, eq=False)
class _Order:
    """Which row's joints belong to the measured values of each row (N,)."""

    joints_of: Rows
    says: str
    cure: str


def pairing_causes(
    model: RobotModel, series: Observations, fit: Fit, limit_m: float
) -> tuple[MisfitCause, ...]:
    """Return the order of rows with which points or lengths, all and in the order of the file, fit their robot.

    Parameters
    ----------
    fit : function
        A quick fit of the arm.
    limit_m : float
        What rows that are explained leave at most [m].
    """
    if not np.isfinite(limit_m):
        return ()
    orders = [*_reversed_rows(len(series)), *_changed_parts(len(series)), *_sorted_as_text(len(series))]
    rows = spread_rows(len(series), _MOST_ROWS)
    if isinstance(series, PointObservations) and len(series) >= _FEWEST_ROWS:
        likely = orders[int(np.argmin(_scores(model, series, orders)))]
        tried = (likely, *_displaced_rows(model, series, limit_m))
    elif isinstance(series, LengthObservations) and has_enough_lengths(len(series)):
        orders += _displaced_anywhere(len(series))
        scores = _length_scores_of(model, series, orders)
        tried = tuple(orders[best] for best in np.argsort(scores)[:_MOST_LIKELY].tolist())
    else:
        return ()
    for order in tried:
        joints = series.joints_rad[order.joints_of][rows]
        left_m = fit(model, replace(series.select_rows(rows), joints_rad=joints)).score_m
        if left_m <= limit_m:
            return (MisfitCause(("rows",), order.says, order.cure, left_m),)
    return ()


def _scores(model: RobotModel, series: PointObservations, orders: list[_Order]) -> Array:
    rows = spread_rows(len(series), _MOST_ROWS)
    joints = np.array([series.joints_rad[order.joints_of][rows] for order in orders])
    return trimmed_joint_scores(model, joints, series.positions_m[rows])


def _length_scores_of(model: RobotModel, series: LengthObservations, orders: list[_Order]) -> Array:
    rows = spread_rows(len(series), _MOST_ROWS)
    flanges = model.base_flange(series.joints_rad)
    read = np.broadcast_to(series.lengths_m[rows], (_AT_ONCE, len(rows)))
    parts = [orders[at : at + _AT_ONCE] for at in range(0, len(orders), _AT_ONCE)]
    return np.concatenate(
        [
            length_scores(flanges[np.array([order.joints_of[rows] for order in part])], read[: len(part)])
            for part in parts
        ]
    )


def _displaced_anywhere(count: int) -> Iterator[_Order]:
    """Give a series in which one row or more is missing in one of the two, from any row on."""
    places = spread_rows(count - 2 * _FEWEST_ANCHORED, _MOST_PLACES) + _FEWEST_ANCHORED
    for shift in _DISPLACED:
        for first in places.tolist():
            yield _displaced_order(count, first, shift, about=len(places) == _MOST_PLACES)


def _reversed_rows(count: int) -> Iterator[_Order]:
    yield _Order(
        np.arange(count)[::-1],
        "measured values stand in the reverse order of the joints",
        "Turn the rows of one of them round.",
    )


def _sorted_as_text(count: int) -> Iterator[_Order]:
    """Give series one half of which was sorted by the names of its points as text: P1, P10, P11, P2."""
    for first in (0, 1):
        as_text = np.array(sorted(range(count), key=lambda at: str(at + first)))
        for joints_of, which in ((np.argsort(as_text), "the joints"), (as_text, "the measured values")):
            yield _Order(
                joints_of,
                make_message(
                    "{which} stand in the order of their points' names as text (1, 10, 11, 2)", which=which
                ),
                "Put joints and measured values in one order, by their points' numbers.",
            )


def _changed_parts(count: int) -> Iterator[_Order]:
    """Give series whose first part of joints belongs to the last part of measured values."""
    every = np.arange(1, count)
    if count > _MOST_TURNS:
        halves = (count // 2, count - count // 2)
        every = np.unique([*every[:_FAR_END], *halves, *every[-_FAR_END:]])
    for shift in every.tolist():
        yield _Order(
            np.roll(np.arange(count), shift),
            make_message(
                "the measured values of the first {first} rows belong to the joints of the last {first}, and those "
                "of the last {last} rows to the joints of the first {last}",
                first=shift,
                last=count - shift,
            ),
            "Put the two parts of the measured values in the other order.",
        )


def _displaced_rows(model: RobotModel, series: PointObservations, limit_m: float) -> Iterator[_Order]:
    """Give series in which a row is missing, or too many, in the joints or in the measured values."""
    count = len(series)
    at = np.arange(count)
    for share in (2, 3, 4):
        pair_count = count // share
        if pair_count < _FEWEST_ANCHORED:
            return
        good = _rows_in_order(model, series, at < pair_count, limit_m)
        plain = good[0]
        for shift, displaced in zip(_DISPLACED, good[1:], strict=True):
            # as many rows as fit: in order up to there, displaced from there on
            fits = np.r_[0, np.cumsum(plain)] + np.r_[np.cumsum(displaced[::-1])[::-1], 0]
            first = int(np.argmax(fits))
            if fits[first] >= _IN_ORDER * (count - abs(shift)) and pair_count <= first < count - 2:
                yield _displaced_order(count, first, shift)


def _rows_in_order(
    model: RobotModel, series: PointObservations, anchor: np.typing.NDArray[np.bool_], limit_m: float
) -> np.typing.NDArray[np.bool_]:
    """Return which rows fit with the joints of their row, and of each row that is displaced (1 + shifts, N).

    Base and tool are those of the anchored rows, with their own joints.
    """
    count = len(series)
    series_of = [
        np.where(anchor, np.arange(count), np.clip(np.arange(count) + shift, 0, count - 1))
        for shift in (0, *_DISPLACED)
    ]
    flanges = model.base_flange(series.joints_rad)[np.array(series_of)]
    places = np.broadcast_to(series.positions_m, (len(series_of), count, 3))
    weights = np.broadcast_to(anchor.astype(float), (len(series_of), count))
    away = point_residuals(flanges, places, np.zeros(len(series_of), dtype=bool), weights)
    good: np.typing.NDArray[np.bool_] = np.linalg.norm(away, axis=2) <= _ROUGH * limit_m
    return good


def _displaced_order(count: int, first: int, shift: int, *, about: bool = False) -> _Order:
    at = np.arange(count)
    joints_of = np.where(at < first, at, np.clip(at + shift, 0, count - 1))
    further = (
        make_message(
            "measured values belong to joints that stand {count} further down: measured values are missing there, or "
            "joints are too many",
            count=shift,
        )
        if shift > 0
        else make_message(
            "measured values belong to joints that stand {count} further up: joints are missing there, or measured "
            "values are too many",
            count=-shift,
        )
    )
    says = (
        make_message(
            "from about row {row} on (the first data row is row 0) {further}", row=first, further=further
        )
        if about
        else make_message(
            "from row {row} on (the first data row is row 0) {further}", row=first, further=further
        )
    )
    return _Order(
        joints_of, says, "Put an empty row where one is missing, or take out the row that is too many."
    )
