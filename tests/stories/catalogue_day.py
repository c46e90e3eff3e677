"""The stories of a day, in an order in which each finds what it needs: one for every procedure of the catalogue."""

import base64
from collections.abc import Mapping
from typing import Any

import numpy as np

from cellcal.calibration.geometry import Array, homogeneous_matrix, quaternion_from_rotation
from cellcal.calibration.points.tag_points import TagPath
from tests.stories.browser_technician import ProcedureStory
from tests.stories.day_cell import CORNER, OVER_THE_CORNER_RAD, POINTS_M, TARGETS_M
from tests.stories.technician_actions import MISSED_M, MODEL, flange_at, rotation_about
from tests.unit.helpers.tag_paths import FIXTURE_BASE, two_paths

TIP_M = (0.012, -0.034, 0.215)
DOWN = np.diag([1.0, -1.0, -1.0])
PIN_M = np.array([0.85, 0.05, -0.1])
STEP_M = 0.31
TILTS = (
    ((0, 1, 0), 0.7),
    ((1, 0, 0), -0.7),
    ((1, 1, 0), 0.8),
    ((1, -1, 0), 0.8),
    ((0, 0, 1), 1.0),
    ((1, 0, 0), 0.5),
)
FRAME = homogeneous_matrix(
    rotation_about((0, 0, 1), 0.3) @ rotation_about((0, 1, 0), 0.05), np.array([0.75, -0.2, -0.2])
)
MOVED = homogeneous_matrix(rotation_about((0, 0, 1), 0.02), np.array([0.03, -0.02, 0.004]))
OF_WORKPIECE_M = ((0.0, 0.0, 0.0), (0.4, 0.0, 0.0), (0.0, 0.35, 0.0), (0.25, 0.2, 0.1))
FIXTURE: dict[str, Any] = {
    "fixture": "table",
    "points_in_fixture_m": POINTS_M,
    "rough_base_fixture": {"position_m": [0.85, 0.0, -0.2]},
    "limits": {"origin_m": 0.0003, "angle_rad": 0.0005},
}


# About where the nest is, and what an arm by its drawing can promise of it.
PROBED = ProcedureStory(
    "probed_frame",
    {
        "frame_number": 5,
        "nominal": {
            "position_m": [round(float(v), 3) for v in CORNER[:3, 3]],
            "quaternion": [float(v) for v in quaternion_from_rotation(CORNER[:3, :3])],
        },
        "touching": {
            "corner": "inside",
            "clear_m": 0.02,
            "search_way_m": 0.0025,
            "repeats": 1,
            "max_touches": 7,
            "measure_speed_m_s": 0.001,
        },
        "limits": {"origin_m": 0.003, "angle_rad": 0.012},
    },
    {"probe_at_corner": MODEL.base_flange(np.array([OVER_THE_CORNER_RAD]))[0]},
    robot="second",
    pace=2.5,  # a busy computer reads the contact late, and more so for a faster world
)
QUICK = ("six_point_tcp", "three_point_frame", "frame_offset", "simulation_cell")


def day_stories() -> tuple[ProcedureStory, ...]:
    """Return the day's stories; the losses before ``mastering_recovery`` are the caller's to cause."""
    frame = {"frame_number": 2, "tip_in_flange_m": TIP_M, "check_above": True, "sigma_m": MISSED_M}
    tool = {
        "tool_number": 4,
        "points_in_tool_m": TARGETS_M,
        "rough_flange_tool": {"position_m": [0.0, 0.0, 0.2]},
    }
    return (
        ProcedureStory("mastering_record", hold=True),
        ProcedureStory(
            "six_point_tcp", {"tool_number": 3, "arm_sigma_m": 0.0}, _touch_flanges()
        ),  # touched where it is believed
        ProcedureStory("three_point_frame", frame, _on_the_frame()),
        ProcedureStory(
            "frame_offset", frame | {"points_in_frame_m": OF_WORKPIECE_M}, _on_the_moved_workpiece()
        ),
        ProcedureStory("simulation_cell", _tag_settings()),
        ProcedureStory("end_effector_points", tool),
        ProcedureStory("fixture_alignment", FIXTURE),
        PROBED,
        ProcedureStory("mastering_record", robot="second"),
        ProcedureStory("fixture_alignment", FIXTURE, robot="second"),
        ProcedureStory(
            "base_to_base",
            {"fixture": "table", "limits": {"origin_m": 0.001, "angle_rad": 0.001}},
            robot="second",
        ),
        ProcedureStory("robot_calibration", {"method": "tracker"}),
        ProcedureStory("accuracy_check", {"method": "tracker"}),
        ProcedureStory("drift_check"),
        ProcedureStory("mastering_recovery"),
        ProcedureStory("mastering_undo"),
    )


def _touch_flanges() -> dict[str, Array]:
    """Return where the flange is for each touch and move of the textbook's method."""
    places = {"touch": flange_at(PIN_M, DOWN, TIP_M)}
    keys = ("touch_about_x", "touch_about_y", *(f"touch_{k}" for k in range(2, 13)))
    tilts = (((1, 0, 0), 0.9), ((0, 1, 0), 0.8), *(TILTS[k % len(TILTS)] for k in range(len(keys))))
    for key, (about, angle) in zip(keys, tilts, strict=False):
        places[key] = flange_at(
            PIN_M, DOWN @ rotation_about(np.array(about) / np.linalg.norm(about), angle), TIP_M
        )
    for axis, key in enumerate(("along_x", "along_y", "along_z")):
        # the tool's own axis, by a foot: those that point at the floor would end below the pin
        places[key] = flange_at(PIN_M + DOWN[:, axis] * STEP_M, DOWN, TIP_M)
    return places


def _on_the_frame() -> dict[str, Array]:
    points = {
        "touch_origin": (0, 0, 0),
        "touch_on_x": (0.4, 0, 0),
        "touch_on_xy": (0.1, 0.3, 0),
        "touch_origin_again": (0, 0, 0),
        "touch_more_on_x": (0.4, 0, 0),
        "touch_more_on_xy": (0.1, 0.3, 0),
        "touch_above": (0.1, 0.1, 0.05),
    }
    return {key: _point_in_base(FRAME, point) for key, point in points.items()}


def _on_the_moved_workpiece() -> dict[str, Array]:
    points: Mapping[str, Any] = {f"touch_point_{k}": point for k, point in enumerate(OF_WORKPIECE_M, 1)}
    return {
        key: _point_in_base(FRAME @ MOVED, point)
        for key, point in {**points, "touch_above": (0.1, 0.1, 0.2)}.items()
    }


def _point_in_base(base_frame: Array, point_m: Any) -> Array:
    tip = base_frame[:3, :3] @ np.asarray(point_m, dtype=float) + base_frame[:3, 3]
    return flange_at(tip, DOWN, TIP_M)


def _tag_settings() -> dict[str, Any]:
    simulated, measured = two_paths(FIXTURE_BASE, 9)
    return {
        "part": "base",
        "simulated": _file_setting(simulated),
        "measured": _file_setting(measured),
        "nominal": {"position_m": [1.2, 0.0, 0.4]},
    }


def _file_setting(path: TagPath) -> dict[str, Any]:
    """Return the file that a simulation exports, as a page sends it."""
    rows = [f"{name},{x!r},{y!r},{z!r}" for name, (x, y, z) in zip(path.names, path.positions_m, strict=True)]
    content = base64.b64encode("\n".join(["tag,x,y,z", *rows, ""]).encode()).decode()
    return {"file": {"name": path.source, "content_base64": content}, "units": {"position": "m"}}
