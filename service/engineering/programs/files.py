"""Program files as they are named on the command line, and the new place that the changed ones are written to.

A source is never written. What cannot be used is refused by name with the cure; the other files go on.
"""

import os
from collections import defaultdict
from collections.abc import Iterable, Iterator, Sequence, Set
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field, replace
from itertools import takewhile
from pathlib import Path, PurePath
from typing import IO

from cellcal.calibration.documents import DocumentError
from cellcal.calibration.documents.errors import NotDownloadedError
from cellcal.calibration.documents.plain_files import read_plain_bytes
from cellcal.calibration.errors import CellError
from cellcal.calibration.message import find_message, make_message
from cellcal.drivers.program_registry import (
    SUFFIXES,
    UNREAD_FORMS,
    brand_of,
    brand_of_list,
    is_resaved_program,
)
from cellcal.drivers.programs.brands import DeclaringProgram
from cellcal.drivers.programs.cross_file_uses import BatchDeclarations
from cellcal.drivers.programs.errors import ProgramFileError
from cellcal.service.draft_files import draft_beside, remove_left_behind
from cellcal.service.engineering.programs.folders import paths_below
from cellcal.service.files import name_new_file

LARGEST_BYTES = 64 << 20  # no controller keeps a program of this size: what is larger is not one
_UNREAD_PROGRAMS = UNREAD_FORMS.keys() - {".kl"}  # KAREL: functions, as a rule without a place of the robot
_YASKAWA_VARIABLES = "var.dat"  # also places of a controller's jobs
_WRITERS = 8
_WILD = frozenset("*?[")


class FilesError(CellError):
    """A folder or file of programs cannot be used at all."""

    code = "usage"


@dataclass(eq=False)
class Siblings:
    """The programs that were named together, and what they say of each other once it was read."""

    sources: tuple["ProgramSource", ...] = ()
    across: BatchDeclarations | None = None
    lists: dict[Path, str] = field(
        default_factory=dict
    )  # of their controller, named with them, and the brand
    routines: dict[str, frozenset[str]] = field(default_factory=dict)  # by brand, once looked for
    looks_above: bool = True  # lists of a backup count that stand in folders above
    # of a small batch: programs not asked for yet
    read: dict[str, DeclaringProgram] = field(default_factory=dict)


@dataclass(frozen=True, slots=True)
class ProgramSource:
    """One program file, and its place below any folder that it is written to."""

    path: Path
    place: PurePath
    siblings: Siblings | None = field(default=None, compare=False, repr=False)


@dataclass(frozen=True, slots=True)
class RefusedProgram:
    """A file that was left out, why, and the cure."""

    file: str
    message: str
    remedy: str

    @classmethod
    def from_error(cls, file: object, error: CellError) -> "RefusedProgram":
        """Return what an error says about a file, without the file's name twice."""
        message, name = error.message, str(file)
        reason = message.removeprefix(name).lstrip(":").strip() if message.startswith(name) else message
        return cls(name, find_message(reason) or reason, error.remedy)


@dataclass(frozen=True, slots=True)
class FoundPrograms:
    """Sources in the order of their names, and what was named but cannot be used."""

    sources: tuple[ProgramSource, ...]
    refused: tuple[RefusedProgram, ...]
    passed_over: tuple[Path, ...] = ()  # below a folder: with a program's suffix and none inside, or not read

    @property
    def unread_programs(self) -> tuple[Path, ...]:
        """Return programs below a folder in a form that is not read: their points stay where they are."""
        return tuple(path for path in self.passed_over if path.suffix.lower() in _UNREAD_PROGRAMS)


def find_programs(named: Sequence[str], *, out: Path | None = None) -> FoundPrograms:
    """Return the programs that files, patterns and folders name; a folder gives those of its subfolders too.

    A file that is named is always a source, whatever it is. Below a folder, other files are passed over, and so
    is ``out``, where an earlier run wrote. A pattern passes over what has a program's suffix and none inside, as the
    logs of a whole backup beside its listings.
    """
    if not named:
        raise FilesError("No program was named.", remedy="Name files, folders, or patterns in quotes.")
    sources: dict[str, ProgramSource] = {}
    refused: list[RefusedProgram] = []
    passed: list[Path] = []
    real_folders: dict[Path, str] = {}  # of thousands of files in a few folders
    for name in named:
        try:
            for source in _of_name(name, out, passed):
                sources.setdefault(_resolve_path(source.path, real_folders), source)
        except ProgramFileError as error:
            refused.append(RefusedProgram.from_error(name, error))
        except OSError as error:
            refused.append(
                RefusedProgram(name, f"{error.strerror or error}.", "Give a folder that may be read.")
            )
    apart, clashing = _without_clashes(sources.values())
    lists = {one.path: brand.brand for one in apart if (brand := brand_of_list(one.path.name)) is not None}
    siblings = Siblings(lists=lists)
    siblings.sources = tuple(replace(one, siblings=siblings) for one in apart if one.path not in lists)
    return FoundPrograms(siblings.sources, (*refused, *clashing), tuple(passed))


