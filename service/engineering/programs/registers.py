"""Position registers that programs go to: their values in a FANUC's backup, and where they go with the programs.

A register that is only gone to is a place, and is carried as a program's own positions are. One that also shifts a
motion, is computed, or is gone to in several frames stays, with the reason.
"""

from collections.abc import Sequence, Set
from dataclasses import dataclass, replace

import numpy as np

from cellcal.calibration.geometry import Array
from cellcal.calibration.message import make_message
from cellcal.drivers.fanuc.program_files.ls_program import LsProgram
from cellcal.drivers.fanuc.program_files.ls_registers import (
    UNSURE,
    RegisterUse,
    indirect_line,
    registers_used,
)
from cellcal.drivers.fanuc.program_files.va_backup import REGISTERS, FanucBackup, read_backup
from cellcal.drivers.fanuc.program_files.va_edits import VariableEdit, changed_files
from cellcal.drivers.fanuc.program_files.va_positions import VaPosition
from cellcal.drivers.fanuc.program_files.va_registers import GROUP, RegisterPlace, RegisterPlaces
from cellcal.drivers.programs.positions import ProgramFile
from cellcal.service.engineering.programs.program_transfer import ProgramTransfer
from cellcal.service.engineering.programs.project import Project
from cellcal.service.engineering.programs.project_poses import ProjectError
from cellcal.service.engineering.programs.result import LEFT, ProgramResult

_OTHER_CONFIGURATION = (
    "it has the configuration {} in {}, and needs {}: record it on the pendant once in the right posture"
)
_CHOSEN = "{} line {} lets a number register choose a PR that it computes or shifts with: any may be meant"


@dataclass(frozen=True, slots=True)
class PositionRegister:
    """One register that programs use."""

    number: int
    position: VaPosition | None  # None where the backup holds none
    uses: tuple[tuple[str, int], ...]  # program and line
    stays: str  # why it is not carried; "" for a place

    def __str__(self) -> str:
        """Say what it holds and where it is used."""
        at = ", ".join(f"{program} line {line}" for program, line in self.uses)
        value = "nothing in the backup" if self.position is None else _describe_values(self.position)
        comment = f" '{self.position.comment}'" if self.position is not None and self.position.comment else ""
        return f"PR[{self.number}]{comment}: {value}; used in {at}{f'; it stays: {self.stays}' if self.stays else ''}"


@dataclass(frozen=True, eq=False)
class TransferredRegisters:
    """The results for the places in registers."""

    result: ProgramResult
    edits: tuple[VariableEdit, ...]  # to type into the controller that gets them
    file: bytes | None  # its POSREG.VA with these numbers; None where its project names no backup


class ProgramRegisters:
    """The registers that some programs of a cell use."""

    def __init__(self, programs: Sequence[ProgramFile], cell: Project) -> None:
        self._backup = backup_of(cell)
        uses: dict[int, list[tuple[str, RegisterUse]]] = {}
        chosen = ""
        for program in programs:
            line = indirect_line(program.to_bytes()) if program.brand == "fanuc" else 0
            chosen = chosen or (make_message(_CHOSEN, program.name, line) if line else "")
            its = _uses_in(program) if isinstance(program, LsProgram) else ()
            for use in its:
                uses.setdefault(use.number, []).append((program.name, use))
        self.all = tuple(
            _read_register(self._backup, number, uses[number], chosen) for number in sorted(uses)
        )
        self.places = RegisterPlaces(
            self._backup,
            tuple(
                RegisterPlace(one.number, uses[one.number][0][1].user_frame, uses[one.number][0][1].tool)
                for one in self.all
                if not one.stays
            ),
        )

    def transfer_registers(self, program_transfer: ProgramTransfer, target: Project) -> TransferredRegisters:
        """Carry the places along a carrier's route, and say what the target's controller gets.

        Raises
        ------
        CellError
            As `Carrier.carry`; or the target's backup has no such register.
        """
        result = program_transfer.transfer_programs([self.places])[0]
        rows = [row for row, status in enumerate(result.status) if status != LEFT]
        after = result.after.positions
        here = target.backup is not None
        backup = read_backup(target.backup) if target.backup is not None else self._backup
        result = _without_other_configurations(result, backup, self.places)
        rows = [row for row in rows if result.status[row] != LEFT]
        edits = self.places.edits_for(backup, rows, after.frame_tip[rows], _joint_rows(after.joints, rows))
        file = changed_files(backup, edits).get(REGISTERS, backup.files[REGISTERS].data) if here else None
        return TransferredRegisters(result, edits, file)


