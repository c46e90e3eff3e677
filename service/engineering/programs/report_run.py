"""Many programs through one change: read, change, write to the new place, tell; one file after another."""

import sys
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field
from itertools import islice
from pathlib import Path
from typing import IO, Protocol, TypeAlias

from cellcal.calibration.errors import CellError
from cellcal.calibration.message import make_message
from cellcal.drivers.programs.errors import ProgramFileError
from cellcal.drivers.programs.positions import ProgramFile
from cellcal.service.engineering.programs.batches import process_batch, read_batches
from cellcal.service.engineering.programs.calls_not_given import CallsNotGiven
from cellcal.service.engineering.programs.files import (
    FilesError,
    FoundPrograms,
    OutputFolder,
    ProgramSource,
    RefusedProgram,
    whole_file,
)
from cellcal.service.engineering.programs.report import ProgramEntry, ProgramsReport, entry_of
from cellcal.service.engineering.programs.report_files import ReportFormat, report_formats
from cellcal.service.engineering.programs.report_html import as_html
from cellcal.service.engineering.programs.report_texts import ReportLanguage
from cellcal.service.engineering.programs.result import ProgramResult
from cellcal.service.engineering.programs.shares import share_work
from cellcal.service.engineering.programs.versions import CloneRecord
from cellcal.service.translation import Locale

STANDARD_OUTPUT = Path("-")
TransferPrograms: TypeAlias = Callable[
    [Sequence[ProgramFile]], Sequence[ProgramResult]
]  # of programs of one brand


@dataclass(frozen=True, slots=True)
class ReportOutputs:
    """The places of the new programs and the reports of them; ``-`` is standard output."""

    out: Path
    replace: bool = False
    json: Path | None = None
    csv: Path | None = None
    html: Path | None = None
    diff: Path | None = None
    language: Locale = "en"  # of the page: the other reports are for programs

    def file_of(self, kind: str) -> Path | None:
        """Return where a report goes: csv, json, diff."""
        return {"csv": self.csv, "json": self.json, "diff": self.diff}[kind]

    @property
    def report_paths(self) -> tuple[Path, ...]:
        """Return the reports that are wanted."""
        return tuple(path for path in (self.json, self.csv, self.html, self.diff) if path is not None)

    @property
    def fills_standard_output(self) -> bool:
        """Return whether a report goes to standard output, which then holds nothing else."""
        return STANDARD_OUTPUT in self.report_paths


class ProgramRecorder(Protocol):
    """The further data of every program, written at the end."""

    def made_of(self, source: str, written: str, result: ProgramResult) -> CloneRecord: ...
    def write_records(self, made: Iterable[tuple[str, CloneRecord]]) -> None: ...


@dataclass(frozen=True, eq=False)
class RunExtras:
    """What is done beside changing and reporting."""

    recorder: ProgramRecorder | None = None
    calls: CallsNotGiven | None = None  # what finds calls of programs that are not given


@dataclass(frozen=True, eq=False)
class _WorkPart:
    """The results of some sources."""

    count: int  # of sources
    entries: list[ProgramEntry] = field(default_factory=list)
    refused: list[RefusedProgram] = field(default_factory=list)
    report_lines: list[tuple[bytes, ...]] = field(default_factory=list)  # of each program, in every format
    made: list[tuple[str, CloneRecord]] = field(default_factory=list)  # where it is, and its record


@dataclass(frozen=True, eq=False)
class _ChangeWork:
    """Changes some programs and writes them."""

    change: TransferPrograms
    place: OutputFolder
    formats: Sequence[ReportFormat]
    extras: RunExtras

    def process_sources(self, sources: Sequence[ProgramSource]) -> _WorkPart:
        part = _WorkPart(len(sources))
        # what cannot be written need not be computed: its place is looked at first
        for some in read_batches(sources, self.place.path_of, part.refused):
            done = list(process_batch(some, self.change, part.refused))
            if (calls := self.extras.calls) is not None:
                done = [(read, calls.with_findings(read, result)) for read, result in done]
            places = self.place.write_all([(read.source, result.after.to_bytes()) for read, result in done])
            for (read, result), place in zip(done, places, strict=True):
                if isinstance(place, CellError):
                    part.refused.append(RefusedProgram.from_error(read.source.path, place))
                else:
                    self._add_entry(read.source, str(place), result, part)
        return part

    def _add_entry(self, source: ProgramSource, written: str, result: ProgramResult, part: _WorkPart) -> None:
        part.entries.append(entry_of(str(source.path), written, result))
        part.report_lines.append(tuple(form.one(str(source.path), written, result) for form in self.formats))
        if (also := self.extras.recorder) is not None:
            part.made.append((written, also.made_of(str(source.path), written, result)))


