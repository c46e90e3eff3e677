"""The process that makes programs: one job, in a folder of its own, progress line by line; nothing is executed.

It ends with its job, or when the service does, however that ends: its input closes.
"""

import json
import logging
import os
import sys
import threading
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path, PurePath
from typing import Any

from cellcal.calibration.compensation.compensate import Direction
from cellcal.calibration.documents.json_text import parse_json
from cellcal.calibration.documents.plain_files import read_plain_bytes, read_plain_text
from cellcal.calibration.errors import CellError
from cellcal.drivers.program_registry import brand_named
from cellcal.drivers.programs.brands import ConfigurationRule
from cellcal.drivers.programs.positions import ProgramFile
from cellcal.service.configuration.cell_file import CellConfig, read_cell_file
from cellcal.service.engineering.programs.clone import cloning
from cellcal.service.engineering.programs.compensate import compensating
from cellcal.service.engineering.programs.files import FilesError, Found, Source, find_programs
from cellcal.service.engineering.programs.inspect import named_by
from cellcal.service.engineering.programs.jobs.cells import cell_here, pose_given
from cellcal.service.engineering.programs.jobs.files import ASKED, OUT, SOURCES, kept_projects
from cellcal.service.engineering.programs.jobs.preview import Made, write_preview
from cellcal.service.engineering.programs.jobs.shapes import MOST_FILE_BYTES
from cellcal.service.engineering.programs.move import change_of_frame, instead_of_moving, moving
from cellcal.service.engineering.programs.project import Project, read_project
from cellcal.service.engineering.programs.report_run import Carry, Wanted, change_programs
from cellcal.service.engineering.programs.report_texts import Language
from cellcal.service.engineering.programs.result import ProgramResult
from cellcal.service.unexpected import log_in_lines, run_guarded

_log = logging.getLogger(__name__)
_AT_ONCE = 1500  # points between two words about progress
_BROKEN = {"message": "The computation failed; the service's log has the cause.", "remedy": ""}


@dataclass(frozen=True, eq=False)
class Task:
    """What a job does: its cell, the cell that gets the programs, and in words."""

    cell: Project
    target: Project
    title: str
    asked: dict[str, Any]

    @classmethod
    def read(cls, config: CellConfig, asked: dict[str, Any]) -> "Task":
        """Read the cells that were asked for.

        Raises
        ------
        CellError
            One of them cannot be used.
        """
        cell = _cell(config, asked["cell"], "cell")
        target = cell if asked["clone"] is None else _cell(config, asked["clone"], "clone")
        if (
            asked["do"] in ("compensate", "download")
            and asked["cell"]["kind"] == "here"
            and not cell.identified
        ):
            raise FilesError(
                f"no parameters of {cell.serial} were saved in this cell.",
                remedy="Calibrate the robot, then save what was found: `cellcal parameters keep`.",
            )
        titles = {
            "compensate": f"Compensated for {target.name}",
            "download": f"Taught in {cell.name}, for the nominal robot",
            "move": f"Moved in {cell.name}",
            "clone": f"{cell.name} cloned to {target.name}",
        }
        return cls(cell, target, titles[asked["do"]], asked)

    def carry(self, rule: ConfigurationRule | None) -> Carry:
        """Return what makes programs of one brand."""
        if self.asked["do"] == "clone":
            return cloning(self.cell, self.target, rule).carry
        if self.asked["do"] == "move":
            frame, joints = self.asked["frame"] or None, self.asked["joints"]
            return moving(self.cell, self._change(), rule, frame=frame, joints=joints).carry
        way = Direction.DOWNLOAD if self.asked["do"] == "download" else Direction.UPLOAD
        return compensating(self.cell, way, rule).carry

    def notes(self) -> list[str]:
        """Return what a person must know beside what the programs say."""
        frame = self.asked["frame"]
        if self.asked["do"] != "move" or not frame:
            return []
        told = instead_of_moving(self.cell, frame, self._change())
        return [told] if told else []

    def _change(self) -> Any:
        offset, frame = pose_given(self.asked["offset"]), self.asked["frame"]
        if not frame:
            return offset
        return change_of_frame(self.cell.frame_named(frame), offset)


