"""The product's own functions, one for each reference problem: numbers in, answers under the problem's names out."""

from collections.abc import Callable
from typing import TypeAlias

import numpy as np

from cellcal.calibration.arm.kinematics import DhTable, RobotModel
from cellcal.calibration.cells.cell import CalibrationCell, CellDevice, CellRobot, CellSeries, CellTool
from cellcal.calibration.cells.contact_observations import PlaneContacts
from cellcal.calibration.cells.frame_priors import FramePrior
from cellcal.calibration.cells.identify import fit_cell
from cellcal.calibration.cells.levels import CellOptions
from cellcal.calibration.cells.prediction import frame_between
from cellcal.calibration.compensation.compensate import compensate
from cellcal.calibration.geometry import Array, Pose
from cellcal.calibration.identification.parameters import FRAMES
from cellcal.calibration.mastering.integer_search import search_integers
from cellcal.calibration.points.frames import (
    base_to_base,
    clone_frame_change,
    frame_from_many_points,
    frame_from_six_points,
    frame_from_three_points,
    frame_offset,
    moved_point,
)
from cellcal.calibration.points.tool_point import locate_tool_point
from cellcal.calibration.registration import best_fit_transform, trilaterate_point

Given: TypeAlias = dict[str, Array]
Found: TypeAlias = dict[str, Array | float]


def solve_plane(givens: Given) -> Found:
    """Fit the place of a plane that a known tip touched, with the arm as it is."""
    joints = givens["joints_rad"]
    count = len(joints)
    contacts = PlaneContacts(
        joints, np.zeros(count), np.full(count, float(givens["sigma_m"])), np.zeros(count, dtype=np.intp)
    )
    cell = CalibrationCell(
        [CellRobot("arm", _build_arm(givens["rows"], givens["base"]))],
        [CellTool("tip", "arm", FramePrior.from_point(givens["tip_in_flange_m"]))],
        [CellDevice("plane")],
        [CellSeries("touches", "plane", "tip", contacts)],
    )
    fit = fit_cell(cell, CellOptions(level=FRAMES, judge=False)).robust.fit
    frame = frame_between(fit, "arm", "plane").pose
    normal, origin = frame[:3, 2], frame[:3, 3]
    tips = _build_arm(givens["rows"], givens["base"]).tip_positions(joints, givens["tip_in_flange_m"])
    heights = (tips - origin) @ normal
    above = givens["above_m"]
    return {
        "foot_m": above - normal * float(normal @ (above - origin)),
        "rms_m": float(np.sqrt((heights**2).mean())),
    }


def solve_frame(givens: Given) -> Found:
    """Construct frames from points, and carry frames as textbooks do."""
    six = givens["six_points_m"].tolist()
    poses = {key: Pose.from_matrix(value) for key, value in givens.items() if value.shape == (4, 4)}
    offset = frame_offset(poses["base_frame"], poses["base_frame_moved"])
    between = base_to_base(poses["base_fixture"], poses["other_base_fixture"])
    change = clone_frame_change(poses["base_frame"], poses["other_base_frame"], between)
    three = frame_from_three_points(*givens["three_points_m"].tolist())
    return {
        "three_point_frame": three.base_frame.to_matrix(),
        "six_point_frame": frame_from_six_points(
            six[:3], six[3:5], six[5], above_m=six[6]
        ).base_frame.to_matrix(),
        "frame_offset": offset.to_matrix(),
        "moved_point": moved_point(offset, poses["frame_tcp"]).to_matrix(),
        "other_base_base": between.to_matrix(),
        "clone_change": change.to_matrix(),
    }


def solve_registration(givens: Given) -> Found:
    """Fit one set of points onto another."""
    fit = best_fit_transform(givens["source_m"].tolist(), givens["target_m"].tolist())
    return {"target_source": fit.target_source.to_matrix(), "rms_m": fit.rms_m}


def solve_tool_point(givens: Given) -> Found:
    """Find tip and pin from touches."""
    found = locate_tool_point([Pose.from_matrix(touch) for touch in givens["touches"]])
    return {
        "tip_in_flange_m": np.array(found.tip_in_flange_m),
        "pin_in_base_m": np.array(found.pin_in_base_m),
        "rms_m": found.rms_m,
    }


def solve_dh(givens: Given) -> Found:
    """Run the forward kinematics."""
    return {"flanges": _build_arm(givens["rows"]).base_flange(givens["joints_rad"])}


def solve_compensation(givens: Given) -> Found:
    """Find the joints that bring the real flange where the nominal one is."""
    done = compensate(_build_arm(givens["real"]), _build_arm(givens["nominal"]), givens["joints_rad"])
    return {"joints_rad": np.where(done.has_converged[:, None], done.joints_rad, np.nan)}


def solve_turn_loss(givens: Given) -> Found:
    """Find whole turns: a real-valued solution first, then the nearest integers in its metric."""
    rows, sigma = givens["metres_per_turn_m"], float(givens["sigma_m"])
    real: Array = np.linalg.lstsq(rows, givens["lengths_m"], rcond=None)[0].astype(np.float64)
    covariance: Array = (sigma**2 * np.linalg.inv(rows.T @ rows)).astype(np.float64)
    found = search_integers(real, covariance)
    return {
        "real_turns": real,
        "turns": np.array(found.best, dtype=float),
        "next_best_turns": np.array(found.second, dtype=float),
        "distance": found.best_distance,
        "next_best_distance": found.second_distance,
    }


def solve_fixture(givens: Given) -> Found:
    """Find alignment points from lengths, and the fixture whose drawing lies on them best."""
    stations = givens["stations_m"].tolist()
    points = [trilaterate_point(stations, lengths).point_m for lengths in givens["lengths_m"].tolist()]
    fit = frame_from_many_points(givens["drawing_m"].tolist(), points)
    return {
        "points_in_base_m": np.array(points),
        "base_fixture": fit.target_source.to_matrix(),
        "rms_m": fit.rms_m,
    }


def _build_arm(rows: Array, base: Array | None = None) -> RobotModel:
    turn = np.full(len(rows), 2 * np.pi)
    table = DhTable.from_rows(rows)
    return RobotModel.from_dh(table, base=base, name="reference", lower_rad=-turn, upper_rad=turn)


SOLVERS: dict[str, Callable[[Given], Found]] = {
    "plane": solve_plane,
    "frame": solve_frame,
    "registration": solve_registration,
    "tool_point": solve_tool_point,
    "dh": solve_dh,
    "compensation": solve_compensation,
    "turn_loss": solve_turn_loss,
    "fixture": solve_fixture,
}
