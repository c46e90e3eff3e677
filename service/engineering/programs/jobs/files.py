"""Files of a job: what a page brought along, put into a folder of its own under plain names and no other."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from cellcal.calibration.documents.plain_files import read_plain_text
from cellcal.calibration.documents.toml_text import parse_toml
from cellcal.calibration.errors import CellError
from cellcal.calibration.message import make_message
from cellcal.service.engineering.measured.embedded_files import content_of, plain_name
from cellcal.service.engineering.programs.jobs.shapes import (
    MOST_FILE_BYTES,
    ProgramsFault,
    RefusedFile,
    UploadedFile,
)

PROJECTS = "projects"  # beside the cell file
# of a job's folder; pages of points are called points-<program or all>-<page>.json
SOURCES, OUT, REQUEST_FILE, PREVIEW, ARCHIVE, ALL = (
    "sources", "programs", "asked.json", "preview.json", "programs.zip", "all",
)  # fmt: skip
_SUFFIX = ".toml"
# what a project names by path: its table and key
_NAMED = (("robot", "factory"), ("robot", "parameters"), ("fixture", "alignment"), ("shapes", "file"))
_FOLDERS = (("robot", "parameter_store"), ("robot", "backup"))


class UploadError(CellError):
    """The uploaded files cannot be used."""

    code = "usage"


def write_programs(files: Sequence[UploadedFile], folder: Path) -> list[RefusedFile]:
    """Write program files and return those that cannot be kept; a name is taken once, whatever its case.

    Raises
    ------
    CarriedError
        All together are larger than may be.
    """
    folder.mkdir()
    taken: set[str] = set()
    refused: list[RefusedFile] = []
    size = 0
    for file in files:
        try:
            name, data = _unpack_file(file, taken)
        except CellError as error:
            refused.append(
                RefusedFile(**_fault_of(error).model_dump(), file=file.name[:120], line=0, column=0)
            )
            continue
        size += len(data)
        if size > MOST_FILE_BYTES:
            raise UploadError(
                make_message(
                    "the files are larger than {most_file_bytes} MB together.",
                    most_file_bytes=MOST_FILE_BYTES >> 20,
                ),
                remedy="Make them in several goes, or with `cellcal program` at the service's computer.",
            )
        (folder / name).write_bytes(data)
    return refused


def write_project(files: Sequence[UploadedFile], folder: Path) -> Path:
    """Write a project and the files that it names, and return the project's own; it may name nothing else.

    Raises
    ------
    CarriedError
        Not one project among them, or it names what did not come along.
    """
    folder.mkdir()
    taken: set[str] = set()
    projects: list[tuple[Path, dict[str, Any]]] = []
    for file in files:
        name, data = _unpack_file(file, taken)
        path = folder / name
        path.write_bytes(data)
        table = _read_table(path) if path.suffix.lower() == _SUFFIX else None
        if table is not None and "robot" in table and "format" in table:
            projects.append((path, table))
    if len(projects) != 1:
        raise UploadError(
            make_message(
                "there are {project_count} project files among those that came along.",
                project_count=len(projects),
            ),
            remedy="Choose one project (TOML, with format and [robot]) and the files that it names.",
        )
    path, table = projects[0]
    _refuse_elsewhere(path, table)
    return path


def stored_projects(cell_folder: Path) -> dict[str, tuple[Path, dict[str, Any]]]:
    """Return the projects beside a cell file by their names: ``projects/*.toml`` and ``projects/*/project.toml``."""
    place = cell_folder / PROJECTS
    found: dict[str, tuple[Path, dict[str, Any]]] = {}
    for path in sorted(
        [*place.glob("*.toml"), *place.glob("*/project.toml"), *place.glob("*/*/project.toml")]
    ):
        table = _read_table(path)
        if table is None:
            found[path.parent.name if path.name == "project.toml" else path.stem] = path, {}
        elif "robot" in table and "format" in table:
            name = table.get("name")
            found[name if isinstance(name, str) and name else path.parent.name] = path, table
    return found


def _unpack_file(file: UploadedFile, taken: set[str]) -> tuple[str, bytes]:
    name = plain_name(file.name, "programs")
    if name.casefold() in taken:
        raise UploadError(
            make_message("{name}: another file of that name came along.", name=name),
            remedy="Bring each file once, or in another go.",
        )
    taken.add(name.casefold())
    return name, content_of(file.content_base64, name)


def _refuse_elsewhere(path: Path, table: dict[str, Any]) -> None:
    """Refuse a project that names anything but the files beside it: who looks from afar may not read others."""
    for section, key in (*_NAMED, *_FOLDERS):
        named = table.get(section)
        value = named.get(key) if isinstance(named, dict) else None
        if value is None:
            continue
        if (section, key) in _FOLDERS:
            raise UploadError(
                make_message(
                    "{path_name}: {key} under [{section}] is a folder of the service's computer.",
                    path_name=path.name,
                    key=key,
                    section=section,
                ),
                remedy="Name one file that comes along, or keep the project beside the cell file.",
            )
        if not isinstance(value, str) or Path(value).name != value or not (path.parent / value).is_file():
            raise UploadError(
                make_message(
                    "{path_name}: {key} under [{section}] names {value!r}, which did not come along.",
                    path_name=path.name,
                    key=key,
                    section=section,
                    value=str(value)[:80],
                ),
                remedy="Choose it together with the project; it must be named without a folder.",
            )


def _read_table(path: Path) -> dict[str, Any] | None:
    try:
        return parse_toml(read_plain_text(path))
    except (OSError, ValueError):
        return None


def _fault_of(error: CellError) -> ProgramsFault:
    return ProgramsFault(message=error.message, remedy=error.remedy)
