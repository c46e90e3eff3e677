"""A tool's tip from touches on one pin, and its axes from straight moves: the six-point method."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import scipy  # loads a part of it when that is first used

from cellcal.calibration.errors import CalibrationError, DegenerateDataError
from cellcal.calibration.geometry import (
    Array,
    Pose,
    homogeneous_matrix,
    log_rotation,
    nearest_rotation,
    quaternion_from_rotation,
    rotation_from_quaternion,
)
from cellcal.calibration.message import make_message
from cellcal.calibration.metres import MOST_OF_TOOL_M, refuse_not_metres
from cellcal.calibration.points.deleted_residuals import deleted_residuals
from cellcal.calibration.uncertainty import coverage_in_space, effective_degrees_of_freedom

Triple = tuple[float, float, float]
MIN_OPENING_RAD = math.radians(15.0)  # between the moves of the two-point method


@dataclass(frozen=True, slots=True)
class ToolPoint:
    """The place of the tip, and how far the touches agree about it."""

    tip_in_flange_m: Triple
    pin_in_base_m: Triple
    rms_m: float  # per coordinate, over all touches
    max_m: float  # the largest distance between a touch's tip and the pin
    worst_touch: int  # counted from 0
    residuals_m: tuple[Triple, ...]  # tip of each touch minus pin, base axes
    condition: float
    degrees_of_freedom: int
    tip_covariance_m2: tuple[Triple, Triple, Triple]
    tip_u_m: Triple  # expanded, 95 %, per flange axis
    tip_u_in_space_m: float  # expanded, 95 %: the tip is within this distance, whatever the direction
    coverage_in_space: float  # of it, over the root of the trace of the covariance
    leave_one_out_max_m: float | None  # None where a touch cannot be spared
    leave_one_out_m: tuple[float, ...]  # of each touch; empty where one cannot be spared
    stray_touch: int  # the touch that the others contradict most, counted from 0 …
    stray_probability: float  # … and how probable a worse one is among touches that are all alike


@dataclass(frozen=True, slots=True)
class AxesLimits:
    """The limits within which `tool_axes` accepts."""

    min_move_m: float = 0.1  # shortest move
    turn_rad: float = math.radians(0.1)  # largest turn of the flange between poses
    squareness_rad: float = math.radians(2.0)  # largest departure of the moves from right angles


@dataclass(frozen=True, slots=True)
class ToolAxes:
    """The tool's axes seen from the flange, and how square the taught moves were."""

    quaternion: tuple[float, float, float, float]  # flange_tool: w, x, y, z
    turn_gain_per_m2: tuple[
        Triple, Triple, Triple
    ]  # covariance of the axes' turn, for poses good to one metre
    squareness_rad: float  # largest departure of two taught moves from a right angle
    turn_rad: float  # largest turn of the flange between the taught poses
    shortest_move_m: float


