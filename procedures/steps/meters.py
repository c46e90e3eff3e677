"""What a point would tell if it were recorded where the arm stands: read while a person brings the arm there.

A meter is data on a page of kind "teach": what is recorded so far, and by which rules the procedure will judge. The
same mathematics judges here and there, so that what is shown before is what is said afterwards. Only geometry can
refuse: a point is never refused because it disagrees with the others, since that would hide what it has to say.
"""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from pydantic import TypeAdapter

from cellcal.calibration.errors import CalibrationError, DegenerateDataError
from cellcal.calibration.geometry import Pose, log_rotation
from cellcal.calibration.message import make_message
from cellcal.calibration.points.frames import MIN_DISTANCE_M, frame_from_more_points, frame_from_three_points
from cellcal.calibration.points.tool_point import AxesLimits
from cellcal.calibration.points.touch_design import alike_touch, predicted_u_m

_POSE: TypeAdapter[Pose] = TypeAdapter(Pose)
SHORT_BASE_M = 0.15  # the axes turn by point error over distance: below this a person is warned
WELL_OPEN_RAD = math.radians(30.0)
WRONG_POINT_M = 0.005  # no arm, tip or drawing is off by so much: another point is touched than is asked for

Triple = tuple[float, float, float]


@dataclass(frozen=True, slots=True)
class MeterFigure:
    """One figure. ``least`` and ``most`` are the limits it is held to, where there are any. SI units."""

    name: str  # a key for translations
    value: float
    unit: str
    least: float | None = None
    most: float | None = None


@dataclass(frozen=True, slots=True)
class MeterReading:
    """The meter's reading: ``refusal`` is the key of why nothing may be recorded here, empty where it may."""

    refusal: str = ""
    words: str = ""
    warning: str = ""
    figures: tuple[MeterFigure, ...] = ()


def read_meter(meter: Mapping[str, Any], base_flange: Pose) -> MeterReading:
    """Say what a point recorded at this flange pose would tell."""
    return _METERS[str(meter["of"])](meter, base_flange)


# the tip of a tool, from touches of one pin


def tip_meter(
    touches: Sequence[Pose],
    *,
    sigma_m: float,
    turns_rad: tuple[float, float],
    worst_gain: float,
    limit_m: float,
    arm_sigma_m: float,
) -> dict[str, Any]:
    """Return the meter of a touch; ``turns_rad``: least turn from every other one, for the first three and later."""
    return {
        "of": "tip",
        "touches": list(touches),
        "sigma_m": sigma_m,
        "arm_sigma_m": arm_sigma_m,
        "turns_rad": list(turns_rad),
        "worst_gain": worst_gain,
        "limit_m": limit_m,
    }


def _read_tip(meter: Mapping[str, Any], base_flange: Pose) -> MeterReading:
    touches = [*_parse_poses(meter["touches"]), base_flange]
    first, later = meter["turns_rad"]
    least = first if len(touches) <= 3 else later
    attitudes = [touch.rotation_matrix() for touch in touches]
    figures = []
    if len(touches) > 1:
        spread = min(_angle_between(attitudes[-1], one) for one in attitudes[:-1])
        figures.append(MeterFigure("spread", spread, "rad", least=least))
    foreseen = predicted_u_m(attitudes, meter["sigma_m"], arm_sigma_m=meter["arm_sigma_m"])
    if foreseen is not None:
        figures.append(MeterFigure("tip_u", foreseen, "m", most=meter["limit_m"]))
    alike = alike_touch(touches, min_turn_rad=least, worst_gain=meter["worst_gain"])
    if alike is None:
        return MeterReading(figures=tuple(figures))
    key = "tcp.one_axis" if alike.like is None else "tcp.spread_low"
    if len(touches) > 3:  # the step says itself which turn tells most
        return MeterReading(key, figures=tuple(figures))
    words = make_message("Turn the tool {turn} of the flange, or further.", turn=alike.turn.describe_turn())
    return MeterReading(key, words, figures=tuple(figures))


# straight moves along the axes of a tool


def move_meter(start: Pose, least_m: float) -> dict[str, Any]:
    """Return the meter of a straight move from ``start`` without turning."""
    return {"of": "move", "start": start, "least_m": least_m, "most_turn_rad": AxesLimits().turn_rad}


def _read_move(meter: Mapping[str, Any], base_flange: Pose) -> MeterReading:
    start, least, most = _POSE.validate_python(meter["start"]), meter["least_m"], meter["most_turn_rad"]
    moved = math.dist(start.position_m, base_flange.position_m)
    turned = _angle_between(start.rotation_matrix(), base_flange.rotation_matrix())
    figures = (MeterFigure("moved", moved, "m", least=least), MeterFigure("turned", turned, "rad", most=most))
    if turned > most:
        words = make_message(
            "The tool has turned by {turned:.2f} degrees: bring it back to how it was held.",
            turned=math.degrees(turned),
        )
        return MeterReading("tool.turned", words, figures=figures)
    if moved < least:
        return MeterReading(
            "tool.move_short",
            make_message("Move on by {least:.0f} mm or more.", least=(least - moved) * 1000.0),
            figures=figures,
        )
    return MeterReading(figures=figures)


# a user frame from touched points


def frame_meter(
    role: str,
    points_m: Mapping[str, Sequence[Triple]],
    *,
    tip_in_flange_m: Triple,
    sigma_m: float,
    limits: tuple[float, float],
) -> dict[str, Any]:
    """Return the meter of a point of a frame.

    Parameters
    ----------
    role : str
        ``origin``, ``on_x``, ``in_plane`` or ``above``: what the point is that is asked for.
    points_m : points in the base by their role, as recorded so far [m].
    limits : expanded uncertainty of the origin [m] and of the axes [rad] that is asked for.
    """
    return {
        "of": "frame",
        "role": role,
        "points_m": {key: [list(point) for point in points] for key, points in points_m.items()},
        "tip_in_flange_m": list(tip_in_flange_m),
        "sigma_m": sigma_m,
        "limits": list(limits),
    }