def change_programs(
    found: FoundPrograms,
    change: TransferPrograms,
    outputs: ReportOutputs,
    title: str,
    done: Callable[[ProgramSource], None],
    extras: RunExtras | None = None,
) -> ProgramsReport:
    """Change programs and write them and their reports; what is refused stands in the report.

    Raises
    ------
    FilesError
        A report that would be written over a source, over another report, or over a file that is there; or one
        that there is no room for.
    """
    place = OutputFolder(outputs.out, found.sources, replace=outputs.replace)
    unread = tuple(str(path) for path in found.unread_programs)
    report = ProgramsReport(title, refused=list(found.refused), unread=unread)
    made: list[tuple[str, CloneRecord]] = []
    _check_reports(outputs, place)
    with _whole_reports(outputs), ExitStack() as open_files:
        all_formats = report_formats(title)
        kinds = [kind for kind in all_formats if outputs.file_of(kind) is not None]
        files = [
            _open_report(outputs.file_of(kind), outputs, open_files, all_formats[kind].head) for kind in kinds
        ]
        sources = iter(found.sources)
        work = _ChangeWork(change, place, [all_formats[kind] for kind in kinds], extras or RunExtras())
        for part in share_work(work.process_sources, found.sources):
            for entry, texts in zip(part.entries, part.report_lines, strict=True):
                for file, kind, text in zip(files, kinds, texts, strict=True):
                    file.write(all_formats[kind].between + text if report.entries else text)
                report.entries.append(entry)
            report.refused += part.refused
            made += part.made
            for source in islice(sources, part.count):
                done(source)
        for file, kind in zip(files, kinds, strict=True):
            file.write(all_formats[kind].end(report))
        if work.extras.recorder is not None:
            work.extras.recorder.write_records(made)
        if outputs.html is not None:
            page = as_html(report, ReportLanguage.for_locale(outputs.language))
            _open_report(outputs.html, outputs, open_files, page.encode(errors="replace"))
    return report


@contextmanager
def _whole_reports(outputs: ReportOutputs) -> Iterator[None]:
    """Say of a disk that is full what is whole: programs are, a report is not there."""
    try:
        yield
    except BrokenPipeError:
        raise
    except OSError as error:
        if error.filename is not None:
            raise
        raise FilesError(
            f"A report or the record of the programs cannot be written: {error.strerror}.",
            remedy=f"The programs in {outputs.out} are whole, but not all may be there. Make room and run it again "
            "with --replace.",
        ) from error


def _check_reports(outputs: ReportOutputs, place: OutputFolder) -> None:
    if len({str(path) for path in outputs.report_paths}) < len(outputs.report_paths):
        raise FilesError("Two reports would be written to one place.", remedy="Give each its own file.")
    for path in outputs.report_paths:
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
        if path.is_dir() or (path.exists() and not outputs.replace):
            raise FilesError(
                make_message("{path} is there already.", path=path),
                remedy="Give another name, or say --replace.",
            )
        path.parent.mkdir(parents=True, exist_ok=True)


def _open_report(path: Path | None, outputs: ReportOutputs, open_files: ExitStack, head: bytes) -> IO[bytes]:
    """Open a report and begin it."""
    place = STANDARD_OUTPUT if path is None else path
    opened = _standard_output() if place == STANDARD_OUTPUT else whole_file(place, replace=outputs.replace)
    file = open_files.enter_context(opened)
    file.write(head)
    return file


@contextmanager
def _standard_output() -> Iterator[IO[bytes]]:
    sys.stdout.flush()
    yield sys.stdout.buffer
    sys.stdout.buffer.flush()
