"""Cheap looks at measurements that find what ruins a calibration. Doubt is reported, never mended."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from cellcal.calibration.arm.joint_kinds import shown_units
from cellcal.calibration.arm.kinematics import RobotModel
from cellcal.calibration.geometry import Array
from cellcal.calibration.identification.observations import Rows
from cellcal.calibration.message import join_messages, make_message

_FAR_FROM_ZERO_RAD = float(np.deg2rad(10.0))
_NEAR_RAD = float(np.deg2rad(2.0))
_FEW = 0.2  # of the rows may be the doubtful ones
_ALIKE = 0.3  # correlation of neighbouring residuals
_FLOOR_M = 5e-5
_MOST_STOPS = 12  # of a slide in a series
_SHARE = 0.3  # of the floor, above which a resolution is named
_ENOUGH_ROWS = 20_000  # for a mean
_UNIFORM = 1 / np.sqrt(12.0)
_BEYOND_RAD = float(np.deg2rad(10.0))  # limits of descriptions are rounded, and robots overrun theirs
UNREPEATABLE_M = 2e-6
_FINE_STEP_M = 1e-5
_ROUNDED_ALONE = 0.55  # of a step: the median of what rounding of three coordinates leaves is 0.48
_FINE_M = 2e-5  # rounded joints leave as much
_ROUNDED_PLACE = 0.7  # of a step: what rounding of three coordinates leaves, and a fit adds
_BEYOND_TRAVEL = 0.05  # of a joint that slides


@dataclass(frozen=True, slots=True)
class Lint:
    """Something a person should look at: a short code, a sentence, and the rows it is about."""

    code: str
    message: str
    rows: tuple[int, ...] = ()


def sign_flips(joints_rad: Array, joint_names: Sequence[str]) -> list[Lint]:
    """Find joints whose sign may have been lost on the way into the file.

    A joint that is never near zero, has one sign in most rows and, in a few blocks of rows, the other sign at
    the same sizes, is doubtful. It may still be true: arms do flip their wrists.
    """
    found = []
    for joint, name in enumerate(joint_names):
        angle = joints_rad[:, joint]
        if np.abs(angle).min() < _FAR_FROM_ZERO_RAD:
            continue
        rare = angle > 0 if np.mean(angle > 0) < 0.5 else angle < 0
        if not 0 < rare.mean() <= _FEW or not _is_within(np.abs(angle[rare]), np.abs(angle[~rare])):
            continue
        starts = np.flatnonzero(np.diff(np.concatenate([[False], rare]).astype(int)) == 1)
        if len(starts) > max(3, len(angle) // 100):
            continue
        rows = np.flatnonzero(rare)
        blocks = ", ".join(
            _row_range(block) for block in np.split(rows, np.flatnonzero(np.diff(rows) > 1) + 1)
        )
        found.append(
            Lint(
                "sign",
                make_message(
                    "{name} has the other sign in {count} rows ({blocks}) at the same sizes as the others: "
                    "a minus sign may be lost. Used as written.",
                    name=name,
                    count=len(rows),
                    blocks=blocks,
                ),
                tuple(int(row) for row in rows),
            )
        )
    return found


def beyond_limits(model: RobotModel, joints_rad: Array) -> list[Lint]:
    """Name joints that stand far beyond the limits of the model: another zero, unit or robot, which a fit may absorb.

    The zeros of the first and the last joint, and of a joint that slides along with them, are one with the places of
    device and target. Joints that the controller couples with others are left out: their limits are told in two ways.
    """
    coupled = (np.abs(model.joint_coupling) > 0).sum(axis=1) > 1
    coupled |= (np.abs(model.joint_coupling) > 0).sum(axis=0) > 1
    slides = np.zeros(model.axis_count, dtype=bool) if model.sliding is None else model.sliding
    margin = np.where(slides, _BEYOND_TRAVEL * (model.upper_rad - model.lower_rad), _BEYOND_RAD)
    shown = joints_rad[:, ~slides]
    if (shown >= 0.0).all() and (shown > np.pi).any(axis=0).sum() > 1:  # counted from 0 to 360 deg
        joints_rad = np.where(~slides & (joints_rad > np.pi), joints_rad - 2 * np.pi, joints_rad)
    over = (joints_rad > model.upper_rad + margin) | (joints_rad < model.lower_rad - margin)
    found = []
    for joint in np.flatnonzero(over.any(axis=0) & ~coupled).tolist():
        scale, unit = (1e3, "mm") if slides[joint] else (float(np.degrees(1.0)), "deg")
        rows, angle = np.flatnonzero(over[:, joint]), joints_rad[:, joint] * scale
        lower, upper = model.lower_rad[joint] * scale, model.upper_rad[joint] * scale
        found.append(
            Lint(
                "limits",
                make_message(
                    "{joint} goes from {least:.1f} to {most:.1f} {unit}, and the limits of {model} are {lower:.1f} "
                    "and {upper:.1f}: see its zero, its unit, and which robot was measured. Another zero of the "
                    "first or the last joint does not show in a fit, and puts the robot elsewhere.",
                    joint=model.joint_names[joint],
                    least=angle.min(),
                    most=angle.max(),
                    unit=unit,
                    model=model.label,
                    lower=lower,
                    upper=upper,
                ),
                tuple(rows.tolist()),
            )
        )
    return found


def find_duplicates(joints_rad: Array) -> list[Lint]:
    """Find rows with exactly the joints of an earlier row."""
    _, first, inverse = np.unique(joints_rad, axis=0, return_index=True, return_inverse=True)
    repeated = np.flatnonzero(first[inverse.reshape(-1)] != np.arange(len(joints_rad)))
    if not len(repeated):
        return []
    return [
        Lint(
            "duplicates",
            make_message(
                "{count} rows repeat the joints of an earlier row: they weigh twice.", count=len(repeated)
            ),
            tuple(int(row) for row in repeated),
        )
    ]


def find_leakage(fitted_joints_rad: Array, check_joints_rad: Array) -> list[Lint]:
    """Find check rows whose joints the fit has seen."""
    fitted_joints = {row.tobytes() for row in np.ascontiguousarray(fitted_joints_rad + 0.0)}
    rows = [
        i
        for i, row in enumerate(np.ascontiguousarray(check_joints_rad + 0.0))
        if row.tobytes() in fitted_joints
    ]
    if not rows:
        return []
    return [
        Lint(
            "leakage",
            make_message(
                "{rows} check rows have joints that the fit has seen: not independent.", rows=len(rows)
            ),
            tuple(rows),
        )
    ]


def beyond_fitted_range(fitted_joints_rad: Array, check_joints_rad: Array) -> list[Lint]:
    """Find check rows that turn a joint further than any fitted row did."""
    low, high = fitted_joints_rad.min(axis=0) - _NEAR_RAD, fitted_joints_rad.max(axis=0) + _NEAR_RAD
    rows = np.flatnonzero(((check_joints_rad < low) | (check_joints_rad > high)).any(axis=1))
    if not len(rows):
        return []
    return [
        Lint(
            "extrapolation",
            make_message(
                "{count} check rows turn a joint further than any fitted row: sag and ripple are extrapolated.",
                count=len(rows),
            ),
            tuple(int(row) for row in rows),
        )
    ]


def rounding_floor(
    model: RobotModel, joints_rad: Array, joint_step_rad: Array, value_step_m: float
) -> list[Lint]:
    """Say what the rounding of joints and values alone does to the errors, if it is worth saying."""
    if model.sliding is not None:  # a slide that was sent to a few round places is not read to whole metres
        stops = [len(np.unique(places)) <= _MOST_STOPS for places in joints_rad.T]
        joint_step_rad = np.where(model.sliding & np.array(stops), 0.0, joint_step_rad)
    _, jacobian = model.tip_jacobian(joints_rad[:: 1 + len(joints_rad) // _ENOUGH_ROWS], np.zeros(3))
    by_joint = np.sqrt(((jacobian * joint_step_rad * _UNIFORM) ** 2).sum(axis=(1, 2)).mean())
    floor = float(np.hypot(by_joint, value_step_m * _UNIFORM))
    if floor < _FLOOR_M:
        return []
    coarse = []
    if by_joint >= _SHARE * floor:
        factors, units = shown_units(model)
        largest = int(np.argmax((jacobian**2).sum(axis=(0, 1)) * joint_step_rad**2))
        step = (
            (joint_step_rad * factors)[largest] if len(set(units)) > 1 else (joint_step_rad * factors).max()
        )
        coarse.append(make_message("joints are rounded to {step:g} {unit}", step=step, unit=units[largest]))
    if value_step_m * _UNIFORM >= _SHARE * floor:
        coarse.append(make_message("measured values are rounded to {step:g} mm", step=value_step_m * 1e3))
    return [
        Lint(
            "resolution",
            make_message(
                "{roundings}: from that alone an error of {floor:.2f} mm (RMS) is to be expected where nothing "
                "sharpens them.",
                roundings=join_messages(", ", coarse),
                floor=floor * 1e3,
            ),
        )
    ]


def controller_positions(doubtful: Sequence[int], disagreement_m: Array, *, used: bool) -> list[Lint]:
    """Say how the controller's printed positions relate to the joints, and what they were used for."""
    usual = float(np.median(disagreement_m)) * 1e3
    how = (
        "they serve to sharpen the rounded joints, never as truth."
        if used
        else "they serve to check the joints, never as truth."
    )
    found = [
        Lint(
            "controller",
            make_message(
                "the controller's x, y, z agree with the joints to {usual:.2f} mm (median); {how}",
                usual=usual,
                how=how,
            ),
        )
    ]
    if doubtful:
        worst = float(disagreement_m[list(doubtful)].max()) * 1e3
        found.append(
            Lint(
                "controller_rows",
                make_message(
                    "the controller's x, y, z and the joints contradict each other in {count} rows (up to "
                    "{worst:.1f} mm): one of the two is not what the arm did. Joints used as written.",
                    count=len(doubtful),
                    worst=worst,
                ),
                tuple(doubtful),
            )
        )
    return found