def _resolve_path(path: Path, real_folders: dict[Path, str]) -> str:
    """Return a file's place without symbolic links; its folder's is looked up once."""
    if path.is_symlink():
        return os.path.realpath(path)
    folder = path.parent
    if folder not in real_folders:
        real_folders[folder] = os.path.realpath(folder)
    return f"{real_folders[folder]}{os.sep}{path.name}"


def read_bytes(path: Path) -> bytes:
    """Return a program file's bytes.

    Raises
    ------
    ProgramFileError
        It cannot be read, is empty, or larger than any program.
    """
    try:
        data = read_plain_bytes(path, LARGEST_BYTES)
    except NotDownloadedError as error:
        raise ProgramFileError(str(path), error.why, remedy=error.remedy) from error
    except DocumentError as error:
        raise ProgramFileError(
            str(path), error.why, remedy="Give the program itself, not an archive or a backup image."
        ) from error
    except OSError as error:
        raise ProgramFileError(
            str(path),
            make_message("it cannot be read: {strerror}.", strerror=error.strerror),
            remedy="Give a file that may be read.",
        ) from error
    if not data:
        raise ProgramFileError(
            str(path), "the file is empty.", remedy="Save the program from the controller again."
        )
    return data


class OutputFolder:
    """A folder that programs are written to, whole or not at all, and never over a source."""

    def __init__(self, folder: Path, sources: Iterable[ProgramSource], *, replace: bool = False) -> None:
        self._folder, self._replace = folder, replace
        self._source_identities = {_file_identity(source.path) for source in sources}
        self._made: set[Path] = set()  # folders that are there
        if folder.exists() and not folder.is_dir():
            raise FilesError(f"{folder} is a file.", remedy="Give --out a folder.")
        remove_left_behind(folder)

    def path_of(self, source: ProgramSource) -> Path:
        """Return where a program goes.

        Raises
        ------
        ProgramFileError
            A source is there, or another file that shall not be replaced.
        """
        path = self._folder / source.place
        if os.path.lexists(path):
            self.refuse_source(path)
            if not self._replace:
                raise ProgramFileError(
                    str(source.path),
                    make_message("{path} is there already.", path=path),
                    remedy="Write to another folder, or say --replace.",
                )
        return path

    def refuse_source(self, path: Path) -> None:
        """Refuse a path that is one of the sources, by whatever name.

        Raises
        ------
        ProgramFileError
            It is one.
        """
        if path.exists() and _file_identity(path) in self._source_identities:
            raise ProgramFileError(
                str(path),
                "this is a source, and a source is never written over.",
                remedy="Give another folder with --out.",
            )

    def write_all(self, programs: Sequence[tuple[ProgramSource, bytes]]) -> list[Path | ProgramFileError]:
        """Write programs and return where each is, or why it is not; while one waits for the disk, others go on."""
        with ThreadPoolExecutor(min(_WRITERS, max(len(programs), 1))) as writers:
            return list(writers.map(lambda one: self._write_or_error(*one), programs))

    def _write_or_error(self, source: ProgramSource, data: bytes) -> Path | ProgramFileError:
        try:
            return self.write_program(source, data)
        except ProgramFileError as error:
            return error

    def write_program(self, source: ProgramSource, data: bytes) -> Path:
        """Write a program and return where it is."""
        path = self.path_of(source)
        try:
            if path.parent not in self._made:
                path.parent.mkdir(parents=True, exist_ok=True)
                self._made.add(path.parent)
            with whole_file(path, replace=self._replace) as file:
                file.write(data)
        except OSError as error:
            raise ProgramFileError(
                str(source.path),
                make_message("{path} cannot be written: {strerror}.", path=path, strerror=error.strerror),
                remedy="Give --out a folder that may be written, with room on its disk.",
            ) from error
        return path


@contextmanager
def whole_file(path: Path, *, replace: bool) -> Iterator[IO[bytes]]:
    """Give a file to write to that is at its place when all went well; without ``replace``, what has come is kept.

    Raises
    ------
    OSError
        It cannot be written, or (FileExistsError) is there already.
    """
    draft = draft_beside(path)
    try:
        with open(draft, "xb") as file:  # noqa: PTH123
            yield file
            file.flush()
            os.fsync(file.fileno())
            os.chmod(draft, 0o644)  # noqa: PTH101
        if replace:
            os.replace(draft, path)  # noqa: PTH105
        else:
            name_new_file(Path(draft), path)
    finally:
        with suppress(FileNotFoundError):
            os.unlink(draft)  # noqa: PTH108


