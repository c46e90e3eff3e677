"""Many programs through one change: read, change, write to the new place, tell; one file after another."""

import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import IO, Protocol, TypeAlias

from calibration.errors import CellError
from drivers.programs.errors import ProgramFileError
from drivers.programs.positions import ProgramFile
from service.programs.batches import batches, together
from service.programs.diff import unified_diff
from service.programs.files import FilesError, Found, NewPlace, Refused, Source, whole_file
from service.programs.report import Report, entry_of
from service.programs.report_files import CsvReport, JsonReport
from service.programs.report_html import as_html
from service.programs.result import ProgramResult

STANDARD_OUTPUT = Path("-")
Carry: TypeAlias = Callable[[Sequence[ProgramFile]], Sequence[ProgramResult]]  # of programs of one brand


@dataclass(frozen=True, slots=True)
class Wanted:
    """Where the new programs and the reports of them go; ``-`` is standard output."""

    out: Path
    replace: bool = False
    json: Path | None = None
    csv: Path | None = None
    html: Path | None = None
    diff: Path | None = None

    @property
    def reports(self) -> tuple[Path, ...]:
        """Return the reports that are wanted."""
        return tuple(path for path in (self.json, self.csv, self.html, self.diff) if path is not None)

    @property
    def fills_standard_output(self) -> bool:
        """Tell whether a report goes to standard output, which then holds nothing else."""
        return STANDARD_OUTPUT in self.reports


class _Sink(Protocol):
    def add(self, source: str, written: str, result: ProgramResult) -> None: ...


class Recording(_Sink, Protocol):
    """What else is kept of every program, and written at the end."""

    def end(self) -> None: ...


class _DiffReport:
    def __init__(self, file: IO[bytes]) -> None:
        self._file = file

    def add(self, source: str, written: str, result: ProgramResult) -> None:
        """Write the difference of a program."""
        before, after = result.before.to_bytes(), result.after.to_bytes()
        self._file.write(unified_diff(before, after, source, written))


def change_programs(
    found: Found,
    change: Carry,
    wanted: Wanted,
    title: str,
    done: Callable[[Source], None],
    also: Recording | None = None,
) -> Report:
    """Change programs, some at once, and write them and their reports; what is refused stands in the report.

    Raises
    ------
    FilesError
        A report that would be written over a source, over another report, or over a file that is there.
    """
    place = NewPlace(wanted.out, found.sources, replace=wanted.replace)
    report = Report(title, refused=list(found.refused))
    _check_reports(wanted, place)
    with ExitStack() as open_files:
        csv, json, diff = (
            _opened(path, wanted, open_files) for path in (wanted.csv, wanted.json, wanted.diff)
        )
        told = None if json is None else JsonReport(json, title)
        sinks: list[_Sink] = [
            *([] if csv is None else [CsvReport(csv)]),
            *([] if told is None else [told]),
            *([] if diff is None else [_DiffReport(diff)]),
            *([] if also is None else [also]),
        ]
        keep = _Keeper(place, report, sinks)
        # what cannot be written need not be computed: its place is looked at first
        for some in batches(found.sources, place.path_of, report.refused):
            for read, result in together(some, change, report.refused):
                keep.keep(read.source, result)
            for read in some:
                done(read.source)
        if also is not None:
            also.end()
        if told is not None:
            told.end(report)
        page = _opened(wanted.html, wanted, open_files)
        if page is not None:
            page.write(as_html(report).encode(errors="replace"))
    return report


@dataclass(frozen=True, eq=False)
class _Keeper:
    """Writes a result, and tells it to every report."""

    place: NewPlace
    report: Report
    sinks: Sequence[_Sink]

    def keep(self, source: Source, result: ProgramResult) -> None:
        try:
            written = self.place.write(source, result.after.to_bytes())
        except CellError as error:
            self.report.refused.append(Refused.because(source.path, error))
            return
        self.report.entries.append(entry_of(str(source.path), str(written), result))
        for sink in self.sinks:
            sink.add(str(source.path), str(written), result)


def _check_reports(wanted: Wanted, place: NewPlace) -> None:
    if len({str(path) for path in wanted.reports}) < len(wanted.reports):
        raise FilesError("Two reports would be written to one place.", remedy="Give each its own file.")
    for path in wanted.reports:
        if path == STANDARD_OUTPUT:
            continue
        if path.name.startswith("-"):
            raise FilesError(
                f"{path} is no name for a report.", remedy="Give a file, or - for standard output."
            )
        try:
            place.refuse_source(path)
        except ProgramFileError as error:
            raise FilesError(error.message, remedy="Give the report another name.") from error
        if path.is_dir() or (path.exists() and not wanted.replace):
            raise FilesError(f"{path} is there already.", remedy="Give another name, or say --replace.")
        path.parent.mkdir(parents=True, exist_ok=True)


def _opened(path: Path | None, wanted: Wanted, open_files: ExitStack) -> IO[bytes] | None:
    if path is None:
        return None
    if path == STANDARD_OUTPUT:
        return open_files.enter_context(_standard_output())
    return open_files.enter_context(whole_file(path, replace=wanted.replace))


@contextmanager
def _standard_output() -> Iterator[IO[bytes]]:
    sys.stdout.flush()
    yield sys.stdout.buffer
    sys.stdout.buffer.flush()