def find_nominal_positions(errors_m: Array, step_m: float) -> list[Lint]:
    """Warn if the "measured" positions are the nominal arm's own, to within their rounding."""
    rounded_m = max(_ROUNDED_ALONE * step_m, min(2 * step_m, _FINE_M))
    if len(errors_m) == 0 or float(np.median(errors_m)) > max(rounded_m, 1e-6):
        return []
    return [
        Lint(
            "not_measured",
            "the measured values equal the nominal forward kinematics: they look computed, not measured.",
        )
    ]


def find_calculated_positions(held_out_m: Array, step_m: float) -> list[Lint]:
    """Warn if rows that were not fitted are predicted closer than an arm repeats: its own controller calculated them.

    A controller with a model of its own, an identified one, is not the nominal arm. Values rounded beyond 0.01 mm do
    not tell.
    """
    left_m = float(np.median(held_out_m)) if len(held_out_m) else np.inf
    closest = max(UNREPEATABLE_M, _ROUNDED_PLACE * step_m if step_m <= _FINE_STEP_M else 0.0)
    if left_m > closest:
        return []
    return [
        Lint(
            "not_measured",
            make_message(
                "held-out rows are predicted to {left:.4f} mm, closer than an arm repeats: the values look "
                "calculated by a controller with a model of its own, not measured.",
                left=left_m * 1e3,
            ),
        )
    ]


