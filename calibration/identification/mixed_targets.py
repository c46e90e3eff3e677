"""Two targets, or two devices, in turn that no column tells apart: the rows are divided by what they leave."""

from dataclasses import dataclass

import numpy as np
from numpy.linalg import LinAlgError
from numpy.typing import NDArray

from cellcal.calibration.arm.kinematics import RobotModel
from cellcal.calibration.geometry import Array
from cellcal.calibration.identification.misfit_error import MisfitCause, MisfitError, one_target_error
from cellcal.calibration.identification.observations import Observations, Rows
from cellcal.calibration.identification.rows_apart import describe_rows
from cellcal.calibration.identification.series_changes import SAME_SIDES, approaches
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
_WIDEST = 0.2  # of the distance between both, around each: what is continuous and cut in two has 0.24 to 0.38
_NORMAL = 1.4826  # a standard deviation, in median deviations
_DEVICE_COLUMNS = 6
_TARGET_CURE = (
    "Say which target each row is of in a column of its own, and keep the rows of one in the file, or describe both "
    "in a layout (`--layout`, examples in `deploy/layouts/`)."
)
_DEVICE_CURE = (
    "Say from which device or station each row is in a column of its own, and keep the rows of one in the file, or "
    "describe both in a layout (`--layout`, examples in `deploy/layouts/`)."
)


@dataclass(frozen=True, eq=False)
class MixedTargets:
    """Rows of two targets, or of two devices, among each other."""

    second: Rows  # of the series, those of the one that was measured less often
    is_device: bool
    apart_m: float  # of two devices: how far apart they see a target, in the mean
    remaining_m: float
    before_m: float

    def as_cause(self, file_rows: Rows | None) -> MisfitCause:
        """Return them as a cause; ``file_rows`` are the numbers of the series' rows in the file."""
        rows = self.second if file_rows is None else file_rows[self.second]
        listed, apart_mm = describe_rows(rows, _MOST_RANGES), self.apart_m * 1e3
        if self.is_device:
            says = make_message(
                "two devices or stations in turn measured places {apart_mm:.2f} mm apart, and rows {listed} are of "
                "one of them (the first data row is row 0)",
                apart_mm=apart_mm,
                listed=listed,
            )
            return MisfitCause(("device",), says, _DEVICE_CURE, self.remaining_m)
        says = make_message(
            "two targets {apart_mm:.2f} mm apart on the flange were measured in turn, and rows {listed} are of one "
            "of them (the first data row is row 0)",
            apart_mm=apart_mm,
            listed=listed,
        )
        return MisfitCause(("target",), says, _TARGET_CURE, self.remaining_m)


def find_mixed_targets(found: SeriesColumns | None, observations: Observations) -> MixedTargets | None:
    """Return the division of the rows into two targets or devices with which they fit far better, if there is one.

    ``found`` is what `series_columns` tells of the observations. Play of the first joint looks as two devices, and of
    the last as two targets: rows that are divided by the side from which that joint came are not refused.
    """
    if found is None:
        return None
    count, unknowns = found.left.shape[1], len(found.columns)
    if 2 * count < unknowns + 3 + _SPARE:
        return None
    divided = []
    for is_device in (False, True):
        try:
            divided.append(_Division(found, is_device=is_device).best())
        except LinAlgError:
            continue
    best = min(filter(None, divided), key=lambda each: each.remaining_m, default=None)
    return None if best is None or _may_be_play(best, found, approaches(observations)) else best


def _may_be_play(mixed: MixedTargets, found: SeriesColumns, sides: Array) -> bool:
    of_one = np.where(np.isin(found.rows, mixed.second), 1.0, -1.0)
    joint = 0 if mixed.is_device else -1
    return abs(float(np.mean(sides[found.rows, joint] * of_one))) > SAME_SIDES


