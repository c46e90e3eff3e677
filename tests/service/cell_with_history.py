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
from tests.procedures.certified_runs import run_in
from tests.procedures.ideal_devices import IdealArm, IdealTracker
from tests.procedures.procedure_scenes import (
    TARGETS,
    ProcedureScene,
    moved_workpiece_scene,
    round_trip_scene,
    tool_calibration_scene,
    tool_touch_scene,
    user_frame_scene,
)

SERIAL, ROBOT = "F-104711", "fanuc"
SPOILT_STEP = "capture 6"
SLIPPED_STEP, SLIPPED_KEY = "touch point 3", "touch_point_3"
QUICK = SeriesRules(
    first=12, batch=4, min_captures=16, max_captures=16, candidates=50, tests=12, samples=1, retakes=0
)


class KnockedTracker(IdealTracker):
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
class PastRuns:
    """What was done in the cell, by run."""

    config: CellConfig
    calibration: str
    touches: str
    spoilt: str
    frame: str
    moved: str  # four points of a workpiece, one of them touched badly


def _of_cell(made: ProcedureScene) -> ProcedureScene:
    made.arm.serial = SERIAL
    return made


def taught_roughly() -> ProcedureScene:
    """Return a scene whose touches scatter by tenths of millimetres, as hands do."""
    made = _of_cell(tool_touch_scene(min_touches=6, max_touches=8, rms_limit_m=0.002))
    rng = np.random.default_rng(4)
    for key, place in list(made.technician.does.items()):
        if key.startswith("touch"):
            slip = rng.normal(0.0, 1e-4, 3)
            made.technician.does[key] = _slipping_touch(made, place, slip)
    return made


def touched_again() -> ProcedureScene:
    """Return a scene whose workpiece moved, and whose third point is touched a millimetre beside."""
    made = _of_cell(moved_workpiece_scene())
    made.technician.does[SLIPPED_KEY] = _slipping_touch(
        made, made.technician.does[SLIPPED_KEY], np.array([7e-4, -5e-4, 4e-4])
    )
    return made


def _slipping_touch(
    made: ProcedureScene, place: Callable[[], object], slip: np.ndarray
) -> Callable[[], None]:
    def touch_beside() -> None:
        place()
        taught = made.arm.taught
        assert taught is not None
        made.arm.taught = Pose.from_matrix(
            homogeneous_matrix(taught.rotation_matrix(), np.array(taught.position_m) + slip)
        )

    return touch_beside


def _with_a_tool() -> ProcedureScene:
    return tool_calibration_scene(TARGETS[:1], rules=QUICK, tool_number=None)


async def cell_with_past_runs(cell_file: Path) -> PastRuns:
    """Fill the journal of a cell file, and save two versions of the first robot's parameters."""
    config = read_cell_file(cell_file)
    sets = ParameterSets(cell_file.parent / FOLDER)
    good = await run_in(config, _of_cell(_with_a_tool()), "robot_calibration")
    save_calibration(config, ROBOT, sets, "Anna", "2026-11-01T08:00:00+00:00")
    made = _of_cell(_with_a_tool())
    made.cell = replace(made.cell, tracker=KnockedTracker(made.arm, 6))
    spoilt = await run_in(config, made, "robot_calibration")
    save_calibration(config, ROBOT, sets, "Anna", "2026-11-08T08:00:00+00:00")
    rough = await run_in(config, taught_roughly(), "six_point_tcp")
    await run_in(config, _of_cell(round_trip_scene()), "accuracy_check")
    frame = await run_in(config, _of_cell(user_frame_scene()), "three_point_frame")
    moved = await run_in(config, touched_again(), "frame_offset")
    return PastRuns(config, good.run_id, rough.run_id, spoilt.run_id, frame.run_id, moved.run_id)
