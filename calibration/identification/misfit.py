"""Measurements that do not fit their robot by far: which known cause explains them, found by fitting each one.

A fit that leaves half a metre is no calibration of anything. Before it is made, the rows are understood in every
way that files get wrong: mirrored axes, signs, zeros, order, coupling, units, rows beside each other, another robot.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from cellcal.calibration.arm.kinematics import RobotModel, load_model, model_names
from cellcal.calibration.arm.mounting import mounted_name, split_mounting
from cellcal.calibration.arm.robot_models.catalogue_index import catalogue_entries
from cellcal.calibration.geometry import Array
from cellcal.calibration.identification.distinct_postures import count_postures
from cellcal.calibration.identification.misfit_couplings import screw_readings
from cellcal.calibration.identification.misfit_doubts import column_doubts
from cellcal.calibration.identification.misfit_error import (
    MisfitCause,
    MisfitError,
    MisfitScore,
    cure_by_column,
    misfit_error,
)
from cellcal.calibration.identification.misfit_explaining import (
    ALIKE,
    ALIKE_M,
    DECISIVE,
    MOST_ROWS,
    explaining_causes,
    gross_m,
)
from cellcal.calibration.identification.misfit_fit import fit_quickly, motion_of, places_only
from cellcal.calibration.identification.misfit_hypotheses import (
    FileNames,
)
from cellcal.calibration.identification.misfit_joint_columns import joint_column_causes
from cellcal.calibration.identification.misfit_lag import lag_readings
from cellcal.calibration.identification.misfit_late import LateSearch
from cellcal.calibration.identification.misfit_lengths import length_readings
from cellcal.calibration.identification.misfit_parts import parts_error
from cellcal.calibration.identification.misfit_slides import (
    moved_slide_readings,
    refuse_straight_line,
    slide_readings,
    turn_readings,
)
from cellcal.calibration.identification.misfit_split import find_split
from cellcal.calibration.identification.misfit_zeros import far_zeros, refuse_far_zero
from cellcal.calibration.identification.observations import (
    LengthObservations,
    MeasuredRows,
    Observations,
    PointObservations,
    Rows,
)
from cellcal.calibration.identification.quick_fit import spread_rows, trimmed_rms
from cellcal.calibration.message import make_message

_FEWEST = {"point": 8, "pose": 8, "length": 14}
_SUSPECT = 0.002  # of the motion: no nominal arm with its mastering fitted is off by as much
_SUSPECT_M = 1e-3
_DECISIVE_NUMBER = 1.4  # times better with one more number: the pitch of a screw, or a lag
_FEWEST_SCREWED = 16
_FEWEST_TOLD_APART = 20  # rows, for hundreds of robots
_PARTS = 4  # of a series, one of which is likely without a break
_MANY_REPEATED = 0.5  # of the rows: fewer are typing errors
_CONSTANT = 1e-3  # of the motion of the flange
_STANDS_STILL_M = 1e-3
_NO_CAUSE = (
    "See that joints and measured values of a row belong together, which robot was measured, and what the columns "
    "are (`--show-layout`)."
)
_SEVERAL_TARGETS = (
    "Rows with the same joints hold different places: several targets or devices were measured in turn. Keep the "
    "rows of one in the file, or describe all of them in a layout (`--layout`, examples in `deploy/layouts/`)."
)


def refuse_misfit(
    model: RobotModel,
    observations: Observations,
    names: FileNames | None = None,
    *,
    search_models: bool = True,
) -> None:
    """Refuse rows that fit the robot badly and fit well with a known cause.

    Raises
    ------
    MisfitError
        With the cause, and how to say it; or that no known cause fits, nor a device that was moved in between.
    """
    names = names or FileNames(model.joint_names)
    # Rows of the same joints say nothing more about the arm.
    fewest = _FEWEST.get(observations.kind)
    if fewest is None or count_postures(observations.joints_rad, fewest) < fewest:
        return
    rows = spread_rows(len(observations), MOST_ROWS)
    some = observations.select_rows(rows)
    motion_m = motion_of(model, some)
    _refuse_constant(some, motion_m)
    stands = fit_quickly(model, some)
    if not np.isfinite(stands.score_m):
        refuse_straight_line(model, some)
    _refuse_one_number(model, observations, (stands.score_m, motion_m), names, rows)
    if stands.score_m > max(_SUSPECT * motion_m, _SUSPECT_M):
        others = _other_robots(model, model_names()) if search_models else []
        # A zero far off is a cause itself, which the fit found by chance: any that fits better takes its place.
        limit_m = stands.score_m / (1.0 if far_zeros(stands) else DECISIVE)
        causes = explaining_causes(model, observations, limit_m, names, others)
        decisive_m = min(stands.score_m / DECISIVE, gross_m(motion_m))
        causes = causes or _slides(model, some, decisive_m, names)
        causes = causes or joint_column_causes(model, observations, rows, names, fit_quickly, decisive_m)
        if causes:
            raise misfit_error(model, stands.score_m, motion_m, causes)
    if stands.score_m <= gross_m(motion_m):
        _refuse_far_zero(model, observations, stands, names)
        return
    sizes_m = stands.score_m, motion_m
    _refuse_unexplained(model, observations, rows, sizes_m, names, search_models=search_models)


def _refuse_unexplained(
    model: RobotModel,
    observations: Observations,
    rows: Rows,
    sizes_m: tuple[float, float],
    names: FileNames,
    *,
    search_models: bool,
) -> None:
    """Refuse a series that no reading explains, by the rows looked at; sizes are what is left and the motion."""
    left_m, motion_m = sizes_m
    late = LateSearch(model, observations, rows, names, min(left_m / DECISIVE, gross_m(motion_m)))
    if causes := late.find_causes():
        raise misfit_error(model, left_m, motion_m, causes)
    if _misfits_throughout(model, observations, gross_m(motion_m)):
        if search_models:
            _refuse_other_robot(model, observations, sizes_m, names)
        raise _unknown_cause_error(model, left_m, motion_m, observations, names)


def refuse_gross_misfit(
    model: RobotModel, observations: MeasuredRows, errors: Array, names: FileNames | None = None
) -> None:
    """Refuse the end of an identification whose errors (N,) [m] are as large as the robot.

    Raises
    ------
    MisfitError
        No known cause explains them.
    """
    motion_m, left_m = motion_of(model, observations), float(trimmed_rms(errors))
    limit_m = gross_m(motion_m)
    if left_m <= limit_m:
        return
    row = find_split(model, observations, min(limit_m, left_m / DECISIVE))
    if row is None:
        names = names or FileNames(model.joint_names)
        raise _unknown_cause_error(model, left_m, motion_m, observations, names)
    says = make_message(
        "the first {count} usable rows and the {rest} behind them fit {model_name} by themselves and not together: "
        "the device was moved in between, or the target, or another robot follows",
        count=row,
        rest=len(observations) - row,
        model_name=model.label,
    )
    cure = "Divide the file there and identify each part, or describe the parts in a layout (`--layout`)."
    raise MisfitError(
        make_message("{says}.", says=says),
        remedy=make_message("{cure} Nothing was stored.", cure=cure),
        causes=(MisfitCause(("split",), says, cure, 0.0),),
    )


def _refuse_far_zero(
    model: RobotModel, observations: Observations, stands: MisfitScore, names: FileNames
) -> None:
    """Refuse rows that the fit put far from their zeros, with every cause that fits as well."""
    if not far_zeros(stands):
        return
    limit_m = ALIKE * stands.score_m + ALIKE_M
    alike = explaining_causes(model, observations, limit_m, names, [])
    refuse_far_zero(model, observations, stands, names, alike)


def _refuse_constant(observations: Observations, motion_m: float) -> None:
    """Refuse readings that stay the same while the arm moves: a device that hangs, or the wrong columns."""
    if isinstance(observations, LengthObservations):
        what, values = "lengths", observations.lengths_m[:, None]
    else:
        what, values = "positions", observations.positions_m
    spread_m = float(np.sqrt(((values - np.median(values, axis=0)) ** 2).sum(axis=1).mean()))
    if motion_m < _STANDS_STILL_M or spread_m > _CONSTANT * motion_m:
        return
    raise MisfitError(
        make_message(
            "the measured {what} are the same in all rows, to {spread_mm:.3f} mm, while the joints "
            "move the flange by {motion_mm:.0f} mm.",
            what=what,
            spread_mm=spread_m * 1000.0,
            motion_mm=motion_m * 1000.0,
        ),
        remedy="See that the columns are those of the measured values (`--show-layout`), and that the device "
        "followed its target. Nothing was stored.",
    )


def _unknown_cause_error(
    model: RobotModel, left_m: float, motion_m: float, observations: MeasuredRows, names: FileNames
) -> MisfitError:
    if found := parts_error(model, observations, names, left_m, motion_m):
        return found
    several = _differ_at_same_joints(observations, gross_m(motion_m))
    remedy = _SEVERAL_TARGETS if several else _NO_CAUSE
    if doubts := column_doubts(model, observations):
        remedy = make_message("{doubts} {remedy}", doubts=doubts, remedy=remedy)
    if names.targets:
        remedy = cure_by_column(names.targets)
    if not np.isfinite(left_m):
        return MisfitError(
            make_message(
                "the measurements do not fit {model_name}: no place of base and target brings them together.",
                model_name=model.label,
            ),
            remedy=make_message("{remedy} Nothing was stored.", remedy=remedy),
        )
    return MisfitError(
        make_message(
            "the measurements do not fit {model_name}: errors of {left_mm:.1f} mm remain of a motion "
            "of {motion_mm:.0f} mm, and no known cause fits.",
            model_name=model.label,
            left_mm=left_m * 1000.0,
            motion_mm=motion_m * 1000.0,
        ),
        remedy=make_message("{remedy} Nothing was stored.", remedy=remedy),
    )


def _differ_at_same_joints(observations: MeasuredRows, limit_m: float) -> bool:
    """Return whether many rows repeat the joints of another row and measure another place."""
    if not isinstance(observations, PointObservations):
        return False
    _, posture, counts = np.unique(observations.joints_rad, axis=0, return_inverse=True, return_counts=True)
    posture = posture.reshape(-1)
    sums = np.zeros((len(counts), 3))
    np.add.at(sums, posture, observations.positions_m)
    away = np.linalg.norm(observations.positions_m - (sums / counts[:, None])[posture], axis=1)
    return bool(np.mean((counts[posture] > 1) & (away > limit_m / 2)) > _MANY_REPEATED)


def _misfits_throughout(model: RobotModel, observations: Observations, limit_m: float) -> bool:
    """Return whether no part of a series fits by itself: where one does, a device was moved between the parts."""
    fewest = _FEWEST[observations.kind]
    parts = np.array_split(np.arange(len(observations)), max(min(len(observations) // fewest, _PARTS), 1))
    return all(
        fit_quickly(model, observations.select_rows(part[spread_rows(len(part), MOST_ROWS)])).score_m
        > limit_m
        for part in parts
    )


def _refuse_other_robot(
    model: RobotModel, observations: Observations, sizes_m: tuple[float, float], names: FileNames
) -> None:
    """Refuse rows that another robot of the catalogue with as many joints fits."""
    left_m, motion_m = sizes_m
    entries = [entry for entry in catalogue_entries() if entry.usable and entry.axes == model.axis_count]
    if len(observations) < _FEWEST_TOLD_APART or not entries:
        return
    others = _other_robots(model, [entry.name for entry in entries])
    if causes := explaining_causes(model, observations, left_m / DECISIVE, names, others):
        raise misfit_error(model, left_m, motion_m, causes)


def _other_robots(model: RobotModel, names: Sequence[str]) -> list[RobotModel]:
    """Return other robots, mounted as this one is: what stands behind the name is no part of what was mistaken."""
    own, mounting = split_mounting(model.name)
    return [load_model(mounted_name(name, mounting)) for name in names if name != own]


def _refuse_one_number(
    model: RobotModel,
    observations: Observations,
    sizes_m: tuple[float, float],
    names: FileNames,
    rows: Rows,
) -> None:
    """Refuse rows with a screw at a slide, joints of another time, or a wire's zero: no error of an arm is such."""
    left_m, motion_m = sizes_m
    some, unexplained_m = observations.select_rows(rows), gross_m(motion_m)
    if isinstance(some, LengthObservations):
        limit_m = min(left_m / DECISIVE, unexplained_m)
        for lengths, cause in length_readings(model, some):
            if (fitted := fit_quickly(model, lengths, limit_m=limit_m)).score_m <= limit_m:
                raise misfit_error(model, left_m, motion_m, (replace(cause, remaining_m=fitted.score_m),))
        return
    if len(some) < _FEWEST_SCREWED:
        return
    places = places_only(some)
    limit_m = min(left_m / _DECISIVE_NUMBER, unexplained_m)
    for reading in (*screw_readings(model, some, names), *lag_readings(model, observations, rows)):
        fitted = fit_quickly(model, replace(places, joints_rad=reading.joints_rad), limit_m=limit_m)
        if fitted.score_m <= limit_m:
            cause = MisfitCause((reading.kind,), reading.says, reading.cure, fitted.score_m)
            raise misfit_error(model, left_m, motion_m, (cause,))


def _slides(
    model: RobotModel, some: Observations, limit_m: float, names: FileNames
) -> tuple[MisfitCause, ...]:
    """Return the joint that explains the rows if it slides in place of turning, or turns in place of sliding.

    Looked at last, for a long slide fits much.
    """
    found = []
    for reading in (
        *slide_readings(model, some.joints_rad, names),
        *turn_readings(model, some.joints_rad, names),
        *moved_slide_readings(model, some.joints_rad, names),
    ):
        if reading.model is None:
            continue
        fitted = fit_quickly(reading.model, replace(some, joints_rad=reading.joints_rad), limit_m=limit_m)
        if fitted.score_m <= limit_m:
            found.append(MisfitCause((reading.kind,), reading.says, reading.cure, fitted.score_m))
    return tuple(sorted(found, key=lambda cause: cause.remaining_m)[:1])