class _Division:
    """The linear fit of a series, with a second target or device for some of its rows."""

    def __init__(self, found: SeriesColumns, *, is_device: bool) -> None:
        self._is_device = is_device
        self._found, count = found, found.left.shape[1]
        self._values = found.left.T.reshape(-1)
        plain = found.columns.transpose(2, 1, 0).reshape(3 * count, -1)
        self._base = orthonormal_columns(plain)
        moving = slice(_DEVICE_COLUMNS) if is_device else found.layout.target_slice(0)
        self._columns = plain[:, moving].reshape(count, 3, -1)
        self._freedom = max(3 * count - self._base.shape[1], 1)

    def best(self) -> MixedTargets | None:
        """Return the best division of three starts: along each direction in which the rows disagree."""
        rest = self._rest(self._values)
        # What a device sees elsewhere is so in its own frame, and a target in that of the flange.
        away: Array = rest.reshape(-1, 3)
        if not self._is_device:
            away = np.asarray(np.linalg.solve(self._columns, away[..., None])[..., 0], dtype=np.float64)
        away = away - np.median(away, axis=0)
        directions = np.linalg.svd(away, full_matrices=False)[2]
        divided = [self._divide(away @ direction > 0.0) for direction in directions]
        left, is_second, moved, free = min(divided, key=lambda each: float(each[0] @ each[0]))
        return self._judge(float(rest @ rest), left, is_second, moved, free)

    def _rest(self, values: Array) -> Array:
        rest: Array = values - self._base @ (self._base.T @ values)
        return rest

    def _divide(self, is_second: NDArray[np.bool_]) -> tuple[Array, NDArray[np.bool_], Array, Array]:
        """Return what is left, the rows of the second one, where it is, and its columns beside the others."""
        for _ in range(_ROUNDS):
            left, moved, free = self._fit(is_second)
            shift = self._columns @ moved
            # Each row with its target, and with the other one; what all rows share stays where it is.
            here = left.reshape(-1, 3)
            other = here + np.where(is_second, 1.0, -1.0)[:, None] * shift
            changed = is_second ^ ((other**2).sum(axis=1) < (here**2).sum(axis=1))
            if (changed == is_second).all() or not 0 < changed.sum() < len(changed):
                break
            is_second = changed
        left, moved, free = self._fit(is_second)
        return left, is_second, moved, free

    def _fit(self, is_second: NDArray[np.bool_]) -> tuple[Array, Array, Array]:
        columns = self._columns * is_second[:, None, None]
        columns = columns.reshape(len(self._values), -1)
        free = columns - self._base @ (self._base.T @ columns)
        rest = self._rest(self._values)
        moved = np.asarray(np.linalg.lstsq(free, rest, rcond=1e-9)[0], dtype=np.float64)
        return rest - free @ moved, moved, free

    def _judge(
        self, before: float, left: Array, is_second: NDArray[np.bool_], moved: Array, free: Array
    ) -> MixedTargets | None:
        after = float(left @ left)
        smaller = is_second if 2 * is_second.sum() <= len(is_second) else ~is_second
        scatter = after / max(self._freedom - len(moved), 1)
        shift = self._columns @ moved
        lengths = np.linalg.norm(shift, axis=1)
        metres = float(np.median(self._found.sigma_m))
        # Of a target where it is on the flange, in metres; of a device what each row sees.
        size_m = float(np.mean(lengths)) * metres if self._is_device else float(np.linalg.norm(moved))
        sigma_m = float(np.sqrt(max(np.trace(np.linalg.pinv(free.T @ free)) * scatter, 1e-30)))
        chance_m = 0.0 if self._is_device else DEVIATIONS * sigma_m  # angles have no size in metres
        if (
            before < _TIMES_BETTER**2 * after
            or size_m < max(chance_m, SMALLEST_M)
            or smaller.sum() < max(FEWEST_ROWS, _LEAST_SHARE * len(smaller))
            or np.count_nonzero(np.diff(smaller)) < _FEWEST_TURNS
            or self._width(left, shift, lengths) > _WIDEST
        ):
            return None
        return MixedTargets(
            self._found.rows[np.flatnonzero(smaller)],
            self._is_device,
            size_m,
            metres * float(np.sqrt(3.0 * scatter)),
            metres * float(np.sqrt(3.0 * before / self._freedom)),
        )

    @staticmethod
    def _width(left: Array, shift: Array, lengths: Array) -> float:
        """Return how far rows scatter along the way from one to the other, as a share of it."""
        along = np.sum(left.reshape(-1, 3) * shift, axis=1) / np.maximum(lengths, 1e-30) ** 2
        return _NORMAL * float(np.median(np.abs(along)))


def refuse_mixed_targets(model: RobotModel, mixed: MixedTargets | None, file_rows: Rows) -> None:
    """Refuse rows of two targets, or of two devices, that were taken as of one.

    Raises
    ------
    MisfitError
        With the rows, the distance and the cure.
    """
    if mixed is None:
        return
    cause = mixed.as_cause(file_rows)
    remedy = make_message("{cure} Nothing was stored.", cure=cause.cure)
    if not mixed.is_device:
        raise one_target_error(model, mixed.before_m, cause, remedy)
    raise MisfitError(
        make_message(
            "the measurements do not fit {model_name} as seen by one device: {left_mm:.2f} mm remain, and "
            "{remaining_mm:.2f} mm if {says}.",
            model_name=model.label,
            left_mm=mixed.before_m * 1e3,
            remaining_mm=mixed.remaining_m * 1e3,
            says=cause.says,
        ),
        remedy=remedy,
        causes=(cause,),
    )
