"""Jobs as those of a project's robot: its pulses as joints, and which of a controller's robots it is."""

from collections.abc import Sequence

from cellcal.calibration.geometry import Array
from cellcal.calibration.message import make_message
from cellcal.drivers.programs.positions import ProgramFile
from cellcal.service.engineering.programs.project_poses import ProjectError, axis_numbers
from cellcal.service.engineering.programs.project_tables import RobotTable

KEY = "pulses_per_rad"
FIRST_GROUP = "RB1"
PULSES = "pulses"  # the kind of such a position
MISSING = (
    "holds pulses, and the project gives no pulses_per_rad under [robot]: one for each axis with its sign, from "
    "RC.PRM or ALL.PRM of the controller"
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
            make_message("{where}: {key} holds a zero.", where=where, key=KEY),
            remedy="Divide an axis' pulses by its angle in radians, both read at one posture.",
        )
    return ratios


def read_for_robot(
    programs: Sequence[ProgramFile], ratios: Array | None, control_group: str
) -> tuple[ProgramFile, ...]:
    """Return programs as those of a project's robot: its positions in pulses are joints, others' are not its own.

    ``control_group`` names it where a controller has several, as RB1 and RB2.

    Raises
    ------
    ProgramFileError
        A position holds more axes than there are ratios.
    """
    pulsed = ratios is not None and any(PULSES in program.positions.kinds for program in programs)
    if not pulsed and control_group == FIRST_GROUP:
        return tuple(programs)
    # one maker's programs hold pulses, and its reader is loaded where they are
    from cellcal.drivers.yaskawa.program_files.job_program import JobProgram, read_job  # noqa: PLC0415

    return tuple(
        read_job(
            program.file, program.data, pulses_per_rad=ratios, robot=int(control_group[-1])
        ).with_external_uses(program.external_uses)
        if isinstance(program, JobProgram)
        else program
        for program in programs
    )
