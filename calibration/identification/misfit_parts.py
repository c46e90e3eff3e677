"""Rows that fit in no known way as a whole: what their first and their last part say, each by itself.

A file with two faults, one of which begins in its middle (a target that was put on again, a joint whose sign was
turned), is explained by no single cause; its ends often are.
"""

import numpy as np

from cellcal.calibration.arm.kinematics import RobotModel
from cellcal.calibration.identification.misfit_error import MisfitCause, MisfitError
from cellcal.calibration.identification.misfit_explaining import (
    DECISIVE,
    MOST_ROWS,
    explaining_causes,
    gross_m,
)
from cellcal.calibration.identification.misfit_fit import fit_quickly, motion_of, places_only
from cellcal.calibration.identification.misfit_hypotheses import FileNames, home_reading
from cellcal.calibration.identification.misfit_joint_columns import joint_column_causes
from cellcal.calibration.identification.misfit_zeros import far_zeros
from cellcal.calibration.identification.observations import (
    MeasuredRows,
    Observations,
    PointObservations,
    PoseObservations,
)
from cellcal.calibration.identification.quick_fit import spread_rows
from cellcal.calibration.message import join_messages, make_message

_FEWEST_ROWS = 16  # of each part
_SHARE = 3
_DIVIDE = (
    "Something changed in between: target, device, or how a column was written. Divide the file where it did, and "
    "identify each part."
)


def parts_error(
    model: RobotModel, observations: MeasuredRows, names: FileNames, left_m: float, motion_m: float
) -> MisfitError | None:
    """Return the refusal that says what the first and the last third fit by; None where neither does."""
    count = len(observations) // _SHARE
    if not isinstance(observations, PointObservations | PoseObservations) or count < _FEWEST_ROWS:
        return None
    places = places_only(observations)
    first, last = (
        _cause_of(model, places.select_rows(rows), names)
        for rows in (np.arange(count), np.arange(len(places) - count, len(places)))
    )
    if first is None and last is None:
        return None
    if first is not None and last is not None and first.says == last.says:
        says = make_message(
            "the first {count} usable rows and the last {count}, each by themselves, {how}",
            count=count,
            how=_how(first),
        )
    else:
        says = join_messages(
            ", and ",
            (
                make_message("the first {count} usable rows {how}", count=count, how=_how(first)),
                make_message("the last {count} {how}", count=count, how=_how(last)),
            ),
        )
    cure = join_messages(" ", _cures(first, last))
    remaining_m = max(cause.remaining_m for cause in (first, last) if cause is not None)
    return MisfitError(
        make_message(
            "the measurements do not fit {model_name} as a whole: {left_mm:.1f} mm remain of a motion of "
            "{motion_mm:.0f} mm; {says}.",
            model_name=model.label,
            left_mm=left_m * 1e3,
            motion_mm=motion_m * 1e3,
            says=says,
        ),
        remedy=make_message("{cure} Nothing was stored.", cure=cure),
        causes=(MisfitCause(("part",), says, cure, remaining_m),),
    )


def _cause_of(model: RobotModel, part: Observations, names: FileNames) -> MisfitCause | None:
    """Return what a part fits by, a cause without words where it fits as it is; None where it does not."""
    rows = spread_rows(len(part), MOST_ROWS)
    some = part.select_rows(rows)
    stands, limit_m = fit_quickly(model, some), gross_m(motion_of(model, some))
    far = far_zeros(stands)
    fits = stands.score_m <= limit_m
    if fits and not far:
        return MisfitCause((), "", "", stands.score_m)
    # A zero far off is a cause itself, which the fit found by chance.
    limit_m = min(stands.score_m / (1.0 if far else DECISIVE), limit_m)
    causes = explaining_causes(model, part, limit_m, names, [])
    causes = causes or joint_column_causes(model, part, rows, names, fit_quickly, limit_m)
    if not causes and fits:
        home = home_reading(some.joints_rad, far, names)
        return MisfitCause(("home",), home.says, home.cure, stands.score_m)
    return next(iter(causes), None)


def _how(cause: MisfitCause | None) -> str:
    if cause is None:
        return "fit in no known way"
    return make_message("fit if {says}", says=cause.says) if cause.says else "fit as they are"


def _cures(first: MisfitCause | None, last: MisfitCause | None) -> list[str]:
    """Return what to do with the file, and with each part of it that needs something by itself."""
    of_first, of_last = (cause.cure if cause is not None else "" for cause in (first, last))
    if of_first == of_last:
        return [*filter(None, (of_first,)), _DIVIDE]
    return [
        _DIVIDE,
        *([make_message("The first part: {cure}", cure=of_first)] if of_first else []),
        *([make_message("The last part: {cure}", cure=of_last)] if of_last else []),
    ]