def locate_tool_point(
    touches: Sequence[Pose],
    *,
    condition_limit: float = 50.0,
    sigma_m: float | None = None,
    arm_sigma_m: float = 0.0,
) -> ToolPoint:
    r"""Find the tool tip from flange poses that all put it on one fixed pin.

    Every touch i obeys ``R_i t + p_i = q`` with the same tip t (flange frame) and pin q (base frame);
    stacking the touches gives a linear least-squares problem in (t, q), 3n equations for 6 unknowns.

    Parameters
    ----------
    touches : sequence of Pose, n >= 3
        base_flange at each touch [m]. Attitudes should differ by 30 degrees or more about two axes.
    condition_limit : float
        Largest accepted ratio of singular values [1].
    sigma_m : float, optional
        Standard uncertainty of one coordinate of one touch [m]. Without it, the residuals tell.
    arm_sigma_m : float
        By how much the arm's own errors shift a coordinate of the tip [m], k = 1. They go with the attitude, so
        that touches agree about a tip that is none: residuals do not show it and more touches do not average it.

    Returns
    -------
    ToolPoint
        Tip in the flange frame [m], pin in the base frame [m], residuals, condition [1], uncertainty.

    Raises
    ------
    DegenerateDataError
        Fewer than three touches, or attitudes too alike.

    Notes
    -----
    ``leave_one_out_max_m`` is the worst distance between a touch's tip and the pin when both come from the
    other touches: it shows a bad touch that the fit has bent itself to. With n = 3 there is no touch to
    spare and three redundant equations are left, so the coverage factor is large (Student, 3.18).

    References
    ----------
    Linear form: derived in calibration/README.md, section 4. Deleted residuals: R. D. Cook, S. Weisberg,
    Residuals and Influence in Regression, 1982, section 2.2.
    """
    n = len(touches)
    if n < 3:
        raise DegenerateDataError(
            make_message("{n} touches cannot locate a tip.", n=n), remedy="Teach three or more touches."
        )
    refuse_not_metres([touch.position_m for touch in touches], "poses of the flange")
    design = np.zeros((n, 3, 6))
    design[:, :, :3] = [touch.rotation_matrix() for touch in touches]
    design[:, :, 3:] = -np.eye(3)
    positions = np.array([touch.position_m for touch in touches])
    # Positions relative to their mean keep the digits when the cell is far from the base.
    centre = positions.mean(axis=0)
    matrix = design.reshape(3 * n, 6)
    u, singular, vt = np.linalg.svd(matrix, full_matrices=False)
    condition = float(singular[0] / max(singular[-1], 1e-300))
    if not condition <= condition_limit:
        raise DegenerateDataError(
            make_message(
                "the touches' attitudes are too alike (condition {condition:.3g}, limit "
                "{condition_limit:g}).",
                condition=condition,
                condition_limit=condition_limit,
            ),
            remedy="Turn the tool by 30 degrees or more about two different axes between touches.",
            condition=condition,
        )
    solution = vt.T @ ((u.T @ (centre - positions).ravel()) / singular)
    refuse_not_metres(solution[:3], "tip of the tool", MOST_OF_TOOL_M)
    residuals = (matrix @ solution - (centre - positions).ravel()).reshape(n, 3)
    freedom = 3 * n - 6
    variance = float((residuals**2).sum()) / freedom if sigma_m is None else sigma_m**2
    gain = (vt.T[:3] / singular**2) @ vt[:, :3]
    covariance = gain * variance + arm_sigma_m**2 * np.eye(3)
    effective_freedom = freedom if sigma_m is None else math.inf
    parts = [
        (math.sqrt(float(np.trace(gain)) * variance), effective_freedom),
        (math.sqrt(3.0) * arm_sigma_m, math.inf),
    ]
    effective_freedom = effective_degrees_of_freedom(parts) if arm_sigma_m else effective_freedom
    spread = covariance if arm_sigma_m else gain  # of touches that agree wholly, too
    in_space = coverage_in_space(np.linalg.eigvalsh(spread).clip(0.0).tolist(), effective_freedom)
    factor = (
        float(scipy.special.stdtrit(effective_freedom, 0.975)) if math.isfinite(effective_freedom) else 1.96
    )
    distances = np.linalg.norm(residuals, axis=1)
    deleted = deleted_residuals(u.reshape(n, 3, 6), residuals)
    return ToolPoint(
        tip_in_flange_m=_to_triple(solution[:3]),
        pin_in_base_m=_to_triple(solution[3:] + centre),
        rms_m=float(np.sqrt((residuals**2).mean())),
        max_m=float(distances.max()),
        worst_touch=int(distances.argmax()),
        residuals_m=tuple(_to_triple(r) for r in residuals),
        condition=condition,
        degrees_of_freedom=freedom,
        tip_covariance_m2=(_to_triple(covariance[0]), _to_triple(covariance[1]), _to_triple(covariance[2])),
        tip_u_m=_to_triple(factor * np.sqrt(np.diag(covariance))),
        tip_u_in_space_m=in_space * math.sqrt(float(np.trace(covariance))),
        coverage_in_space=in_space,
        leave_one_out_max_m=max(deleted.sizes_m, default=None),
        leave_one_out_m=deleted.sizes_m,
        stray_touch=deleted.stray,
        stray_probability=deleted.probability,
    )


