"""Changes within a series that no unknown of the fit stands for.

A target sat elsewhere for a while, or changed twice, or beside a device that was moved; the zero of a joint changed.
One change of the target alone is found by `target_change`. Every change adds columns that count from its row on; sums
of their products from the end of the series give each place of change at the cost of a small system of equations.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import product

import numpy as np
from numpy.linalg import LinAlgError
from numpy.typing import NDArray

from cellcal.calibration.arm.kinematics import RobotModel
from cellcal.calibration.geometry import Array
from cellcal.calibration.identification.misfit_error import MisfitCause, MisfitError
from cellcal.calibration.identification.observations import Observations, Rows
from cellcal.calibration.identification.target_change import (
    BETTER_THAN_MOVED,
    DEVIATIONS,
    FEWEST_ROWS,
    SMALLEST_M,
    TIMES_BETTER,
    SeriesColumns,
    orthonormal_columns,
)
from cellcal.calibration.message import join_messages, make_message

TARGET, DEVICE, JOINT = "target", "device", "joint"
_DEVICE_COLUMNS = 6
_SMALLEST_RAD = 3e-4
_RIDGE = 1e-9
_COARSE = 40  # places of change that are looked at first
SAME_SIDES = (
    0.6  # a joint comes from one side before a row, and from the other behind it, in four of five rows
)
_SAME_PLACE = 0.25  # of the way: the target came back
_CURE = (
    "See what was on the robot then, whether it slipped, and whether a joint was mastered or the arm was hit. Divide "
    "the file at these rows and identify each part. Nothing was stored."
)

Columns = NDArray[np.intp]


@dataclass(frozen=True, slots=True)
class SeriesChange:
    """A change in a series: its kind, from which usable row on (from 0), up to which, and by how much."""

    kind: str
    row: int
    until: int  # the first row behind it, or -1: to the end
    size: float  # m, or rad of a joint
    joint: str = ""


@dataclass(frozen=True, slots=True)
class SeriesChanges:
    """Changes that explain the rows together, and what the rows leave without and with them [m]."""

    changes: tuple[SeriesChange, ...]
    before_m: float
    remaining_m: float


@dataclass(frozen=True, eq=False)
class _Hypothesis:
    parts: tuple[tuple[int, str, Columns], ...]  # row, kind and columns of each change
    scatter: float  # square sum of what is left, by degree of freedom
    found: Array
    sigmas: Array

    def sized(self) -> Iterator[tuple[int, str, Array, float]]:
        """Return row, kind, what was found and its standard deviation, for each part."""
        at = 0
        for row, kind, columns in self.parts:
            here = slice(at, at + len(columns))
            yield row, kind, self.found[here], float(np.linalg.norm(self.sigmas[here]))
            at += len(columns)

    def is_certain(self) -> bool:
        """Return whether each change of a target or joint is larger than chance and than what matters."""
        smallest = {TARGET: SMALLEST_M, JOINT: _SMALLEST_RAD, DEVICE: 0.0}
        return all(
            np.linalg.norm(found) > max(DEVIATIONS * sigma, smallest[kind])
            for _, kind, found, sigma in self.sized()
            if kind != DEVICE
        )


class _Search:
    """Hypotheses about one series."""

    def __init__(self, series: SeriesColumns) -> None:
        layout, count = series.layout, len(series.rows)
        plain = series.columns.transpose(2, 1, 0)  # (N, 3, p)
        base = orthonormal_columns(plain.reshape(3 * count, -1))
        values = series.left.T.reshape(-1)
        rest = values - base @ (base.T @ values)
        target = np.arange(layout.target_slice(0).start, layout.target_slice(0).stop)
        joints = [at for at, each in enumerate(layout.parameters) if each.name.endswith(" offset")]
        # The first joint is as a moved device, the last as a moved target.
        self.joints = {layout.parameters[at].name.removesuffix(" offset"): at for at in joints[1:-1]}
        self._parameters = layout.parameters
        self.rotations = {name for name, at in self.joints.items() if layout.parameters[at].unit == "rad"}
        self.target, self.device = target, np.arange(_DEVICE_COLUMNS)
        self.count, self.freedom = count, 3 * count - base.shape[1]
        self.square = float(rest @ rest)
        of_base = base.reshape(count, 3, -1)
        self._own = _sums(np.einsum("nci,ncj->nij", plain, plain))
        self._shared = _sums(np.einsum("nck,nci->nki", of_base, plain))
        self._right = _sums(np.einsum("nci,nc->ni", plain, rest.reshape(count, 3)))
        ramp = np.linspace(0.0, 1.0, count)[:, None, None] * plain
        self._ramp = (
            np.einsum("nci,ncj->ij", ramp, ramp)
            - (shared := np.einsum("nck,nci->ki", of_base, ramp)).T @ shared,
            np.einsum("nci,nc->i", ramp, rest.reshape(count, 3)),
        )

    def joint_at(self, column: int) -> int:
        """Return the index of the joint whose zero a column is."""
        return self._parameters[column].joint

    def plain_scatter(self) -> float:
        """Return what is left without a change."""
        return float(self.square / max(self.freedom, 1))

    def drift_scatter(self, columns: Columns) -> float:
        """Return what is left if these unknowns move steadily."""
        matrix, right = self._ramp[0][np.ix_(columns, columns)], self._ramp[1][columns]
        found = np.linalg.solve(matrix + _RIDGE * np.diag(np.diag(self._own[0])[columns]), right)
        return float((self.square - float(right @ found)) / max(self.freedom - len(columns), 1))

    def evaluate(self, parts: Sequence[tuple[int, str, Columns]]) -> _Hypothesis:
        """Return changes at certain rows, fitted beside everything else."""
        matrix, right = self._system(parts, np.array([[row for row, _, _ in parts]]))
        found = np.linalg.solve(matrix[0], right[0])
        freedom = max(self.freedom - len(found) - len(parts), 1)
        scatter = max(self.square - float(right[0] @ found), 1e-30) / freedom
        sigmas = np.sqrt(np.maximum(np.diag(np.linalg.inv(matrix[0])), 0.0) * scatter)
        return _Hypothesis(tuple(parts), scatter, found, sigmas)

    def best_single(self, kinds: Sequence[tuple[str, Columns]]) -> _Hypothesis:
        """Return the best row at which all of these change together."""
        rows = np.arange(FEWEST_ROWS, self.count - FEWEST_ROWS + 1)
        return self._best_at(kinds, np.column_stack([rows] * len(kinds)))

    def best_pair(self, first: tuple[str, Columns], second: tuple[str, Columns]) -> _Hypothesis:
        """Return the best two rows, coarsely and then row by row."""
        step = max(1, self.count // _COARSE)
        every = np.arange(FEWEST_ROWS, self.count - FEWEST_ROWS + 1)
        pairs = np.array(list(product(every[::step], every[::step])))
        best = self._best_at((first, second), pairs[pairs[:, 1] - pairs[:, 0] >= FEWEST_ROWS])
        for _ in range(2):
            around = [every[np.abs(every - row) <= step] for row, _, _ in best.parts]
            pairs = np.array(list(product(*around)))
            best = self._best_at((first, second), pairs[pairs[:, 1] - pairs[:, 0] >= FEWEST_ROWS])
        return best

    def _best_at(self, kinds: Sequence[tuple[str, Columns]], places: Rows) -> _Hypothesis:
        """Return the hypothesis of these kinds whose rows, one set a line of ``places``, leave least."""
        parts = [(0, kind, columns) for kind, columns in kinds]
        matrix, right = self._system(parts, places)
        found = np.linalg.solve(matrix, right[..., None])[..., 0]
        best = int(np.argmax(np.einsum("pi,pi->p", right, found)))
        rows = places[best].tolist()
        return self.evaluate([(row, kind, columns) for row, (kind, columns) in zip(rows, kinds, strict=True)])

    def _system(self, parts: Sequence[tuple[int, str, Columns]], places: Rows) -> tuple[Array, Array]:
        """Return normal equations (P, m, m) and right sides (P, m) of changes at rows (P, parts)."""
        blocks = []
        for i, (_, _, of_a) in enumerate(parts):
            line = []
            for j, (_, _, of_b) in enumerate(parts):
                a, b = places[:, i], places[:, j]
                own = self._own[:, of_a][:, :, of_b][np.maximum(a, b)]
                shared = np.matmul(
                    self._shared[:, :, of_a][a].transpose(0, 2, 1), self._shared[:, :, of_b][b]
                )
                line.append(own - shared)
            blocks.append(np.concatenate(line, axis=2))
        matrix = np.concatenate(blocks, axis=1)
        each = [(places[:, i], columns) for i, (_, _, columns) in enumerate(parts)]
        right = np.concatenate([self._right[:, columns][rows] for rows, columns in each], axis=1)
        sizes = np.concatenate([self._own[:, columns, columns][rows] for rows, columns in each], axis=1)
        # What other unknowns stand for stays small.
        matrix = matrix + _RIDGE * sizes[:, None, :] * np.eye(sizes.shape[1])
        return matrix, right


def _sums(parts: Array) -> Array:
    """Return sums from each row to the end."""
    found: Array = np.cumsum(parts[::-1], axis=0)[::-1]
    return found


def find_series_changes(series: SeriesColumns | None, observations: Observations) -> SeriesChanges | None:
    """Return changes that explain the rows far better than none, than a moved device, and than a lone target's.

    ``series`` is what `series_columns` tells of the observations.
    """
    if series is None or len(series.rows) < 3 * FEWEST_ROWS:
        return None
    try:
        search = _Search(series)
        found = _decisive(search)
    except LinAlgError:
        return None
    if found is None or _may_be_play(found, search, approaches(observations)[series.rows]):
        return None
    metres = float(np.median(series.sigma_m) * np.sqrt(3.0))
    return SeriesChanges(
        _named_changes(found, series.rows, search),
        metres * float(np.sqrt(search.plain_scatter())),
        metres * float(np.sqrt(found.scatter)),
    )


def approaches(observations: Observations) -> Array:
    """Return from which side each joint came (N, joints): 1 upwards, -1 downwards, as before where it stood."""
    joints_rad = observations.joints_rad
    signs = np.sign(np.diff(joints_rad, axis=0, prepend=joints_rad[:1]))
    for row in range(1, len(signs)):
        signs[row] = np.where(signs[row] == 0.0, signs[row - 1], signs[row])
    return signs


def _may_be_play(found: _Hypothesis, search: _Search, sides: Array) -> bool:
    """Return whether a joint whose zero changed comes to its places from the other side from that row on.

    The play of the joint explains such rows as well: a sweep upwards and back is no reason to refuse them.
    """
    row, kind, columns = found.parts[0]
    if kind != JOINT:
        return False
    behind = np.where(np.arange(len(sides)) >= row, 1.0, -1.0)
    agreement = float(np.mean(sides[:, search.joint_at(int(columns[0]))] * behind))
    return abs(agreement) > SAME_SIDES


def _decisive(search: _Search) -> _Hypothesis | None:
    target, device = (TARGET, search.target), (DEVICE, search.device)
    plain = search.plain_scatter()
    lone_target, lone_device = search.best_single([target]), search.best_single([device])
    simple = min(plain, lone_target.scatter, lone_device.scatter)
    zeros = [
        search.best_single([(JOINT, np.array([at]))])
        for name, at in search.joints.items()
        if name in search.rotations
    ]
    zero = min(zeros, key=lambda each: each.scatter, default=None)
    if zero is not None and _is_decisive(zero, simple, search.drift_scatter(zero.parts[0][2]), search):
        return zero
    both = search.best_single([target, device])
    pairs = [search.best_pair(a, b) for a, b in ((target, target), (target, device), (device, target))]
    best = min([both, *pairs], key=lambda each: each.scatter)
    moved = search.best_pair(device, device).scatter
    return best if _is_decisive(best, simple, moved, search) else None


def _is_decisive(found: _Hypothesis, simple: float, rival: float, search: _Search) -> bool:
    """Return whether a hypothesis leaves far less than simpler ones, and than a rival and a drift of the device."""
    drift = min(rival, search.drift_scatter(search.device))
    return (
        TIMES_BETTER**2 * found.scatter < simple
        and BETTER_THAN_MOVED**2 * found.scatter < drift
        and found.is_certain()
    )


def _named_changes(found: _Hypothesis, rows: Rows, search: _Search) -> tuple[SeriesChange, ...]:
    parts = list(found.sized())
    if [kind for _, kind, _, _ in parts] == [TARGET, TARGET]:
        (first, _, away, _), (second, _, back, _) = parts
        if np.linalg.norm(away + back) < _SAME_PLACE * np.linalg.norm(away):
            size = float(np.linalg.norm(away))
            return (SeriesChange(TARGET, int(rows[first]), int(rows[second]), size),)
    names = {at: name for name, at in search.joints.items()}
    return tuple(
        SeriesChange(
            kind,
            int(rows[row]),
            -1,
            float(np.linalg.norm(size)),
            names.get(int(columns[0]), "") if kind == JOINT else "",
        )
        for (row, kind, size, _), (_, _, columns) in zip(parts, found.parts, strict=True)
    )


def refuse_series_changes(model: RobotModel, found: SeriesChanges | None, file_rows: Rows) -> None:
    """Refuse a series within which something changed; ``file_rows`` are the rows' numbers in the file.

    Raises
    ------
    MisfitError
        With what changed, at which rows, by how much, and the cure.
    """
    if found is None:
        return
    says = join_messages(", and ", [_say_change(each, file_rows) for each in found.changes])
    raise MisfitError(
        make_message(
            "something changed within the series of {model_name}: {left_mm:.2f} mm remain, and {remaining_mm:.2f} mm "
            "if {says} (the first data row is row 0).",
            model_name=model.label,
            left_mm=found.before_m * 1000.0,
            remaining_mm=found.remaining_m * 1000.0,
            says=says,
        ),
        remedy=_CURE,
        causes=(MisfitCause(tuple(each.kind for each in found.changes), says, _CURE, found.remaining_m),),
    )


def _say_change(change: SeriesChange, file_rows: Rows) -> str:
    row = int(file_rows[change.row])
    if change.kind == DEVICE:
        return make_message("the device stands elsewhere from row {row} on", row=row)
    if change.kind == JOINT:
        return make_message(
            "the zero of {joint} is off by {angle_deg:.3f} deg from row {row} on",
            joint=change.joint,
            angle_deg=float(np.rad2deg(change.size)),
            row=row,
        )
    if change.until < 0:
        return make_message(
            "the target sits {moved_mm:.2f} mm elsewhere on the flange from row {row} on",
            moved_mm=change.size * 1000.0,
            row=row,
        )
    return make_message(
        "the target sits {moved_mm:.2f} mm elsewhere on the flange in the rows {row} to {last}",
        moved_mm=change.size * 1000.0,
        row=row,
        last=int(file_rows[change.until]) - 1,
    )