def _uses_in(program: LsProgram) -> Sequence[RegisterUse]:
    """Return the uses of registers, in the frame and with the tool of the callers where the program chooses none."""
    external_uses = program.external_uses
    found = registers_used(program.to_bytes(), program.positions, external_uses)
    if external_uses is None:
        return found
    return [
        replace(
            use,
            user_frame=_of_callers(use.user_frame, external_uses.frames_before),
            tool=_of_callers(use.tool, external_uses.tools_before),
        )
        for use in found
    ]


def _of_callers(number: str | None, before: Set[str]) -> str | None:
    if number is not None or not before:
        return number
    (first, *others) = sorted(before)
    return first if first.isdigit() and not others else UNSURE


def backup_of(cell: Project) -> FanucBackup:
    """Return the backup that a project names.

    Raises
    ------
    ProjectError
        It names none, or one without POSREG.VA.
    """
    if cell.backup is None:
        raise ProjectError(
            f"{cell.path}: no backup of the controller is named.",
            remedy="Save its .VA files and name their folder as backup under [robot].",
        )
    backup = read_backup(cell.backup)
    if REGISTERS not in backup.files:
        raise ProjectError(
            f"{cell.backup} holds no {REGISTERS}, in which a controller keeps its position registers.",
            remedy="Save all of the controller's files as text (.VA).",
        )
    return backup


def _read_register(
    backup: FanucBackup, number: int, uses: Sequence[tuple[str, RegisterUse]], chosen: str
) -> PositionRegister:
    position = backup.registers.get((GROUP, number))
    at = tuple((program, use.line) for program, use in uses)
    return PositionRegister(number, position, at, _why_it_stays(position, uses) or chosen)


def _why_it_stays(position: VaPosition | None, uses: Sequence[tuple[str, RegisterUse]]) -> str:
    if position is None or not position.is_initialised:
        return "the backup holds no position in it"
    other = next(((program, use.line) for program, use in uses if not use.goes_there), None)
    if other is not None:
        return f"{other[0]} line {other[1]} does more than go there, so it may be a shift or be computed"
    frames_and_tools = {(use.user_frame, use.tool) for _, use in uses}
    if len(frames_and_tools) > 1 or UNSURE in next(iter(frames_and_tools)):
        return "it is gone to with several frames or tools, or with which is not sure"
    return ""


def _without_other_configurations(
    result: ProgramResult, backup: FanucBackup, places: RegisterPlaces
) -> ProgramResult:
    """Return a result that leaves the registers which the target would read in another posture."""
    status, reason = list(result.status), list(result.reason)
    for row, text in enumerate(result.after.positions.configurations):
        stored = backup.registers.get((GROUP, places.places[row].number))
        if (
            status[row] != LEFT
            and stored is not None
            and stored.is_cartesian
            and stored.configuration != text
        ):
            status[row] = LEFT
            reason[row] = make_message(_OTHER_CONFIGURATION, stored.configuration, backup.folder, text)
    return replace(result, status=tuple(status), reason=tuple(reason))


def _joint_rows(joints: Array, rows: Sequence[int]) -> Array:
    return joints[rows] if joints.shape[1] else np.full((len(rows), 0), np.nan)


def _describe_values(position: VaPosition) -> str:
    words = [
        make_message(
            "{name} {spot_text} {units}",
            name=name,
            spot_text=spot.text.strip(),
            units=position.units.get(name, "mm" if name in "XYZ" else "deg"),
        )
        for name, spot in position.numbers.items()
        if spot.is_initialised
    ]
    return (
        ", ".join([*words, *([position.configuration] if position.configuration else [])]) or "not recorded"
    )
