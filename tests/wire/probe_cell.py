"""A cell file with a robot that carries a probe, a ball to touch, and the approaches to it from several sides."""

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from cellcal.calibration.arm.kinematics import RobotModel
from cellcal.calibration.geometry import homogeneous_matrix
from cellcal.procedures.cell import Cell
from cellcal.procedures.motion.probe_line import joints_for_tip
from cellcal.procedures.steps.touch import ProbeApproach, probe_of
from cellcal.service.demo.fake_cell_client import FakeCellClient
from tests.cell_tables import (
    cell_head,
    dial_gauge_table,
    fake_table,
    fanuc_table,
    touch_probe_table,
    universal_robots_table,
    write_table,
)
from tests.wire.fake_devices_process import run_fakes

BALL_MM = 12.7
TIP_MM = (10.0, -20.0, 160.0)
TIP_RADIUS_MM = 1.5
PRETRAVEL_MM = 0.02
HOME_RAD = {
    "fanuc": (0.1, 0.17, -0.44, 0.26, -1.05, 0.35),
    "ur": (-1.57, -1.57, -1.57, -1.57, 1.57, 0.0),
}
# from the ball's centre to where the tip comes from, in the base: above, and three sides raised by 30 degrees
SIDES = ((0.0, 0.0, 1.0), (0.866, 0.0, 0.5), (-0.433, 0.75, 0.5), (-0.433, -0.75, 0.5))

_ROBOTS = {
    "fanuc": fanuc_table(settle_s=0.2),
    "ur": universal_robots_table(deadline_s=8.0, state_rate_hz=60.0),
}


def drawn_ball_m(robot: str, model: RobotModel) -> np.ndarray:
    """Return where the drawing has the ball: below the tip at home."""
    tips = model.tip_positions(np.array([HOME_RAD[robot]]), np.array(TIP_MM) * 1e-3)
    return np.asarray(tips[0] - [0.0, 0.0, 0.04])


@contextmanager
def play_probe_cell(
    folder: Path, robot: str, place_m: Sequence[float], *, hidden: bool = True, tip_sigma_mm: float = 1.0
) -> Iterator[tuple[Path, FakeCellClient]]:
    """Play a robot with a probe and a ball near ``place_m``."""
    ball = write_table(
        "fake.artefact",
        name="ball",
        kind="sphere",
        robot=robot,
        radius_mm=BALL_MM,
        place_in_base_mm=[float(1e3 * value) for value in place_m],
        sigma_mm=0.3,
    )
    with _play_cell(folder, robot, ball, hidden=hidden, tip_sigma_mm=tip_sigma_mm) as cell:
        yield cell


@contextmanager
def at_a_corner(
    folder: Path, robot: str, base_frame: np.ndarray, *, tip_sigma_mm: float
) -> Iterator[tuple[Path, FakeCellClient]]:
    """Play a robot with a probe in a corner that opens to +x, +y, +z of a frame (4, 4), all hidden effects on.

    What a busy machine makes late counts in the world's time: at four times its own the frame's uncertainty reached
    the limit of its verdict. Where the arm comes to rest at the surface it swings for longer than a contact springs.
    """
    tables = corner_tables(robot, base_frame)
    with _play_cell(folder, robot, tables, tip_sigma_mm=tip_sigma_mm, pace=2.0, bounce_ms=40.0) as cell:
        yield cell


@contextmanager
def _play_cell(
    folder: Path,
    robot: str,
    artefacts: str,
    *,
    tip_sigma_mm: float,
    hidden: bool = True,
    pace: float = 3.0,
    bounce_ms: float | None = None,
) -> Iterator[tuple[Path, FakeCellClient]]:
    instruments = touch_probe_table(
        robot=robot,
        echo_output=1,
        echo_input=2,
        tip_in_flange_mm=list(TIP_MM),
        tip_sigma_mm=tip_sigma_mm,
        tip_radius_mm=TIP_RADIUS_MM,
        pretravel_mm=PRETRAVEL_MM,
        overtravel_mm=6.0,
        silence_ms=600.0,  # on a quiet machine; every way without a touch waits for so long at its end
        debounce_ms=40.0,
        bounce_ms=bounce_ms,
        poll_ms=6.0,
    ) + dial_gauge_table(robot=robot, tip_in_flange_mm=list(TIP_MM))
    world = fake_table(watchdog_factor=10.0, time_factor=pace, hidden=hidden)
    text = cell_head("probe tests") + _ROBOTS[robot] + instruments + world
    with run_fakes(folder, text + artefacts) as cell:
        yield cell


def corner_tables(robot: str, base_frame: np.ndarray) -> str:
    """Return the artefacts of a corner for a cell file."""
    place = [float(1e3 * value) for value in base_frame[:3, 3]]
    return "".join(
        write_table(
            "fake.artefact",
            name=f"{name} face",
            kind="plane",
            robot=robot,
            place_in_base_mm=place,
            axis_in_base=[float(value) for value in base_frame[:3, k]],
            sigma_mm=0.4,
        )
        for k, name in enumerate("xyz")
    )


def true_corner(truth: dict[str, Any]) -> np.ndarray:
    """Return the frame (4, 4) in which the planes of the world's truth really meet."""
    planes = [truth["artefacts"][f"{name} face"] for name in "xyz"]
    axes = np.array([plane["axis_in_base"] for plane in planes])
    heights = [axis @ np.array(plane["place_in_base_m"]) for axis, plane in zip(axes, planes, strict=True)]
    return homogeneous_matrix(axes.T, np.linalg.solve(axes, heights))


def approach_from(
    cell: Cell,
    home_rad: Sequence[float],
    centre_m: np.ndarray,
    side: Sequence[float],
    *,
    clear_m: float = 0.0015,
    beyond_m: float = 0.0025,
    **how: Any,
) -> ProbeApproach:
    """Return an approach to the ball's centre from one side, from clear of where it should touch to beyond that."""
    _, setup = probe_of(cell)
    assert cell.model is not None
    direction = np.array(side) / np.linalg.norm(side)
    reach = (BALL_MM + TIP_RADIUS_MM) * 1e-3
    ends = [
        joints_for_tip(
            cell.model, setup.tip_in_flange_m, tuple(home_rad), centre_m + direction * (reach + away)
        )
        for away in (clear_m, -beyond_m)
    ]
    return ProbeApproach(ends[0], ends[1], **how)