def tool_axes(
    square: Pose,
    *,
    along_x: Pose | None = None,
    along_y: Pose | None = None,
    along_z: Pose | None = None,
    limits: AxesLimits = AxesLimits(),
) -> ToolAxes:
    """Find the tool's axes from straight moves along them, two or all three, with the tool held square.

    The technician squares the tool to the base, then moves it along +x, +y, +z of the tool; the flange must
    not turn. The direction of each move, seen from the flange, is an axis of the tool. The axes returned are
    the right-handed frame nearest to the directions taught.

    Parameters
    ----------
    square : Pose
        base_flange with the tool square to the base, at the start of every move [m].
    along_x, along_y, along_z : Pose
        base_flange after the move along that axis of the tool [m]; at least two of them.
    limits : AxesLimits
        What is refused. The textbook asks for moves of a foot: an axis is off by pose error / move.

    Raises
    ------
    DegenerateDataError
        Fewer than two moves, or a move too short.
    CalibrationError
        The tool turned during a move, or the moves are not square or not right-handed.

    References
    ----------
    F. S. Cheng, Calibration of Robot Reference Frames for Enhanced Robot Positioning Accuracy, 2008, 3.2.
    """
    taught = {
        axis: pose for axis, pose in (("x", along_x), ("y", along_y), ("z", along_z)) if pose is not None
    }
    if len(taught) < 2:
        raise DegenerateDataError(
            "tool axes need two moves.", remedy="Teach moves along two axes of the tool."
        )
    moves = {axis: _straight_move(square, pose, axis, limits) for axis, pose in taught.items()}
    units = {axis: move / np.linalg.norm(move) for axis, move in moves.items()}
    squareness = max(
        abs(math.asin(_clip_unit(float(units[a] @ units[b])))) for a in units for b in units if a < b
    )
    if squareness > limits.squareness_rad:
        raise CalibrationError(
            make_message(
                "the moves are {squareness:.2f} degrees away from right angles.",
                squareness=math.degrees(squareness),
            ),
            remedy="Teach the moves again along the tool's own axes.",
        )
    return ToolAxes(
        quaternion=_to_quaternion(_nearest_frame(units)),
        turn_gain_per_m2=_turn_gain(units, moves),
        squareness_rad=squareness,
        turn_rad=max(_turn_angle(square, pose) for pose in taught.values()),
        shortest_move_m=min(float(np.linalg.norm(move)) for move in moves.values()),
    )


def axes_from_plane(
    origin: Pose, along: Pose, beside: Pose, *, above: Pose | None = None, limits: AxesLimits = AxesLimits()
) -> ToolAxes:
    """Find the tool's axes from a straight move along its +x and one to the +y side of its x-y plane.

    The makers' two-point method: x is kept as taught, the second move only tells where the plane is.

    Parameters
    ----------
    origin : Pose
        base_flange at the start of both moves [m].
    along, beside : Pose
        base_flange after the move along +x, and after the move towards +y, at any slant to x [m].
    above : Pose, optional
        base_flange after a move towards +z: catches a move in the wrong direction.
    limits : AxesLimits
        Shortest move and largest turn of the flange; right angles are not asked for.

    Raises
    ------
    DegenerateDataError
        A move too short, or the two nearly on one line.
    CalibrationError
        The tool turned during a move, or the check point is on the side of -z.
    """
    x, side = _straight_move(origin, along, "x", limits), _straight_move(origin, beside, "x-y", limits)
    opening = math.atan2(float(np.linalg.norm(np.cross(x, side))), float(x @ side))
    if not MIN_OPENING_RAD < opening < math.pi - MIN_OPENING_RAD:
        raise DegenerateDataError(
            make_message(
                "the two moves open only {opening:.1f} degrees.",
                opening=math.degrees(min(opening, math.pi - opening)),
            ),
            remedy=make_message(
                "Move to the +y side, {min_opening_rad:.0f} degrees or more off the x axis.",
                min_opening_rad=math.degrees(MIN_OPENING_RAD),
            ),
        )
    z = np.cross(x, side)
    if above is not None and not _straight_move(origin, above, "z", limits) @ z > 0:
        raise CalibrationError(
            "the move towards +z ended on the side of -z: the taught frame is left-handed.",
            remedy="One move went along the negative axis; teach it again.",
        )
    units = {"x": x / np.linalg.norm(x), "z": z / np.linalg.norm(z)}
    heights = {"x": x, "z": units["z"] * float(np.linalg.norm(side)) * math.sin(opening)}
    taught = [along, beside, *(() if above is None else (above,))]
    return ToolAxes(
        quaternion=_to_quaternion(_nearest_frame(units)),
        turn_gain_per_m2=_turn_gain(units, heights),
        squareness_rad=0.0,
        turn_rad=max(_turn_angle(origin, pose) for pose in taught),
        shortest_move_m=min(float(np.linalg.norm(move)) for move in (x, side)),
    )


