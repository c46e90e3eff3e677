"""What moving, cloning or compensating one program file gives: the new file, and what became of every point."""

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace

from cellcal.calibration.geometry import Array
from cellcal.calibration.message import make_message
from cellcal.drivers.programs.positions import ProgramFile
from cellcal.service.exit_codes import ExitCode

CHANGED, UNCHANGED, LEFT = "changed", "unchanged", "left"


@dataclass(frozen=True, slots=True)
class PointFinding:
    """A point that the new program does not bring to where the change asks for, though its numbers are right."""

    line: int  # of the instruction
    point: str
    what: str  # the instruction
    angle_rad: float  # by which the change turns the axes of the shift
    distance_m: float  # what it costs; NaN where the program does not tell the size of the shift
    turn_rad: float  # by how much the orientation is off; NaN as above
    text: str
    row: int = -1  # of the program's positions; -1 where the point is not one of these


@dataclass(frozen=True, eq=False)
class ProgramResult:
    """One program before and after, N positions in the order of ``before.positions``.

    A point is ``changed``; ``unchanged``, because its new coordinates are the old ones in the file's own number
    format; or ``excluded_points`` as it was, and then ``reason`` says why. A cell that runs a program with
    points left runs
    these as they were taught for another cell.
    """

    before: ProgramFile
    after: ProgramFile
    status: tuple[str, ...]  # CHANGED, UNCHANGED or LEFT
    reason: tuple[str, ...]  # a sentence for what is left, else ""
    shift_m: Array  # (N,) how far the written point moved, in its user frame as entered; NaN where left
    turn_rad: Array  # (N,) by how much it turned
    base_tip_before: Array  # (N, 4, 4) the written tip in the controller's base; NaN where unknown
    base_tip_after: Array  # (N, 4, 4), of the cell that the new program is for
    expected_error_m: Array  # (N,) k = 2, of the tip at its work in that cell; NaN where unknown
    uncorrected_m: Array  # (N,) what the point would miss by without the robots' models; NaN where not asked
    warnings: tuple[str, ...] = ()  # sentences about the program as a whole
    findings: tuple[PointFinding, ...] = ()

    @property
    def program_name(self) -> str:
        """Return the program's own name."""
        return self.before.name

    @property
    def status_counts(self) -> dict[str, int]:
        """Return how many points are changed, unchanged and left."""
        found = Counter(self.status)
        return {status: found[status] for status in (CHANGED, UNCHANGED, LEFT)}

    @property
    def is_complete(self) -> bool:
        """Return whether no point was left, and none of the others is off."""
        return LEFT not in self.status and not self.findings

    @property
    def exit_code(self) -> ExitCode:
        """Return what the shell gets to know about this program."""
        return ExitCode.PASS if self.is_complete else ExitCode.REFUSED

    @property
    def excluded_points(self) -> tuple[tuple[str, str], ...]:
        """Return name and reason of every point that was left."""
        found = zip(self.before.positions.names, self.status, self.reason, strict=True)
        return tuple((name, reason) for name, status, reason in found if status == LEFT)


def with_further_findings(result: ProgramResult, found: Sequence[PointFinding]) -> ProgramResult:
    """Return a result with more findings, each of them also a sentence about the program."""
    if not found:
        return result
    texts = tuple(make_message("line {line}: {text}", line=one.line, text=one.text) for one in found)
    return replace(result, findings=(*result.findings, *found), warnings=(*texts, *result.warnings))
