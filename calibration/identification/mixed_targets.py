"""Two targets that were measured in turn and that no column tells apart: the rows are divided by what they leave."""

from dataclasses import dataclass

import numpy as np
from numpy.linalg import LinAlgError
from numpy.typing import NDArray

from cellcal.calibration.arm.kinematics import RobotModel
from cellcal.calibration.geometry import Array
from cellcal.calibration.identification.misfit_error import MisfitCause, one_target_error
from cellcal.calibration.identification.observations import Rows
from cellcal.calibration.identification.rows_apart import describe_rows
from cellcal.calibration.identification.target_change import (
    DEVIATIONS,
    FEWEST_ROWS,
    SMALLEST_M,
    SeriesColumns,
    orthonormal_columns,
)
from cellcal.calibration.message import make_message

_TIMES_BETTER = 2.0  # what the rows leave must fall by so much: dividing noise in two gains a fifth
_SPARE = 24  # channels, beside the unknowns and one choice for each row
_LEAST_SHARE = 0.1
_FEWEST_TURNS = 4  # from one target to the other: fewer are changes of a series
_ROUNDS = 30
_MOST_RANGES = 80  # each row is needed to divide the file
_CURE = (
    "Say which target each row is of in a column of its own, and keep the rows of one in the file, or describe both "
    "in a layout (`--layout`, examples in `deploy/layouts/`)."
)


@dataclass(frozen=True, eq=False)
class MixedTargets:
    """Rows of two targets among each other."""

    second: Rows  # of the series, those of the target that was measured less often
    apart_m: float
    remaining_m: float
    before_m: float

    def as_cause(self, file_rows: Rows | None) -> MisfitCause:
        """Return them as a cause; ``file_rows`` are the numbers of the series' rows in the file."""
        rows = self.second if file_rows is None else file_rows[self.second]
        says = make_message(
            "two targets {apart_mm:.2f} mm apart on the flange were measured in turn, and rows {listed} are of one "
            "of them (the first data row is row 0)",
            apart_mm=self.apart_m * 1e3,
            listed=describe_rows(rows, _MOST_RANGES),
        )
        return MisfitCause(("target",), says, _CURE, self.remaining_m)


def find_mixed_targets(found: SeriesColumns | None) -> MixedTargets | None:
    """Return the division of the rows into two targets with which they fit far better, if there is one."""
    if found is None:
        return None
    count, unknowns = found.left.shape[1], len(found.columns)
    if 2 * count < unknowns + 3 + _SPARE:
        return None
    try:
        return _Division(found).best()
    except LinAlgError:
        return None


class _Division:
    """The linear fit of a series, with a second target for some of its rows."""

    def __init__(self, found: SeriesColumns) -> None:
        self._found, count = found, found.left.shape[1]
        self._values = found.left.T.reshape(-1)
        plain = found.columns.transpose(2, 1, 0).reshape(3 * count, -1)
        self._base = orthonormal_columns(plain)
        self._target = plain[:, found.layout.target_slice(0)].reshape(count, 3, 3)
        self._freedom = max(3 * count - self._base.shape[1], 1)

    def best(self) -> MixedTargets | None:
        """Return the best division of three starts: along each direction in which the rows disagree."""
        rest = self._rest(self._values)
        away = np.linalg.solve(self._target, rest.reshape(-1, 3, 1))[..., 0]
        away = away - np.median(away, axis=0)
        directions = np.linalg.svd(away, full_matrices=False)[2]
        divided = [self._divide(away @ direction > 0.0) for direction in directions]
        left, is_second, moved, free = min(divided, key=lambda each: each[0])
        return self._judge(float(rest @ rest), left, is_second, moved, free)

    def _rest(self, values: Array) -> Array:
        rest: Array = values - self._base @ (self._base.T @ values)
        return rest

    def _divide(self, is_second: NDArray[np.bool_]) -> tuple[float, NDArray[np.bool_], Array, Array]:
        """Return what is left, the rows of the second target, where it is, and its columns beside the others."""
        for _ in range(_ROUNDS):
            left, moved, free = self._fit(is_second)
            shift = (self._target @ moved).reshape(-1, 3)
            # Each row with its target, and with the other one; what all rows share stays where it is.
            here = left.reshape(-1, 3)
            other = here + np.where(is_second, 1.0, -1.0)[:, None] * shift
            changed = is_second ^ ((other**2).sum(axis=1) < (here**2).sum(axis=1))
            if (changed == is_second).all() or not 0 < changed.sum() < len(changed):
                break
            is_second = changed
        left, moved, free = self._fit(is_second)
        return float(left @ left), is_second, moved, free

    def _fit(self, is_second: NDArray[np.bool_]) -> tuple[Array, Array, Array]:
        columns = (self._target * is_second[:, None, None]).reshape(-1, 3)
        free = columns - self._base @ (self._base.T @ columns)
        rest = self._rest(self._values)
        moved = np.asarray(np.linalg.lstsq(free, rest, rcond=1e-9)[0], dtype=np.float64)
        return rest - free @ moved, moved, free

    def _judge(
        self, before: float, after: float, is_second: NDArray[np.bool_], moved: Array, free: Array
    ) -> MixedTargets | None:
        smaller = is_second if 2 * is_second.sum() <= len(is_second) else ~is_second
        scatter = after / max(self._freedom - 3, 1)
        size_m = float(np.linalg.norm(moved))
        sigma_m = float(np.sqrt(max(np.trace(np.linalg.pinv(free.T @ free)) * scatter, 1e-30)))
        if (
            before < _TIMES_BETTER**2 * after
            or size_m < max(DEVIATIONS * sigma_m, SMALLEST_M)
            or smaller.sum() < max(FEWEST_ROWS, _LEAST_SHARE * len(smaller))
            or np.count_nonzero(np.diff(smaller)) < _FEWEST_TURNS
        ):
            return None
        metres = float(np.median(self._found.sigma_m) * np.sqrt(3.0))
        return MixedTargets(
            self._found.rows[np.flatnonzero(smaller)],
            size_m,
            metres * float(np.sqrt(scatter)),
            metres * float(np.sqrt(before / self._freedom)),
        )


def refuse_mixed_targets(model: RobotModel, mixed: MixedTargets | None, file_rows: Rows) -> None:
    """Refuse rows of two targets that were taken as of one.

    Raises
    ------
    MisfitError
        With the rows, the distance and the cure.
    """
    if mixed is None:
        return
    cause = mixed.as_cause(file_rows)
    remedy = make_message("{cure} Nothing was stored.", cure=cause.cure)
    raise one_target_error(model, mixed.before_m, cause, remedy)
