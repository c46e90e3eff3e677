"""What stands in the demo's cell for procedures to measure, and where its technician brings the arm for each touch.

A fixture and an end-effector for the wire, a pin, a workpiece with a user frame, and the same workpiece moved.
"""

import re
from collections.abc import Callable, Mapping, Sequence

import numpy as np

from cellcal.calibration.geometry import Array, exp_rotation, homogeneous_matrix

TIP_IN_FLANGE_M = (0.012, -0.034, 0.215)  # of the tool that touches
DOWN = np.diag([1.0, -1.0, -1.0])  # an attitude of the flange in the base
PIN_IN_BASE_M = np.array([0.85, 0.05, -0.1])
_STEP_M = 0.31  # along the tool's axes
# How the tool is tilted at the pin, about axes of the flange [rad]: the textbook's two turns, then further attitudes.
_ABOUT_X, _ABOUT_Y = (0.9, 0.0, 0.0), (0.0, 0.8, 0.0)
_TILTS = (
    (0.0, 0.7, 0.0),
    (-0.7, 0.0, 0.0),
    (0.57, 0.57, 0.0),
    (0.57, -0.57, 0.0),
    (0.0, 0.0, 1.0),
    (0.5, 0.0, 0.0),
)
_NUMBER = re.compile(r"_(\d+)")


def _rotation_of(vector_rad: Sequence[float]) -> Array:
    return exp_rotation(np.array(vector_rad))


BASE_FRAME = homogeneous_matrix(
    _rotation_of((0.0, 0.0, 0.3)) @ _rotation_of((0.0, 0.05, 0.0)), np.array([0.75, -0.2, -0.2])
)
_MOVED = homogeneous_matrix(_rotation_of((0.0, 0.0, 0.02)), np.array([0.03, -0.02, 0.004]))
_IN_FRAME_M: Mapping[str, tuple[float, float, float]] = {
    "touch_origin": (0.0, 0.0, 0.0),
    "touch_on_x": (0.4, 0.0, 0.0),
    "touch_on_xy": (0.1, 0.3, 0.0),
    "touch_origin_again": (0.0, 0.0, 0.0),
    "touch_more_on_x": (0.35, 0.0, 0.0),
    "touch_more_on_xy": (0.05, 0.32, 0.0),
    "touch_above": (0.1, 0.1, 0.05),
}
_OF_WORKPIECE_M = ((0.0, 0.0, 0.0), (0.4, 0.0, 0.0), (0.0, 0.35, 0.0), (0.25, 0.2, 0.1))
_ABOVE_WORKPIECE_M = (0.1, 0.1, 0.2)

_FIXTURE_POINTS_M = (
    *((-0.35, -0.45, 0.0), (0.35, -0.45, 0.0), (-0.35, 0.45, 0.0)),
    *((0.35, 0.45, 0.25), (0.0, -0.45, 0.3), (0.0, 0.45, 0.3)),
)
_HOLES_M = ((0.0, 0.0, 0.0), (0.16, 0.0, -0.05), (0.0, 0.16, -0.05))


def _format_points(points_m: Sequence[Sequence[float]], unit: float = 1.0) -> str:
    return str([[round(value * unit, 6) for value in point] for point in points_m])


# Of the robot that has the wire: what a run asks for there is filled in already.
USUAL = f"""
[robot.usual.six_point_tcp]              # an arm by its drawing: its own errors stand in every touch
tool_number = 3
rms_limit_m = 0.003
limits = {{ tip_m = 0.0015, residual_m = 0.003, orientation_rad = 0.01 }}

[robot.usual.three_point_frame]
frame_number = 2
tip_in_flange_m = {list(TIP_IN_FLANGE_M)}
more_in_plane = 1                        # a point more than the frame needs shows a wrong one
check_above = true
limits = {{ origin_m = 0.002, angle_rad = 0.009 }}

[robot.usual.frame_offset]
frame_number = 2
tip_in_flange_m = {list(TIP_IN_FLANGE_M)}
points_in_frame_m = {_format_points(_OF_WORKPIECE_M)}

[robot.usual.end_effector_points]
tool_number = 4
points_in_tool_m = {_format_points(_HOLES_M)}
rough_flange_tool = {{ position_m = [0.0, 0.0, 0.2] }}

[robot.usual.fixture_alignment]
fixture = "table"
points_in_fixture_m = {_format_points(_FIXTURE_POINTS_M)}
rough_base_fixture = {{ position_m = [0.85, 0.0, -0.2] }}
"""

FIXTURES_TOML = f"""
[fake.fixture]
points_mm = {_format_points(_FIXTURE_POINTS_M, 1e3)}
seen_from = {{ fanuc = [850.0, 0.0, -200.0, 0.0, 0.0, 0.0] }}

[fake.end_effector]
targets_mm = {_format_points(_HOLES_M, 1e3)}
flange_tool = [0.0, 0.0, 200.0, 0.0, 0.0, 0.0]
"""


def place_for(procedure: str, key: str) -> Array | None:
    """Return where the flange (4, 4) is to be in the base for what an instruction asks; None: not for these hands."""
    find = _PLACES.get(procedure)
    return None if find is None else find(key)


def _at_the_pin(key: str) -> Array | None:
    if key.startswith("along_") and (axis := "xyz".find(key[-1])) >= 0:
        # Straight along the tool's own axis, seen from the tip; an axis that points down ends below the pin.
        return _flange_at(PIN_IN_BASE_M + DOWN[:, axis] * _STEP_M, DOWN)
    tilts = {"touch": (0.0, 0.0, 0.0), "touch_about_x": _ABOUT_X, "touch_about_y": _ABOUT_Y}
    if key in tilts:
        return _flange_at(PIN_IN_BASE_M, DOWN @ _rotation_of(tilts[key]))
    if not key.startswith("touch_") or not (found := _NUMBER.search(key)):
        return None
    first = (tilts["touch"], _ABOUT_X, _ABOUT_Y)
    number = int(found[1]) - 1
    tilt = first[number] if number < len(first) else _TILTS[(number - len(first)) % len(_TILTS)]
    return _flange_at(PIN_IN_BASE_M, DOWN @ _rotation_of(tilt))


def _on_the_frame(key: str) -> Array | None:
    point = _IN_FRAME_M.get(key)
    return None if point is None else _flange_at(_to_base(BASE_FRAME, point), DOWN)


def _on_the_moved_workpiece(key: str) -> Array | None:
    moved = BASE_FRAME @ _MOVED
    if key == "touch_above":
        return _flange_at(_to_base(moved, _ABOVE_WORKPIECE_M), DOWN)
    found = _NUMBER.search(key) if key.startswith("touch_point_") else None
    if found is None or not 1 <= int(found[1]) <= len(_OF_WORKPIECE_M):
        return None
    return _flange_at(_to_base(moved, _OF_WORKPIECE_M[int(found[1]) - 1]), DOWN)


def _to_base(base_frame: Array, point_m: Sequence[float]) -> Array:
    return np.asarray(base_frame[:3, :3] @ np.array(point_m) + base_frame[:3, 3])


def _flange_at(tip_in_base_m: Array, attitude: Array) -> Array:
    return homogeneous_matrix(attitude, tip_in_base_m - attitude @ np.array(TIP_IN_FLANGE_M))


_PLACES: Mapping[str, Callable[[str], Array | None]] = {
    "six_point_tcp": _at_the_pin,
    "three_point_frame": _on_the_frame,
    "frame_offset": _on_the_moved_workpiece,
}
