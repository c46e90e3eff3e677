"""Many programs through one change: read, change, write to the new place, tell; one file after another."""

import sys
from collections.abc import Callable, Iterable, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import IO, Protocol

from calibration.errors import CellError
from drivers.program_registry import read_program
from drivers.programs.errors import ProgramFileError
from drivers.programs.positions import ProgramFile
from service.programs.diff import unified_diff
from service.programs.files import FilesError, Found, NewPlace, Refused, Source, read_bytes, whole_file
from service.programs.report import Report, entry_of
from service.programs.report_files import CsvReport, JsonReport
from service.programs.report_html import as_html
from service.programs.result import ProgramResult

STANDARD_OUTPUT = Path("-")


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


class _DiffReport:
    def __init__(self, file: IO[bytes]) -> None:
        self._file = file

    def add(self, source: str, written: str, result: ProgramResult) -> None:
        """Write the difference of a program."""
        before, after = result.before.to_bytes(), result.after.to_bytes()
        self._file.write(unified_diff(before, after, source, written))


def change_programs(
    found: Found,
    change: Callable[[ProgramFile], ProgramResult],
    wanted: Wanted,
    title: str,
    done: Callable[[Source], None],
) -> Report:
    """Change programs one by one and write them and their reports; what is refused stands in the report.

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
        ]
        for source in found.sources:
            try:
                _change_one(source, change, place, report, sinks)
            except CellError as error:
                report.refused.append(Refused.because(source.path, error))
            done(source)
        if told is not None:
            told.end(report)
        page = _opened(wanted.html, wanted, open_files)
        if page is not None:
            page.write(as_html(report).encode(errors="replace"))
    return report


def _change_one(
    source: Source,
    change: Callable[[ProgramFile], ProgramResult],
    place: NewPlace,
    report: Report,
    sinks: Iterable[_Sink],
) -> None:
    place.path_of(source)  # before the work: what cannot be written need not be computed
    program = read_program(str(source.path), read_bytes(source.path))
    result = change(program)
    written = place.write(source, result.after.to_bytes())
    report.entries.append(entry_of(str(source.path), str(written), result))
    for sink in sinks:
        sink.add(str(source.path), str(written), result)


def _check_reports(wanted: Wanted, place: NewPlace) -> None:
    if len({str(path) for path in wanted.reports}) < len(wanted.reports):
        raise FilesError("Two reports would be written to one place.", remedy="Give each its own file.")
    for path in wanted.reports:
        if path == STANDARD_OUTPUT:
            continue
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
