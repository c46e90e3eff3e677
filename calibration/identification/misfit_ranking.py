"""All known causes of a misfit, ranked by quick fits of base and tool: the few that are worth a real fit."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from math import log

import numpy as np

from cellcal.calibration.arm.kinematics import RobotModel
from cellcal.calibration.geometry import Array
from cellcal.calibration.identification.column_options import columns_option
from cellcal.calibration.identification.lints import beyond_limits
from cellcal.calibration.identification.misfit_couplings import coupled_readings, model_readings
from cellcal.calibration.identification.misfit_hypotheses import (
    LENGTH_UNITS,
    USUAL_LENGTH_UNITS,
    FileNames,
    JointInterpretation,
    joint_readings,
    plain_reading,
)
from cellcal.calibration.identification.observations import (
    LengthObservations,
    Observations,
    PointObservations,
    Rows,
)
from cellcal.calibration.identification.quick_fit import has_enough_lengths, length_scores, point_scores
from cellcal.calibration.message import make_message

_PLAUSIBLE = log(4.0)  # how much wider or narrower than the flange a target may move
_WORTH = 24  # candidates for a real fit
_WORTH_SINGLE = 160  # where no quick fit ranks them
_MOST_PARTS = 3
_LONGEST_M = 30.0
_SHORTEST_M = 0.02


@dataclass(frozen=True, eq=False)
class MisfitCandidate:
    """The rows as one cause would have them."""

    reading: JointInterpretation
    model: RobotModel
    observations: Observations
    unit: str = ""  # of positions or lengths, if it is not the one that was taken
    mirrored: bool = False
    names: FileNames | None = None
    scale: float = (
        1.0  # of measured values, if the unit is another: a smaller one leaves smaller errors of the same fit
    )

    @property
    def part_count(self) -> int:
        """The number of things that are wrong at once."""
        return self.reading.parts + bool(self.unit) + self.mirrored

    @property
    def kinds(self) -> tuple[str, ...]:
        """The kinds of the parts that are wrong."""
        zeros = "home" if self.reading.zeros_rad else ""
        joints = self.reading.kind if self.reading.kind != "home" else ""
        words = ("unit" if self.unit else "", "mirror" if self.mirrored else "", joints, zeros)
        return tuple(word for word in words if word)

    @property
    def goes_beyond_limits(self) -> bool:
        """Whether joints would have been where the arm cannot go: often all that is unlike its mirror image."""
        return bool(beyond_limits(self.model, self.reading.joints_rad))

    @property
    def cause_texts(self) -> list[str]:
        """The causes beside that of the joints, in words."""
        lengths = isinstance(self.observations, LengthObservations)
        taken = self.names.length_unit if self.names and self.names.length_unit else "what they were taken as"
        texts = (
            [
                make_message(
                    "the {detail} are in {unit}, not in {taken}",
                    detail="lengths" if lengths else "positions",
                    unit=self.unit,
                    taken=taken,
                )
            ]
            if self.unit
            else []
        )
        if self.mirrored:
            texts.append(
                "the measured positions are a mirror image: one of the axes X, Y, Z has the wrong sign, or two of "
                "these columns are swapped"
            )
        return texts

    @property
    def cure_texts(self) -> list[str]:
        """The cures in words."""
        what = "length" if isinstance(self.observations, LengthObservations) else "position"
        cures = (
            [make_message("Say so: `--units {what}={unit}`.", what=what, unit=self.unit)] if self.unit else []
        )
        if self.mirrored:
            names = self.names or FileNames(self.model.joint_names)
            x, y, z = names.as_typed(names.position)
            cures.append(
                make_message(
                    "See which axis of the instrument's frame points the other way, and turn its sign: "
                    "{turned}; or name the columns in their right order: {swapped}.",
                    turned=columns_option("position", (x, y.turned(), z)),
                    swapped=columns_option("position", (y, x, z)),
                )
            )
        return cures


@dataclass(frozen=True, slots=True)
class _Combination:
    """One combination before it is fitted."""

    reading: int
    unit: str
    scale: float
    mirrored: bool
    parts: int


def coarse_candidates(
    model: RobotModel,
    observations: Observations,
    rows: Rows,
    names: FileNames,
    others: Sequence[RobotModel],
) -> list[MisfitCandidate]:
    """Return the causes that fit best when only base and tool are fitted."""
    some = observations.select_rows(rows)
    readings = [
        plain_reading(some.joints_rad),
        *joint_readings(model, observations.joints_rad, rows, names),
        *coupled_readings(model, some.joints_rad, names),
        *model_readings(some.joints_rad, names, others),
    ]
    if isinstance(some, LengthObservations):
        return _length_candidates(model, some, readings, names)
    return _point_candidates(model, some, readings, names)


def _flange_poses(model: RobotModel, readings: Sequence[JointInterpretation]) -> Array:
    """Return the flange of every row of every reading (H, N, 4, 4)."""
    rows = len(readings[0].joints_rad)
    flanges = np.empty((len(readings), rows, 4, 4))
    by_model: dict[str, list[int]] = {}
    models = {}
    for at, reading in enumerate(readings):
        chain = reading.model or model
        models[chain.name] = chain
        by_model.setdefault(chain.name, []).append(at)
    for name, members in by_model.items():
        joints = np.concatenate([readings[at].joints_rad for at in members])
        flanges[members] = models[name].base_flange(joints).reshape(len(members), rows, 4, 4)
    return flanges


def _point_candidates(
    model: RobotModel, some: PointObservations, readings: Sequence[JointInterpretation], names: FileNames
) -> list[MisfitCandidate]:
    flanges = _flange_poses(model, readings)
    moved = np.sqrt((_centre_points(flanges[..., :3, 3]) ** 2).sum(axis=2).mean(axis=1))
    spread_m = float(np.sqrt((_centre_points(some.positions_m[None]) ** 2).sum(axis=2).mean()))
    ways = [
        way
        for at, reading in enumerate(readings)
        for unit, scale in _plausible_units(names.length_unit, float(moved[at]), spread_m)
        for mirrored in (False, True)
        if (way := _make_combination(at, reading, unit, scale, mirrored=mirrored)).parts
    ]
    chosen = np.array([way.reading for way in ways])
    scales = np.array([way.scale for way in ways])
    positions = scales[:, None, None] * some.positions_m
    scores = point_scores(flanges[chosen], positions, np.array([way.mirrored for way in ways])) / scales
    return [
        MisfitCandidate(
            readings[ways[at].reading],
            readings[ways[at].reading].model or model,
            replace(
                _without_mountings(some),
                joints_rad=readings[ways[at].reading].joints_rad,
                positions_m=positions[at] * (np.array([1.0, -1.0, 1.0]) if ways[at].mirrored else 1.0),
            ),
            ways[at].unit,
            ways[at].mirrored,
            names,
            ways[at].scale,
        )
        for at in _best_combinations(scores, ways)
    ]


def _without_mountings(some: PointObservations) -> PointObservations:
    return PointObservations(
        some.joints_rad, some.positions_m, some.sigma_m, np.zeros(len(some), dtype=np.intp)
    )


def _make_combination(
    at: int, reading: JointInterpretation, unit: str, scale: float, *, mirrored: bool
) -> _Combination:
    parts = reading.parts + bool(unit) + mirrored
    if parts > max(_MOST_PARTS, reading.parts):
        return _Combination(at, unit, scale, mirrored, 0)
    return _Combination(at, unit, scale, mirrored, parts)


def _best_combinations(scores: Array, ways: Sequence[_Combination]) -> list[int]:
    """Return the best of all, and the best of those with a single cause: zeros and errors of the arm shift ranks."""
    order = np.argsort(scores, kind="stable").tolist()
    single = [at for at in order if ways[at].parts == 1]
    return list(dict.fromkeys([*single[: _WORTH // 2], *order[: _WORTH // 2]]))


def _centre_points(points: Array) -> Array:
    centred: Array = points - points.mean(axis=1, keepdims=True)
    return centred


def _plausible_units(taken: str, moved_m: float, seen_m: float) -> list[tuple[str, float]]:
    """Return units in which the target moved about as far as the flange; the one that was taken is called ""."""
    scales = [("", 1.0)]
    used = LENGTH_UNITS.get(taken, 1.0)
    for unit, metres in USUAL_LENGTH_UNITS.items():
        away = abs(log(max(seen_m * metres / used, 1e-12) / max(moved_m, 1e-6)))
        if unit != (taken or "m") and away < _PLAUSIBLE:
            scales.append((unit, metres / used))
    return scales


def _length_candidates(
    model: RobotModel, some: LengthObservations, readings: Sequence[JointInterpretation], names: FileNames
) -> list[MisfitCandidate]:
    usual, used = float(np.median(np.abs(some.lengths_m))), LENGTH_UNITS.get(names.length_unit, 1.0)
    units = [("", 1.0)] + [
        (unit, metres / used)
        for unit, metres in USUAL_LENGTH_UNITS.items()
        if unit != (names.length_unit or "m") and _SHORTEST_M < usual * metres / used < _LONGEST_M
    ]
    ways = [
        way
        for at, reading in enumerate(readings)
        for unit, scale in units
        if 0 < (way := _make_combination(at, reading, unit, scale, mirrored=False)).parts <= _MOST_PARTS
    ]
    if has_enough_lengths(len(some)):
        flanges = _flange_poses(model, readings)
        lengths = np.array([way.scale for way in ways])[:, None] * some.lengths_m
        scores = length_scores(flanges[[way.reading for way in ways]], lengths)
        scores = scores / np.array([way.scale for way in ways])
        chosen = _best_combinations(scores, ways)
    else:
        chosen = [at for at, way in enumerate(ways) if way.parts == 1][:_WORTH_SINGLE]
    return [
        MisfitCandidate(
            readings[ways[at].reading],
            readings[ways[at].reading].model or model,
            replace(
                some,
                joints_rad=readings[ways[at].reading].joints_rad,
                lengths_m=some.lengths_m * ways[at].scale,
                mounting=np.zeros(len(some), dtype=np.intp),
            ),
            ways[at].unit,
            False,
            names,
            ways[at].scale,
        )
        for at in chosen
    ]
