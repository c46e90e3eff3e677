"""A cell with a past: runs of an ideal arm in its journal, and versions of its parameters beside its file."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from cellcal.calibration.geometry import Pose, homogeneous_matrix
from cellcal.drivers.interfaces import PointReading
from cellcal.procedures.arm.series_rules import SeriesRules
from cellcal.service.configuration.cell_file import CellConfig, read_cell_file
from cellcal.service.engineering.parameters.calibrated_runs import save_calibration
from cellcal.service.engineering.parameters.parameter_sets import FOLDER, ParameterSets
from tests.procedures.cells import (
    TARGETS,
    Scene,
    calibrating_a_tool,
    going_round,
    moved_workpiece,
    pointing,
    touching,
)
from tests.procedures.certified import run_in
from tests.procedures.ideal import IdealArm, IdealTracker

SERIAL, ROBOT = "F-104711", "fanuc"
SPOILT_STEP = "capture 6"
SLIPPED_STEP, SLIPPED_KEY = "touch point 3", "touch_point_3"
QUICK = SeriesRules(
    first=12, batch=4, min_captures=16, max_captures=16, candidates=50, tests=12, samples=1, retakes=0
)


class Knocked(IdealTracker):
    """A tracker whose target was knocked for one reading of a series."""

    def __init__(self, arm: IdealArm, spoilt: int) -> None:
        super().__init__(arm)
        self._spoilt, self._count = spoilt, 0

    async def measure_point(self) -> PointReading:
        reading = await super().measure_point()
        self._count += 1
        if self._count != self._spoilt:
            return reading
        x, y, z = reading.position_m
        return replace(reading, position_m=(x + 0.004, y - 0.003, z))


@dataclass(frozen=True)
class Past:
    """What was done in the cell, by run."""

    config: CellConfig
    calibration: str
    touches: str
    spoilt: str
    frame: str
    moved: str  # four points of a workpiece, one of them touched badly


def _of_cell(made: Scene) -> Scene:
    made.arm.serial = SERIAL
    return made


def taught_roughly() -> Scene:
    """Return a scene whose touches scatter by tenths of millimetres, as hands do."""
    made = _of_cell(touching(min_touches=6, max_touches=8, rms_limit_m=0.002))
    dice = np.random.default_rng(4)
    for key, place in list(made.hands.does.items()):
        if key.startswith("touch"):
            slip = dice.normal(0.0, 1e-4, 3)
            made.hands.does[key] = _slipping(made, place, slip)
    return made


def touched_again() -> Scene:
    """Return a scene whose workpiece moved, and whose third point is touched a millimetre beside."""
    made = _of_cell(moved_workpiece())
    made.hands.does[SLIPPED_KEY] = _slipping(
        made, made.hands.does[SLIPPED_KEY], np.array([7e-4, -5e-4, 4e-4])
    )
    return made


def _slipping(made: Scene, place: Callable[[], object], slip: np.ndarray) -> Callable[[], None]:
    def do() -> None:
        place()
        taught = made.arm.taught
        assert taught is not None
        made.arm.taught = Pose.from_matrix(
            homogeneous_matrix(taught.rotation_matrix(), np.array(taught.position_m) + slip)
        )

    return do


def _with_a_tool() -> Scene:
    return calibrating_a_tool(TARGETS[:1], rules=QUICK, tool_number=None)


async def with_a_past(cell_file: Path) -> Past:
    """Fill the journal of a cell file, and save two versions of the first robot's parameters."""
    config = read_cell_file(cell_file)
    sets = ParameterSets(cell_file.parent / FOLDER)
    good = await run_in(config, _of_cell(_with_a_tool()), "robot_calibration")
    save_calibration(config, ROBOT, sets, "Anna", "2026-11-01T08:00:00+00:00")
    made = _of_cell(_with_a_tool())
    made.cell = replace(made.cell, tracker=Knocked(made.arm, 6))
    spoilt = await run_in(config, made, "robot_calibration")
    save_calibration(config, ROBOT, sets, "Anna", "2026-11-08T08:00:00+00:00")
    rough = await run_in(config, taught_roughly(), "six_point_tcp")
    await run_in(config, _of_cell(going_round()), "accuracy_check")
    frame = await run_in(config, _of_cell(pointing()), "three_point_frame")
    moved = await run_in(config, touched_again(), "frame_offset")
    return Past(config, good.run_id, rough.run_id, spoilt.run_id, frame.run_id, moved.run_id)
