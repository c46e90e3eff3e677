"""What became of many programs: figures of every point, worst first, small enough to be kept for a whole line.

The programs themselves are not kept: a line has a million points.
"""

from collections import Counter
from dataclasses import dataclass, field
from pathlib import PurePath

import numpy as np
from numpy.typing import NDArray

from cellcal.calibration.geometry import Array
from cellcal.service.engineering.programs.files import RefusedProgram
from cellcal.service.engineering.programs.result import CHANGED, LEFT, UNCHANGED, PointFinding, ProgramResult
from cellcal.service.exit_codes import ExitCode

Figures = NDArray[np.float32]
_TWO_FILES = (".src", ".dat")  # of one KUKA program: motions and points


@dataclass(frozen=True, eq=False)
class ProgramEntry:
    """One program of a report, N points in the order of the file; NaN where unknown."""

    file: str  # the source
    written: str  # where the new one is
    program: str
    brand: str
    points: tuple[str, ...]
    lines: NDArray[np.int64]  # (N,)
    left: NDArray[np.bool_]  # (N,)
    reasons: dict[int, str]  # by row, of what is left
    shift_m: Figures  # (N,)
    turn_rad: Figures
    expected_m: Figures
    uncorrected_m: Figures
    base_place_m: Figures  # (N, 3) of the new tip, where left of the old one
    frame_place_m: Figures  # (N, 3) the same in the user frame that the point is written in
    counts: dict[str, int]
    warnings: tuple[str, ...]
    findings: tuple[PointFinding, ...] = ()


def entry_of(file: str, written: str, result: ProgramResult) -> ProgramEntry:
    """Return the figures of a result; the result itself may go."""
    excluded, base = np.zeros(len(result.status), dtype=bool), result.base_tip_after[:, :3, 3]
    if LEFT in result.status:
        excluded = np.array([status == LEFT for status in result.status], dtype=bool)
        base = np.where(excluded[:, None], result.base_tip_before[:, :3, 3], base)
    return ProgramEntry(
        file=file,
        written=written,
        program=shown_name(result.program_name, file),
        brand=result.before.brand,
        points=result.before.positions.names,
        lines=result.before.positions.lines,
        left=excluded,
        reasons={int(row): result.reason[row] for row in np.flatnonzero(excluded)},
        shift_m=_to_small(result.shift_m),
        turn_rad=_to_small(result.turn_rad),
        expected_m=_to_small(result.expected_error_m),
        uncorrected_m=_to_small(result.uncorrected_m),
        base_place_m=_to_small(base),
        frame_place_m=_to_small(result.after.positions.frame_tip[:, :3, 3]),
        counts=result.status_counts,
        warnings=result.warnings,
        findings=result.findings,
    )


@dataclass(frozen=True, slots=True)
class PointLine:
    """One point of a table."""

    program: str
    point: str
    line: int
    is_excluded: bool
    reason: str
    shift_m: float
    turn_rad: float
    expected_m: float
    uncorrected_m: float


@dataclass
class ProgramsReport:
    """The report of a command on many programs."""

    title: str
    entries: list[ProgramEntry] = field(default_factory=list)
    refused: list[RefusedProgram] = field(default_factory=list)
    unread: tuple[str, ...] = ()  # programs in a form that is not read, whose points stay

    @property
    def status_counts(self) -> dict[str, int]:
        """Return how many points are changed, unchanged and left."""
        found: Counter[str] = Counter()
        for entry in self.entries:
            found.update(entry.counts)
        return {status: found[status] for status in (CHANGED, UNCHANGED, LEFT)}

    @property
    def point_count(self) -> int:
        """Return how many points there are."""
        return sum(self.status_counts.values())

    @property
    def exit_code(self) -> ExitCode:
        """Return what the shell gets to know: a file that is missing is worse than a point that is."""
        if self.refused:
            return ExitCode.FILES_REFUSED
        is_whole = not (self.status_counts[LEFT] or self.finding_count or self.unread)
        return ExitCode.PASS if is_whole else ExitCode.REFUSED

    @property
    def finding_count(self) -> int:
        """Return how many points are off though they are changed."""
        return sum(len(entry.findings) for entry in self.entries)

    def column_values(self, name: str) -> Array:
        """Return a figure of every point, in the order of the entries."""
        parts = [getattr(entry, name) for entry in self.entries]
        return np.concatenate(parts).astype(float) if parts else np.empty(0)

    def worst_first(self, most: int) -> list[PointLine]:
        """Return the points that are left, then those with the largest expected error, or else shift."""
        return [self._point_line(row) for row in self.worst_first_rows()[:most]]

    def worst_first_rows(self) -> NDArray[np.intp]:
        """Return the rows of all points, worst first; equals keep the order of the files."""
        figures = [np.nan_to_num(self.column_values(name), nan=-1.0) for name in ("shift_m", "expected_m")]
        return np.lexsort((*(-figure for figure in figures), ~self.column_values("left").astype(bool)))

    def programs_worst_first(self) -> list[ProgramEntry]:
        """Return the programs with most points left first, then with the largest error or shift."""
        return sorted(
            self.entries,
            key=lambda e: (
                -e.counts[LEFT],
                -len(e.findings),
                -largest_finite(e.expected_m, -1.0),
                -largest_finite(e.shift_m, -1.0),
            ),
        )

    def _point_line(self, row: int) -> PointLine:
        starts = np.cumsum([0, *(len(entry.points) for entry in self.entries)])
        at = int(np.searchsorted(starts, row, side="right")) - 1
        entry, i = self.entries[at], int(row - starts[at])
        return PointLine(
            program=entry.program,
            point=entry.points[i],
            line=int(entry.lines[i]),
            is_excluded=bool(entry.left[i]),
            reason=entry.reasons.get(i, ""),
            shift_m=float(entry.shift_m[i]),
            turn_rad=float(entry.turn_rad[i]),
            expected_m=float(entry.expected_m[i]),
            uncorrected_m=float(entry.uncorrected_m[i]),
        )


def largest_finite(figures: Figures | Array, nothing: float = np.nan) -> float:
    """Return the largest figure that is known."""
    finite = figures[np.isfinite(figures)]
    return float(finite.max()) if len(finite) else nothing


def shown_name(program: str, file: str) -> str:
    """Return a program's name, with its file's where that is called otherwise, or where a program has two files."""
    path = PurePath(file)
    alone = path.stem.casefold() == program.casefold() and path.suffix.lower() not in _TWO_FILES
    return program if alone else f"{program} ({path.name})"


def _to_small(figures: Array) -> Figures:
    return np.asarray(figures, dtype=np.float32)