def _read_frame(meter: Mapping[str, Any], base_flange: Pose) -> MeterReading:
    tip = _tip_in_base(base_flange, meter["tip_in_flange_m"])
    role = meter["role"]
    points = {key: list(found) for key, found in meter["points_m"].items()}
    origin = points.get("origin", [])
    if not origin:
        return MeterReading()
    points.setdefault(role, []).append(tip)
    if role == "origin":  # once more
        return _read_whole_frame(meter, points, (), "")
    base = math.dist(origin[0], tip)
    distance = MeterFigure("from_origin", base, "m", least=MIN_DISTANCE_M)
    if base < MIN_DISTANCE_M:
        return MeterReading("frame.points_close", "Go further from the origin.", figures=(distance,))
    short = "frame.short_base" if role == "on_x" and base < SHORT_BASE_M else ""
    if not points.get("on_x") or not points.get("in_plane"):
        return MeterReading(warning=short, figures=(distance,))
    return _read_whole_frame(meter, points, (distance,), short)


def _read_whole_frame(
    meter: Mapping[str, Any],
    points: Mapping[str, Sequence[Any]],
    distance: tuple[MeterFigure, ...],
    short: str,
) -> MeterReading:
    origins, on_x, in_plane = points["origin"], points["on_x"], points["in_plane"]
    first, sigma = (origins[0], on_x[0], in_plane[0]), meter["sigma_m"]
    try:
        taught = frame_from_three_points(*first, sigma_m=sigma)
    except DegenerateDataError as error:
        return MeterReading("frame.collinear", error.remedy, figures=distance)
    if len(origins) + len(on_x) + len(in_plane) > 3:
        try:
            taught = frame_from_more_points(origins, on_x, in_plane, sigma_m=sigma)
        except CalibrationError as error:  # what the points say of each other is judged afterwards
            return MeterReading(warning="frame.points_disagree", words=error.message, figures=distance)
    opening = min(taught.opening_rad, math.pi - taught.opening_rad)
    origin_limit, turn_limit = meter["limits"]
    figures = [
        MeterFigure("opening", opening, "rad"),
        MeterFigure("base_length", taught.x_length_m, "m"),
        MeterFigure("origin_u", 2.0 * max(taught.origin_sigma_m), "m", most=origin_limit),
        MeterFigure("axes_u", 2.0 * max(taught.rotation_sigma_rad), "rad", most=turn_limit),
    ]
    if points.get("above"):
        base_frame = taught.base_frame
        up = (np.array(points["above"][-1]) - np.array(base_frame.position_m)) @ base_frame.rotation_matrix()[
            :, 2
        ]
        figures.append(MeterFigure("height", float(up), "m", least=0.0))
        if not up > 0:
            words = "The points were touched in another order than they were asked for."
            return MeterReading("frame.left_handed", words, figures=tuple(figures))
    narrow = "frame.opening_low" if opening < WELL_OPEN_RAD else ""
    base = "frame.short_base" if taught.x_length_m < SHORT_BASE_M else ""
    return MeterReading(warning=narrow or base or short, figures=tuple(figures))


# points that are known already and are touched again


def known_points_meter(
    number: int, known_m: Sequence[Triple], touched_m: Sequence[Triple], tip_in_flange_m: Triple
) -> dict[str, Any]:
    """Return the meter of a known point: how its distances to those touched fit, in whatever frame."""
    return {
        "of": "known_point",
        "known_m": [list(point) for point in known_m[: number + 1]],
        "touched_m": [list(point) for point in touched_m],
        "tip_in_flange_m": list(tip_in_flange_m),
    }


def _read_known_point(meter: Mapping[str, Any], base_flange: Pose) -> MeterReading:
    tip, known_m = _tip_in_base(base_flange, meter["tip_in_flange_m"]), meter["known_m"]
    touched = meter["touched_m"]
    gaps = [
        abs(math.dist(tip, place) - math.dist(known_m[-1], other))
        for place, other in zip(touched, known_m[:-1], strict=True)
    ]
    if not gaps:
        return MeterReading()
    figures = (MeterFigure("gap", max(gaps), "m"),)
    return MeterReading(warning="frame.points_disagree" if max(gaps) > WRONG_POINT_M else "", figures=figures)


def tip_in_base(base_flange: Pose, tip_in_flange_m: Sequence[float]) -> Triple:
    """Return where the tip of a pointer is [m]."""
    x, y, z = _tip_in_base(base_flange, tip_in_flange_m)
    return x, y, z


def _tip_in_base(base_flange: Pose, tip_in_flange_m: Sequence[float]) -> list[float]:
    place = base_flange.rotation_matrix() @ np.array(tip_in_flange_m) + np.array(base_flange.position_m)
    return [float(value) for value in place]


def _parse_poses(values: Sequence[Any]) -> list[Pose]:
    return [_POSE.validate_python(pose) for pose in values]


def _angle_between(first: Any, second: Any) -> float:
    return float(np.linalg.norm(log_rotation(first.T @ second)))


_METERS: dict[str, Callable[[Mapping[str, Any], Pose], MeterReading]] = {
    "tip": _read_tip,
    "move": _read_move,
    "frame": _read_frame,
    "known_point": _read_known_point,
}
