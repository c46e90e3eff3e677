"""Where a program's robot begins: what tells the branch of its first points when the file says no configuration."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from cellcal.calibration.arm.kinematics import RobotModel
from cellcal.calibration.geometry import Array
from cellcal.service.engineering.programs.project_poses import ProjectError, axis_numbers
from cellcal.service.engineering.programs.project_tables import RobotTable

KEY = "starting_posture_deg"


@dataclass(frozen=True, eq=False)
class StartingPostures:
    """Joints [rad, or m where they slide] in which programs begin."""

    usual: Array | None = None  # (n,) of every program that has none of its own
    by_program: Mapping[str, Array] = field(default_factory=dict)

    def of_program(self, name: str) -> Array | None:
        """Return the posture in which a program begins; None where the project states none."""
        found = self.by_program.get(name)
        if found is None:
            found = next((q for key, q in self.by_program.items() if key.lower() == name.lower()), None)
        return self.usual if found is None else found


NO_STARTING_POSTURES = StartingPostures()


def read_starting_postures(
    robot: RobotTable, by_program: Mapping[str, Sequence[float]], model: RobotModel, where: str
) -> StartingPostures:
    """Return the postures of ``[robot] starting_posture_deg`` and of ``[starting_postures]``, by program.

    Raises
    ------
    ProjectError
        Not one finite number for each joint, or a joint beyond its limit.
    """
    usual = robot.starting_posture_deg
    return StartingPostures(
        None if usual is None else _read_posture(usual, KEY, model, f"{where}: [robot]"),
        {
            name: _read_posture(values, name, model, f"{where}: [starting_postures]")
            for name, values in by_program.items()
        },
    )


def _read_posture(written: Sequence[float], key: str, model: RobotModel, where: str) -> Array:
    values = axis_numbers(written, key, model.axis_count, where)
    slides = np.zeros(model.axis_count, dtype=bool) if model.sliding is None else model.sliding
    joints = np.where(slides, values * 1e-3, np.deg2rad(values))
    beyond = np.flatnonzero((joints < model.lower_rad) | (joints > model.upper_rad))
    if len(beyond):
        raise ProjectError(
            f"{where}: {key}: joint {beyond[0] + 1} at {values[beyond[0]]:g} is beyond its limit.",
            remedy="Write the joints as the controller shows them where the program begins.",
        )
    return np.asarray(joints, dtype=float)