def axes_from_attitude(base_flange: Pose, base_tool: Pose) -> ToolAxes:
    """Return the tool's axes from one pose in which the tool is held in a known attitude to the base.

    How well it was held is for the technician to say: nothing here shows it.
    """
    rotation = base_flange.rotation_matrix().T @ base_tool.rotation_matrix()
    zero = (0.0, 0.0, 0.0)
    return ToolAxes(_to_quaternion(rotation), (zero, zero, zero), 0.0, 0.0, 0.0)


def tool_pose(tip_in_flange_m: Triple, axes: ToolAxes | None = None) -> Pose:
    """Return flange_tool: the tip with the given axes, or with the flange's own."""
    refuse_not_metres(tip_in_flange_m, "tip of the tool", MOST_OF_TOOL_M)
    rotation = np.eye(3) if axes is None else rotation_from_quaternion(np.array(axes.quaternion))
    return Pose.from_matrix(homogeneous_matrix(rotation, np.array(tip_in_flange_m)))


def _straight_move(square: Pose, pose: Pose, axis: str, limits: AxesLimits) -> Array:
    move: Array = square.rotation_matrix().T @ (np.array(pose.position_m) - np.array(square.position_m))
    length = float(np.linalg.norm(move))
    if length < limits.min_move_m:
        raise DegenerateDataError(
            make_message(
                "the move along {axis} is only {length:.1f} mm long.", axis=axis, length=length * 1000.0
            ),
            remedy=make_message(
                "Move at least {min_move_mm:.0f} mm; a foot is better.",
                min_move_mm=limits.min_move_m * 1000.0,
            ),
        )
    turn = _turn_angle(square, pose)
    if turn > limits.turn_rad:
        raise CalibrationError(
            make_message(
                "the tool turned by {turn:.2f} degrees during the move along {axis}.",
                turn=math.degrees(turn),
                axis=axis,
            ),
            remedy="Jog in a straight line without changing the attitude, and teach the move again.",
        )
    return move


def _turn_angle(a: Pose, b: Pose) -> float:
    return float(np.linalg.norm(log_rotation(a.rotation_matrix().T @ b.rotation_matrix())))


def _nearest_frame(units: dict[str, Array]) -> Array:
    columns = {"xyz".index(axis): unit for axis, unit in units.items()}
    matrix = np.zeros((3, 3))
    for i, unit in columns.items():
        matrix[:, i] = unit
    for i in {0, 1, 2} - columns.keys():
        normal = np.cross(matrix[:, (i + 1) % 3], matrix[:, (i + 2) % 3])
        matrix[:, i] = normal / np.linalg.norm(normal)
    if np.linalg.det(matrix) < 0:
        raise CalibrationError(
            "the three moves form a left-handed frame.",
            remedy="One move went along the negative axis; teach it again.",
        )
    return nearest_rotation(matrix)


def _turn_gain(units: dict[str, Array], moves: dict[str, Array]) -> tuple[Triple, Triple, Triple]:
    """Return the covariance of the axes' turn, flange axes, for poses whose coordinates are good to one metre.

    A direction tells a turn about what is square to it; both ends of a move have the pose's error.
    """
    information = sum(
        (
            (np.eye(3) - np.outer(unit, unit)) * float(moves[axis] @ moves[axis]) / 2.0
            for axis, unit in units.items()
        ),
        np.zeros((3, 3)),
    )
    gain = np.linalg.inv(information)
    return (_to_triple(gain[0]), _to_triple(gain[1]), _to_triple(gain[2]))


def _to_quaternion(rotation: Array) -> tuple[float, float, float, float]:
    w, x, y, z = (float(v) for v in quaternion_from_rotation(rotation))
    return (w, x, y, z)


def _to_triple(values: Array) -> Triple:
    x, y, z = (float(v) for v in values)
    return (x, y, z)


def _clip_unit(value: float) -> float:
    return max(-1.0, min(1.0, value))