def find_alike_neighbours(residuals: Array, postures: Rows | None = None) -> list[Lint]:
    """Warn if neighbouring residuals (channels, N) are alike: something drifts unmodelled.

    Readings of one posture (N,) one after the other are alike because the posture is, and count as one.
    """
    if postures is not None and len(postures):
        first = np.flatnonzero(np.diff(postures, prepend=postures[0] - 1))
        residuals = np.add.reduceat(residuals, first, axis=1) / np.diff([*first, len(postures)])
    centred = residuals - residuals.mean(axis=1, keepdims=True)
    if residuals.shape[1] < 30:
        return []
    rho = float((centred[:, 1:] * centred[:, :-1]).sum() / max(float((centred**2).sum()), 1e-300))
    if rho < _ALIKE:
        return []
    return [
        Lint(
            "drift",
            make_message(
                "neighbouring residuals are alike (correlation {rho:.2f}): something drifts that the model does not "
                "have. Held-out errors, by groups, are not affected.",
                rho=rho,
            ),
        )
    ]


def _is_within(few: Array, many: Array) -> bool:
    return bool(few.min() > many.min() - _NEAR_RAD and few.max() < many.max() + _NEAR_RAD)


def _row_range(rows: Rows) -> str:
    return f"{rows[0]}" if len(rows) == 1 else f"{rows[0]}-{rows[-1]}"