def _of_name(name: str, out: Path | None, passed: list[Path]) -> list[ProgramSource]:
    path = Path(name)
    if path.is_file():
        return [ProgramSource(path, PurePath(path.name))]
    if path.is_dir():
        return _sources_below(path, out, passed)
    if path.exists():
        return [_single_source(path)]
    if not _WILD & set(name):
        raise ProgramFileError(name, "there is no such file or folder.", remedy="Mend the name.")
    base = Path(path.anchor)
    pattern = str(path.relative_to(base)) if path.anchor else name
    fixed = Path(*takewhile(lambda part: not _WILD & set(part), path.parts))
    found = [
        item
        for item in sorted(base.glob(pattern))
        if item.is_file() and not _is_earlier_output(item, fixed, out)
    ]
    if not found:
        raise ProgramFileError(name, "no file matches this pattern.", remedy="Mend the pattern.")
    logs = [item for item in found if is_log(item)]
    if len(logs) == len(found):
        return [_single_source(item) for item in found]
    passed += logs
    return [_single_source(item) for item in found if item not in logs]


def _single_source(path: Path) -> ProgramSource:
    if not path.is_file():  # a pipe or a device would be waited for
        raise ProgramFileError(str(path), "this is not an ordinary file.", remedy="Name a program file.")
    return ProgramSource(path, PurePath(path.name))


def _sources_below(folder: Path, out: Path | None, passed: list[Path]) -> list[ProgramSource]:
    suffixes, paths = _suffixes(), paths_below(folder)
    named = [
        path
        for path in paths
        if path.suffix.lower() in suffixes and not _is_earlier_output(path, folder, out) and path.is_file()
    ]
    found = [ProgramSource(path, path.relative_to(folder)) for path in named if _is_program(path)]
    taken = {source.path for source in found}
    passed += [path for path in named if path not in taken]
    unread = _unread_programs(paths, {path.with_suffix("") for path in taken})
    passed += unread
    if not found and not unread:
        raise ProgramFileError(
            str(folder),
            "there is no robot program in this folder.",
            remedy=make_message("Programs end in {suffixes}.", suffixes=", ".join(sorted(suffixes))),
        )
    # Where there are only these, each says what it is, and how it is saved as text.
    return found or [_single_source(path) for path in unread]


def is_log(path: Path) -> bool:
    """Return whether a file has a program's suffix and none inside, as the logs of a controller's whole backup."""
    return path.suffix.lower() in _suffixes() and not _is_program(path)


def _suffixes() -> set[str]:
    return {suffix for its in SUFFIXES.values() for suffix in its}


def holds_unread_places(path: Path) -> bool:
    """Return whether a file that was passed over may hold places of the robot, in a form that is not read."""
    return path.suffix.lower() in UNREAD_FORMS or path.name.lower() == _YASKAWA_VARIABLES


def _unread_programs(paths: Iterable[Path], listed: Set[Path]) -> list[Path]:
    """Return programs in a form that is not read, beside which their listing does not stand."""
    listed_paths = {str(path).casefold() for path in listed}
    return [
        path
        for path in paths
        if path.suffix.lower() in UNREAD_FORMS
        and str(path.with_suffix("")).casefold() not in listed_paths
        and not path.name.startswith("-")  # what the controller's background editor keeps
        and path.is_file()
    ]


def _is_program(path: Path) -> bool:
    """Return whether a brand takes a file.

    One that cannot be read, or that an editor saved in another encoding, is a source: it is refused by name.
    """
    try:
        data = read_bytes(path)
        return brand_of(path.name, data) is not None or is_resaved_program(path.name, data)
    except ProgramFileError:
        return True


def _is_earlier_output(path: Path, folder: Path, out: Path | None) -> bool:
    """Return whether a file below a folder was written by an earlier run, to a folder inside it."""
    if out is None:
        return False
    there = out.resolve()
    inside = there != folder.resolve() and there.is_relative_to(folder.resolve())
    return inside and path.resolve().is_relative_to(there)


def _without_clashes(sources: Iterable[ProgramSource]) -> tuple[list[ProgramSource], list[RefusedProgram]]:
    """Refuse files that would be written to one place; controllers do not tell upper from lower case."""
    by_place: defaultdict[str, list[ProgramSource]] = defaultdict(list)
    for source in sources:
        by_place[str(source.place).casefold()].append(source)
    refused = [
        RefusedProgram(
            str(source.path),
            f"{next(o.path for o in same if o is not source)} has the same name, and one place cannot hold both.",
            "Name the folder above both, which keeps the subfolders, or run them one after the other.",
        )
        for same in by_place.values()
        if len(same) > 1
        for source in same
    ]
    return [same[0] for same in by_place.values() if len(same) == 1], refused


def _file_identity(path: Path) -> tuple[int, int]:
    found = path.stat()
    return found.st_dev, found.st_ino
