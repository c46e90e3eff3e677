"""``cellcal program registers``: what it says, and what it writes."""

from pathlib import Path
from typing import TYPE_CHECKING

from cellcal.calibration.errors import CellError
from cellcal.service.engineering.programs.joint_points import JointPoints
from cellcal.service.exit_codes import ExitCode

if TYPE_CHECKING:
    from cellcal.service.engineering.programs.program_transfer import ProgramTransfer
    from cellcal.service.engineering.programs.project import Project
    from cellcal.service.engineering.programs.registers import ProgramRegisters

_FILE = "POSREG.VA"


class RegistersError(CellError):
    """It is not clear what shall become of the registers."""

    code = "usage"


def transfer_of(
    cell: "Project",
    clone: "Project | None",
    offset: str | None,
    frame: str | None,
    joints: JointPoints | None,
) -> "ProgramTransfer | None":
    """Return what carries the registers to a clone or with the work; None where they are only looked at.

    Raises
    ------
    CellError
        Both ways at once, or a project that lacks what the way needs.
    """
    from cellcal.drivers.program_registry import brand_named
    from cellcal.service.cli.program_moves import base_change_of
    from cellcal.service.engineering.programs.clone import clone_transfer
    from cellcal.service.engineering.programs.move import move_transfer

    if clone is not None and offset is not None:
        raise RegistersError(
            "Registers go to a clone or move with the work.", remedy="Give --clone or --offset."
        )
    rule = brand_named("fanuc").configurations
    if clone is not None:
        return clone_transfer(cell, clone, rule)
    if offset is None:
        return None
    return move_transfer(
        cell, base_change_of(cell, offset, frame, (None, None)), rule, frame=frame, joints=joints
    )


def print_registers(
    found: "ProgramRegisters", program_transfer: "ProgramTransfer | None", target: "Project", out: Path | None
) -> int:
    """Print the registers, what to type, and write the target's POSREG.VA where it is asked for."""
    from rich.console import Console

    from cellcal.drivers.fanuc.program_files.va_edits import edit_instructions
    from cellcal.service.engineering.programs.files import whole_file

    console = Console(highlight=False, soft_wrap=True, markup=False, emoji=False)
    for register in found.all:
        console.print(str(register))
    stay = any(register.stays for register in found.all)
    if program_transfer is None or not found.places.places:
        return ExitCode.REFUSED if stay and program_transfer is not None else ExitCode.PASS
    carried = found.transfer_registers(program_transfer, target)
    for line in edit_instructions(carried.edits):
        console.print(line)
    for name, reason in carried.result.excluded_points:
        console.print(f"{name} stays as it is: {reason}")
    if out is not None:
        if carried.file is None:
            raise RegistersError(
                f"{target.path} names no backup, so no {_FILE} can be written for its controller.",
                remedy="Save that controller's .VA files and name their folder as backup under [robot].",
            )
        out.mkdir(parents=True, exist_ok=True)
        with whole_file(out / _FILE, replace=False) as file:
            file.write(carried.file)
        console.print(f"written: {out / _FILE}")
    return ExitCode.REFUSED if stay or not carried.result.is_complete else ExitCode.PASS
