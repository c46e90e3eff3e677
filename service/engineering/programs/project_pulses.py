"""Positions in encoder pulses as joints: what a controller keeps in its parameters, and a job does not say."""

from collections.abc import Sequence

from cellcal.calibration.geometry import Array
from cellcal.drivers.programs.positions import ProgramFile
from cellcal.service.engineering.programs.project_poses import ProjectError, axis_numbers
from cellcal.service.engineering.programs.project_tables import RobotTable

KEY = "pulses_per_rad"
PULSES = "pulses"  # the kind of such a position
MISSING = (
    f"holds pulses, and the project gives no {KEY} under [robot]: one for each axis with its sign, from RC.PRM or "
    "ALL.PRM of the controller"
)


def pulses_per_rad(robot: RobotTable, axes: int, where: str) -> Array | None:
    """Return the pulses per radian (n,) of every axis, with sign; None where the project gives none.

    Raises
    ------
    ProjectError
        Not one finite number an axis, or a zero.
    """
    if robot.pulses_per_rad is None:
        return None
    ratios = axis_numbers(robot.pulses_per_rad, KEY, axes, where)
    if (ratios == 0).any():
        raise ProjectError(
            f"{where}: {KEY} holds a zero.",
            remedy="Divide an axis' pulses by its angle in radians, both read at one posture.",
        )
    return ratios


def in_joints(programs: Sequence[ProgramFile], ratios: Array | None) -> tuple[ProgramFile, ...]:
    """Return programs whose positions in pulses are joints; those that hold none are as they were.

    Raises
    ------
    ProgramFileError
        A position holds more axes than there are ratios.
    """
    if ratios is None or not any(PULSES in program.positions.kinds for program in programs):
        return tuple(programs)
    # one maker's programs hold pulses, and its reader is loaded where they are
    from cellcal.drivers.yaskawa.program_files.job_program import JobProgram, read_job  # noqa: PLC0415

    return tuple(
        read_job(program.file, program.data, pulses_per_rad=ratios).with_external_uses(program.external_uses)
        if isinstance(program, JobProgram)
        else program
        for program in programs
    )
