"""Many programs through one change: read, change, write to the new place, tell; one file after another."""

import sys
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field
from itertools import islice
from pathlib import Path
from typing import IO, Protocol, TypeAlias

from cellcal.calibration.errors import CellError
from cellcal.drivers.programs.errors import ProgramFileError
from cellcal.drivers.programs.positions import ProgramFile
from cellcal.service.engineering.programs.batches import batches, together
from cellcal.service.engineering.programs.files import (
    FilesError,
    Found,
    NewPlace,
    Refused,
    Source,
    whole_file,
)
from cellcal.service.engineering.programs.report import ProgramEntry, Report, entry_of
from cellcal.service.engineering.programs.report_files import Format, formats
from cellcal.service.engineering.programs.report_html import as_html
from cellcal.service.engineering.programs.report_texts import Language
from cellcal.service.engineering.programs.result import ProgramResult
from cellcal.service.engineering.programs.shares import shared_out
from cellcal.service.engineering.programs.versions import Made
from cellcal.service.translation import Locale

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
    language: Locale = "en"  # of the page: the other reports are for programs

    def file_of(self, kind: str) -> Path | None:
        """Return where a report goes: csv, json, diff."""
        return {"csv": self.csv, "json": self.json, "diff": self.diff}[kind]

    @property
    def reports(self) -> tuple[Path, ...]:
        """Return the reports that are wanted."""
        return tuple(path for path in (self.json, self.csv, self.html, self.diff) if path is not None)

    @property
    def fills_standard_output(self) -> bool:
        """Tell whether a report goes to standard output, which then holds nothing else."""
        return STANDARD_OUTPUT in self.reports


class Recording(Protocol):
    """What else is kept of every program, and written at the end."""

    def made_of(self, source: str, written: str, result: ProgramResult) -> Made: ...
    def end(self, made: Iterable[tuple[str, Made]]) -> None: ...


@dataclass(frozen=True, eq=False)
class _Part:
    """What became of some sources."""

    count: int  # of sources
    entries: list[ProgramEntry] = field(default_factory=list)
    refused: list[Refused] = field(default_factory=list)
    told: list[tuple[bytes, ...]] = field(default_factory=list)  # of each program, in every format
    made: list[tuple[str, Made]] = field(default_factory=list)  # where it is, and its record


@dataclass(frozen=True, eq=False)
class _Work:
    """Changes some programs and writes them."""

    change: Carry
    place: NewPlace
    formats: Sequence[Format]
    also: Recording | None

    def run(self, sources: Sequence[Source]) -> _Part:
        part = _Part(len(sources))
        # what cannot be written need not be computed: its place is looked at first
        for some in batches(sources, self.place.path_of, part.refused):
            done = list(together(some, self.change, part.refused))
            places = self.place.write_all([(read.source, result.after.to_bytes()) for read, result in done])
            for (read, result), place in zip(done, places, strict=True):
                if isinstance(place, CellError):
                    part.refused.append(Refused.because(read.source.path, place))
                else:
                    self._keep(read.source, str(place), result, part)
        return part

    def _keep(self, source: Source, written: str, result: ProgramResult, part: _Part) -> None:
        part.entries.append(entry_of(str(source.path), written, result))
        part.told.append(tuple(form.one(str(source.path), written, result) for form in self.formats))
        if self.also is not None:
            part.made.append((written, self.also.made_of(str(source.path), written, result)))


def change_programs(
    found: Found,
    change: Carry,
    wanted: Wanted,
    title: str,
    done: Callable[[Source], None],
    also: Recording | None = None,
) -> Report:
    """Change programs and write them and their reports; what is refused stands in the report.

    Raises
    ------
    FilesError
        A report that would be written over a source, over another report, or over a file that is there; or one
        that there is no room for.
    """
    place = NewPlace(wanted.out, found.sources, replace=wanted.replace)
    report = Report(title, refused=list(found.refused))
    made: list[tuple[str, Made]] = []
    _check_reports(wanted, place)
    with _whole_reports(wanted), ExitStack() as open_files:
        told = formats(title)
        kinds = [kind for kind in told if wanted.file_of(kind) is not None]
        files = [_opened(wanted.file_of(kind), wanted, open_files, told[kind].head) for kind in kinds]
        sources = iter(found.sources)
        work = _Work(change, place, [told[kind] for kind in kinds], also)
        for part in shared_out(work.run, found.sources):
            for entry, texts in zip(part.entries, part.told, strict=True):
                for file, kind, text in zip(files, kinds, texts, strict=True):
                    file.write(told[kind].between + text if report.entries else text)
                report.entries.append(entry)
            report.refused += part.refused
            made += part.made
            for source in islice(sources, part.count):
                done(source)
        for file, kind in zip(files, kinds, strict=True):
            file.write(told[kind].end(report))
        if also is not None:
            also.end(made)
        if wanted.html is not None:
            page = as_html(report, Language.of(wanted.language))
            _opened(wanted.html, wanted, open_files, page.encode(errors="replace"))
    return report


@contextmanager
def _whole_reports(wanted: Wanted) -> Iterator[None]:
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
            remedy=f"The programs in {wanted.out} are whole, but not all may be there. Make room and run it again "
            "with --replace.",
        ) from error


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


def _opened(path: Path | None, wanted: Wanted, open_files: ExitStack, head: bytes) -> IO[bytes]:
    """Open a report and begin it."""
    place = STANDARD_OUTPUT if path is None else path
    opened = _standard_output() if place == STANDARD_OUTPUT else whole_file(place, replace=wanted.replace)
    file = open_files.enter_context(opened)
    file.write(head)
    return file


@contextmanager
def _standard_output() -> Iterator[IO[bytes]]:
    sys.stdout.flush()
    yield sys.stdout.buffer
    sys.stdout.buffer.flush()