def _cell(config: CellConfig, given: dict[str, Any], folder: str) -> Project:
    if given["kind"] == "here":
        return cell_here(config, given)
    if given["kind"] == "carried":
        return read_project(Path(folder) / given["project"])
    return read_project(kept_projects(Path(config.path).parent)[given["name"]][0])


def make(config: CellConfig, asked: dict[str, Any]) -> None:
    """Make what was asked for, in the present folder.

    Raises
    ------
    CellError
        Nothing could be made.
    """
    tell(stage="reading")
    task = Task.read(config, asked)
    found = _found(task)
    told = Path(OUT)
    language = Language.of(asked["language"])
    wanted = Wanted(
        told,
        json=Path("report.json"),
        csv=Path("report.csv"),
        html=Path("report.html"),
        language=language.locale,
    )
    carry = _of_each_brand(task, len(found.sources))
    report = change_programs(found, carry, wanted, task.title, lambda _: None)
    tell(stage="writing")
    write_preview(Made(report, task.cell, task.target, task.notes(), asked, language), Path())


def _found(task: Task) -> Found:
    if task.asked["own_files"]:
        _copy_own(task.cell)
    files = sorted(str(path) for path in Path(SOURCES).rglob("*") if path.is_file())
    if not files:
        return Found((), ())
    found = find_programs(files)
    places = tuple(Source(one.path, PurePath(one.path).relative_to(SOURCES)) for one in found.sources)
    return Found(places, found.refused)


def _copy_own(cell: Project) -> None:
    """Copy the programs that a project names; what is read and reported afterwards is the copy."""
    named = [Path(name) for name in named_by(cell)]
    if sum(path.stat().st_size for path in named) > MOST_FILE_BYTES:
        raise FilesError(
            f"the programs of {cell.name} are larger than {MOST_FILE_BYTES >> 20} MB together.",
            remedy="Make them with `cellcal program` at the service's computer.",
        )
    for path in named:
        inside = path.is_relative_to(cell.path.parent)
        place = Path(SOURCES) / (path.relative_to(cell.path.parent) if inside else path.name)
        place.parent.mkdir(parents=True, exist_ok=True)
        if not place.exists():
            place.write_bytes(read_plain_bytes(path))


def _of_each_brand(task: Task, total: int) -> Carry:
    """Return what makes programs of any brand, a few at once, and tells how many are done."""
    made: dict[str, Carry] = {}
    done = 0
    task.carry(None)  # what the cells lack is said once, and not of every file

    def carry(programs: Sequence[ProgramFile]) -> Sequence[ProgramResult]:
        nonlocal done
        brand = programs[0].brand
        if brand not in made:
            made[brand] = task.carry(brand_named(brand).configurations)
        results: list[ProgramResult] = []
        for some in _some(programs):
            tell(done=done, total=total)
            results += made[brand](some)
            done = min(done + len(some), total)
        tell(done=done, total=total)
        return results

    return carry


def _some(programs: Sequence[ProgramFile]) -> Iterator[list[ProgramFile]]:
    batch: list[ProgramFile] = []
    for program in programs:
        batch.append(program)
        if sum(len(one.positions) for one in batch) >= _AT_ONCE:
            yield batch
            batch = []
    if batch:
        yield batch


def tell(**words: Any) -> None:
    """Write one line to the service."""
    sys.stdout.write(json.dumps(words) + "\n")
    sys.stdout.flush()


def _leave_with_the_service() -> None:
    while os.read(0, 4096):  # past Python's own buffer, which must be free when the interpreter ends
        pass
    os._exit(1)


def main() -> None:
    """Make one job: the cell file and the job's folder are named."""
    log_in_lines()
    threading.Thread(target=_leave_with_the_service, daemon=True).start()
    config = read_cell_file(Path(sys.argv[1]).resolve())
    os.chdir(sys.argv[2])
    try:
        make(config, parse_json(read_plain_text(Path(ASKED))))
    except CellError as error:
        tell(end="failed", message=error.message, remedy=error.remedy)
    except Exception:  # noqa: BLE001  whatever it was, the page is told
        _log.exception("a job of programs broke")
        tell(end="failed", **_BROKEN)
    else:
        tell(end="done")


if __name__ == "__main__":
    sys.exit(run_guarded(main))
