"""Joint angles that a file has rounded, made sharper with the x, y, z that the controller printed.

The printed position is the controller's own forward kinematics of the joints it really had. It is a second
reading of the joints, not a measurement of the arm: it never serves as truth.
"""

from dataclasses import dataclass

import numpy as np

from cellcal.calibration.arm.kinematics import RobotModel
from cellcal.calibration.geometry import Array
from cellcal.calibration.identification.estimator import ArmFit, FitProblem, errors_m, estimate_arm
from cellcal.calibration.identification.first_guess import first_guess
from cellcal.calibration.identification.layouts import make_layout
from cellcal.calibration.identification.observations import PointObservations
from cellcal.calibration.identification.parameters import FRAMES

_STEPS = 4
_DISAGREES = 6.0  # deviations between printed position and joints, beyond which the row is left alone
_SINGLE = 1e-7  # of the largest value: what single precision leaves of a multiple
_UNIFORM = 1 / np.sqrt(12.0)  # standard deviation of rounding, in steps


@dataclass(frozen=True, eq=False)
class UnroundedJoints:
    """Sharper joints, and the rows whose printed position does not belong to their joints."""

    joints_rad: Array  # (N, n)
    disagreement_m: Array  # (N,): printed position against forward kinematics of the joints as printed
    doubtful_rows: tuple[int, ...]
    useful: bool  # the printed positions are sharper than what they would correct


def find_resolution(values: Array) -> float:
    """Return the largest step 1, 2, 5 x 10^k of which all values are multiples, or 0 if there is none.

    A step finer than a millionth of the largest value has no effect as a rounding.
    """
    finite = values[np.isfinite(values)]
    largest = float(np.abs(finite).max(initial=0.0))
    if largest == 0.0:
        return 0.0
    for exponent in range(int(np.ceil(np.log10(largest))), int(np.floor(np.log10(largest))) - 6, -1):
        for digit in (5.0, 2.0, 1.0):
            step = digit * 10.0**exponent
            if np.abs(finite / step - np.round(finite / step)).max() < _SINGLE * largest / step + 1e-9:
                return float(step)
    return 0.0


def unround_joints(
    model: RobotModel,
    joints_rad: Array,
    joint_step_rad: Array,
    printed_m: Array,
    printed_step_m: float,
) -> UnroundedJoints:
    r"""Sharpen rounded joints: minimise ``sum dq^2 / s_q^2 + |FK(q + dq) - printed|^2 / s_p^2``.

    Parameters
    ----------
    model : RobotModel
        Nominal: what the controller computes with.
    joints_rad : (N, n)
        As printed [rad].
    joint_step_rad : (n,)
        Rounding step of each joint [rad]; the correction never exceeds half of it.
    printed_m : (N, 3)
        As printed [m], in any fixed frame and for any fixed tool of the controller; both are fitted first.
    printed_step_m : float
        Rounding step of the printed position [m].

    Returns
    -------
    Unrounded
        ``useful`` is False, and the joints are as given, if the printed positions do not follow the joints to
        within their rounding (another model, a commanded goal) or are too coarse to help.
    """
    sigma_q = np.maximum(joint_step_rad * _UNIFORM, 1e-9)
    frames = _controller_frames(model, joints_rad, printed_m, sigma_q, printed_step_m)
    disagreement = errors_m(frames.state, _printed_problem(frames, joints_rad, printed_m))
    chain = frames.state.seen_from(0)
    expected = _expected_m(model, joints_rad, sigma_q, printed_step_m)
    usual = np.maximum(expected, float(np.median(disagreement)))
    doubtful = tuple(int(row) for row in np.flatnonzero(disagreement > _DISAGREES * usual))
    sigma_p = max(printed_step_m, 1e-6) * _UNIFORM
    sharp_enough = sigma_p * np.sqrt(3) < 0.7 * float(np.median(expected))
    follows = float(np.median(disagreement)) < 2.0 * float(np.median(expected))
    if not (follows and sharp_enough):
        return UnroundedJoints(joints_rad, disagreement, doubtful, useful=False)
    sharp = _sharpen_joints(chain, joints_rad, printed_m, sigma_q, sigma_p)
    half = joint_step_rad / 2
    sharp = np.clip(sharp, joints_rad - half, joints_rad + half)
    sharp[list(doubtful)] = joints_rad[list(doubtful)]
    return UnroundedJoints(sharp, disagreement, doubtful, useful=True)


def follow_nominal_arm(
    model: RobotModel, joints_rad: Array, joint_step_rad: Array, places_m: Array, place_step_m: float
) -> bool:
    """Return whether places (N, 3) are what the nominal arm calculates from the joints, to within all rounding."""
    sigma_q = np.maximum(joint_step_rad * _UNIFORM, 1e-9)
    frames = _controller_frames(model, joints_rad, places_m, sigma_q, place_step_m)
    disagreement = errors_m(frames.state, _printed_problem(frames, joints_rad, places_m))
    return float(np.median(disagreement)) < 2.0 * float(
        np.median(_expected_m(model, joints_rad, sigma_q, place_step_m))
    )


def _sharpen_joints(
    chain: RobotModel, joints_rad: Array, printed_m: Array, sigma_q: Array, sigma_p: float
) -> Array:
    joints = joints_rad
    for _ in range(_STEPS):
        position, jacobian = chain.tip_jacobian(joints, np.zeros(3))
        scaled = jacobian * sigma_q
        # The prior keeps dq small, so work in the three coordinates rather than the n joints.
        gain = scaled @ np.swapaxes(scaled, 1, 2) + sigma_p**2 * np.eye(3)
        target = (printed_m - position)[:, :, None] + jacobian @ (joints - joints_rad)[:, :, None]
        change = np.swapaxes(scaled, 1, 2) @ np.linalg.solve(gain, target)
        joints = joints_rad + sigma_q * change[:, :, 0]
    return joints


def _expected_m(model: RobotModel, joints_rad: Array, sigma_q: Array, printed_step_m: float) -> Array:
    """Return how far rounding alone should put printed positions from those of printed joints (N,) [m]."""
    _, jacobian = model.tip_jacobian(joints_rad, np.zeros(3))
    square = ((jacobian * sigma_q) ** 2).sum(axis=(1, 2)) + (printed_step_m**2) / 4
    expected: Array = np.sqrt(square + 1e-12)
    return expected


def _controller_frames(
    model: RobotModel, joints_rad: Array, printed_m: Array, sigma_q: Array, printed_step_m: float
) -> ArmFit:
    """Fit the user frame and tool that the controller printed with, robustly: typing errors do occur."""
    sigma = _expected_m(model, joints_rad, sigma_q, printed_step_m)
    observations = PointObservations(joints_rad, printed_m, sigma, np.zeros(len(joints_rad), dtype=np.intp))
    start = first_guess(model, observations)[0]
    layout = make_layout(model, "point", 1, level=FRAMES)
    problem = FitProblem.from_observations(start, observations)
    fit = estimate_arm(layout, start, problem)
    for _ in range(8):
        ratio = errors_m(fit.state, problem) / sigma
        fit = estimate_arm(layout, fit.state, problem, 1.0 / (1.0 + (ratio / 3.0) ** 2))
    return fit


def _printed_problem(fit: ArmFit, joints_rad: Array, printed_m: Array) -> FitProblem:
    count = len(joints_rad)
    return FitProblem.from_observations(
        fit.state,
        PointObservations(joints_rad, printed_m, np.ones(count), np.zeros(count, dtype=np.intp)),
    )
