"""Zeros of joints far beyond what mastering leaves: found by a fit, refused, and written as a person would."""

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from cellcal.calibration.arm.kinematics import RobotModel
from cellcal.calibration.identification.column_options import columns_option
from cellcal.calibration.identification.estimator import errors_m
from cellcal.calibration.identification.misfit_error import (
    MisfitCause,
    MisfitError,
    MisfitScore,
    cure_or_others,
)
from cellcal.calibration.identification.misfit_fit import score_with_zeros
from cellcal.calibration.identification.misfit_hypotheses import (
    FileNames,
    JointInterpretation,
    home_reading,
    with_zeros,
)
from cellcal.calibration.identification.observations import Observations
from cellcal.calibration.identification.robust import RobustFit
from cellcal.calibration.message import make_message

_FAR_RAD = float(np.deg2rad(5.0))  # of a zero: ten deviations of what mastering may be off by
_SURE = 0.2  # of a far zero: its standard deviation
_ROUND_RAD = float(np.deg2rad(2.0))


def refuse_far_zero(
    model: RobotModel,
    some: Observations,
    stands: MisfitScore,
    names: FileNames,
    alike: Sequence[MisfitCause],
) -> None:
    """Refuse rows that fit only with a zero further off than any mastering leaves it.

    ``alike`` are causes that fit as well: a wrist whose first joint is half a turn off moves as one whose second
    joint counts the other way round.

    Raises
    ------
    MisfitError
        With the zeros, and how to say them.
    """
    far = far_zeros(stands)
    if far:
        home_cause = home_reading(some.joints_rad, far, names)
        others = [cause for cause in alike if len(cause.kinds) == 1 and cause.kinds != ("home",)]
        raise MisfitError(
            make_message(
                "the measurements fit {model_name} only if {says}.",
                model_name=model.label,
                says=home_cause.says,
            ),
            remedy=make_message(
                "{cure} Nothing was stored.",
                cure=cure_or_others(_with_track(model, far, names, home_cause.cure), others),
            ),
            causes=(MisfitCause(("home",), home_cause.says, home_cause.cure, stands.score_m), *others),
        )


def refuse_far_zero_of_fit(
    model: RobotModel, observations: Observations, found: RobustFit, names: FileNames
) -> None:
    """Refuse the end of an identification that put a zero further off than any mastering leaves it.

    Rows within which the device was moved far fit no zeros before that is found.

    Raises
    ------
    MisfitError
        With the zeros, and how to say them.
    """
    left_m = float(np.median(errors_m(found.fit.state, found.problem)))
    # Ten deviations of its prior: data drew it there, however wide such a misfit makes all deviations.
    stands = score_with_zeros(model, found.fit, np.zeros(len(found.fit.layout)), left_m)
    refuse_far_zero(model, observations, stands, names, ())


def _with_track(model: RobotModel, far: Mapping[int, float], names: FileNames, cure: str) -> str:
    """Return the cure of a far zero, and that of a track that runs elsewhere, which looks the same."""
    if model.sliding is None or not model.sliding[0] or list(far) != [1]:
        return cure
    slide, (track, *others) = names.joints[0], names.as_typed(names.joints)
    if abs(far[1]) < np.pi:
        return make_message(
            "{cure} It fits as well that {slide} runs in another direction than the description says, by as much: "
            "see its axis there.",
            cure=cure,
            slide=slide,
        )
    return make_message(
        "{cure} It fits as well that {slide} counts the other way round: {columns_option}.",
        cure=cure,
        slide=slide,
        columns_option=columns_option("joints", (track.turned(), *others)),
    )


def far_zeros(stands: MisfitScore) -> dict[int, float]:
    """Return by joint the zeros [rad] that a fit surely put far off."""
    last = len(stands.offsets_rad) - 1  # its zero and the first joint's are hidden by target and device
    return {
        joint: _round_angle(offset)
        for joint, (offset, sigma) in enumerate(zip(stands.offsets_rad, stands.sigma_rad, strict=True))
        if 0 < joint < last and abs(offset) > _FAR_RAD and sigma < _SURE * abs(offset)
    }


def with_fitted_zeros(
    reading: JointInterpretation, fitted: MisfitScore, names: FileNames
) -> JointInterpretation:
    """Return a reading with the zeros that its fit found, where they are far from none."""
    total = {
        joint: _round_angle(reading.zeros_rad.get(joint, 0.0) + offset)
        for joint, offset in enumerate(fitted.offsets_rad)
    }
    zeros = {joint: zero for joint, zero in total.items() if abs(zero) > _FAR_RAD}
    reading = replace(reading, joints_rad=reading.joints_rad + fitted.offsets_rad)
    if not zeros and not reading.zeros_rad:
        return reading
    return with_zeros(reading, zeros, names)


def _round_angle(angle_rad: float) -> float:
    """Return an angle as one would write it: whole quarter turns where it is one, else tenths of a degree."""
    angle_rad = float((angle_rad + np.pi) % (2 * np.pi) - np.pi)
    quarter = float(np.round(angle_rad / (np.pi / 2)) * (np.pi / 2))
    if quarter and abs(angle_rad - quarter) < _ROUND_RAD:
        return quarter
    return float(np.deg2rad(np.round(np.rad2deg(angle_rad), 1)))
