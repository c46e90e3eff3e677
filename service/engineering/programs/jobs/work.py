"""The process that makes programs: one job, in a folder of its own, progress line by line; nothing is executed.

It ends with its job, or when the service does, however that ends: its input closes.
"""

import logging
import os
import sys
import threading
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path, PurePath
from typing import Any

from cellcal.calibration.compensation.compensate import ProgramDirection
from cellcal.calibration.documents.json_text import parse_json
from cellcal.calibration.documents.plain_files import read_plain_bytes, read_plain_text
from cellcal.calibration.message import make_message
from cellcal.drivers.program_registry import brand_named
from cellcal.drivers.programs.brands import ConfigurationRule
from cellcal.drivers.programs.positions import ProgramFile
from cellcal.service.configuration.cell_file import CellConfig, read_cell_file
from cellcal.service.engineering.job_processes import finish_job, leave_with_the_service, write_message
from cellcal.service.engineering.programs.calls_not_given import CallsNotGiven
from cellcal.service.engineering.programs.clone import clone_transfer
from cellcal.service.engineering.programs.compensate import compensation_transfer
from cellcal.service.engineering.programs.files import FilesError, FoundPrograms, find_programs
from cellcal.service.engineering.programs.inspect import find_named_programs
from cellcal.service.engineering.programs.jobs.cells import cell_here, pose_from_json
from cellcal.service.engineering.programs.jobs.files import OUT, REQUEST_FILE, SOURCES, stored_projects
from cellcal.service.engineering.programs.jobs.limits import Limits
from cellcal.service.engineering.programs.jobs.preview import JobResult, write_preview
from cellcal.service.engineering.programs.jobs.shapes import MOST_FILE_BYTES
from cellcal.service.engineering.programs.move import change_of_frame, instead_of_moving, move_transfer
from cellcal.service.engineering.programs.project import Project, read_project
from cellcal.service.engineering.programs.report_run import (
    ReportOutputs,
    RunExtras,
    TransferPrograms,
    change_programs,
)
from cellcal.service.engineering.programs.report_texts import ReportLanguage
from cellcal.service.engineering.programs.result import ProgramResult
from cellcal.service.unexpected_errors import log_in_lines, run_guarded

_log = logging.getLogger(__name__)
_AT_ONCE = 1500  # points between two words about progress


@dataclass(frozen=True, eq=False)
class ProgramTask:
    """The task of a job: its cell, the cell that gets the programs, and in words."""

    cell: Project
    target: Project
    title: str
    request: dict[str, Any]

    @classmethod
    def from_request(cls, config: CellConfig, request: dict[str, Any]) -> "ProgramTask":
        """Read the cells that were asked for.

        Raises
        ------
        CellError
            One of them cannot be used.
        """
        cell = _read_cell(config, request["cell"], "cell")
        target = cell if request["clone"] is None else _read_cell(config, request["clone"], "clone")
        if (
            request["do"] in ("compensate", "download")
            and request["cell"]["kind"] == "here"
            and not cell.identified
        ):
            raise FilesError(
                make_message("no parameters of {serial} were saved in this cell.", serial=cell.serial),
                remedy="Save what a file of measurements shows on the page Measurements, or what a calibration "
                "found: `cellcal parameters keep`.",
            )
        titles = {
            "compensate": make_message("Compensated for {cell_name}", cell_name=target.name),
            "download": make_message("Taught in {cell_name}, for the nominal robot", cell_name=cell.name),
            "move": make_message("Moved in {cell_name}", cell_name=cell.name),
            "clone": make_message(
                "{source_name} cloned to {cell_name}", source_name=cell.name, cell_name=target.name
            ),
        }
        return cls(cell, target, titles[request["do"]], request)

    def make_transfer(self, rule: ConfigurationRule | None) -> TransferPrograms:
        """Return what makes programs of one brand."""
        if self.request["do"] == "clone":
            return clone_transfer(self.cell, self.target, rule).transfer_programs
        if self.request["do"] == "move":
            frame, joints = self.request["frame"] or None, self.request["joints"]
            return move_transfer(
                self.cell, self._work_change(), rule, frame=frame, joints=joints
            ).transfer_programs
        way = ProgramDirection.DOWNLOAD if self.request["do"] == "download" else ProgramDirection.UPLOAD
        return compensation_transfer(self.cell, way, rule).transfer_programs

    def find_calls_not_given(self) -> CallsNotGiven | None:
        """Return what finds calls of programs that are not given; nothing where no point changes."""
        without_motion = self.cell.programs_without_motion
        if self.request["do"] == "clone":
            return CallsNotGiven.for_clone(without_motion)
        if self.request["do"] == "move":
            return CallsNotGiven.for_move(self._work_change(), without_motion)
        return CallsNotGiven.for_compensation(without_motion)

    def list_notes(self) -> list[str]:
        """Return what a person must know beside what the programs say."""
        frame = self.request["frame"]
        if self.request["do"] != "move" or not frame:
            return []
        advice = instead_of_moving(self.cell, frame, self._work_change())
        return [advice] if advice else []

    def _work_change(self) -> Any:
        offset, frame = pose_from_json(self.request["offset"]), self.request["frame"]
        if not frame:
            return offset
        return change_of_frame(self.cell.frame_named(frame), offset)


def _read_cell(config: CellConfig, cell_input: dict[str, Any], folder: str) -> Project:
    if cell_input["kind"] == "here":
        return cell_here(config, cell_input)
    if cell_input["kind"] == "carried":
        return read_project(Path(folder) / cell_input["project"])
    return read_project(stored_projects(Path(config.path).parent)[cell_input["name"]][0])


def make_programs(config: CellConfig, request: dict[str, Any]) -> None:
    """Make what was asked for, in the present folder.

    Raises
    ------
    CellError
        Nothing could be made.
    """
    write_message(stage="reading")
    task = ProgramTask.from_request(config, request)
    found = _find_programs(task)
    out_folder = Path(OUT)
    language = ReportLanguage.for_locale(request["language"])
    outputs = ReportOutputs(
        out_folder,
        json=Path("report.json"),
        csv=Path("report.csv"),
        html=Path("report.html"),
        language=language.locale,
    )
    carry = _of_each_brand(task, len(found.sources))
    extras = RunExtras(calls=task.find_calls_not_given())
    report = change_programs(found, carry, outputs, task.title, lambda _: None, extras)
    write_message(stage="writing")
    write_preview(JobResult(report, task.cell, task.target, task.list_notes(), request, language), Path())


def _find_programs(task: ProgramTask) -> FoundPrograms:
    if task.request["own_files"]:
        _copy_own(task.cell)
    files = sorted(str(path) for path in Path(SOURCES).rglob("*") if path.is_file())
    if not files:
        return FoundPrograms((), ())
    found = find_programs(files)
    places = tuple(replace(one, place=PurePath(one.path).relative_to(SOURCES)) for one in found.sources)
    for siblings in {id(one.siblings): one.siblings for one in places if one.siblings is not None}.values():
        siblings.looks_above = False  # there stand the service's own files
    return FoundPrograms(places, found.refused)


def _copy_own(cell: Project) -> None:
    """Copy the programs that a project names; what is read and reported afterwards is the copy."""
    named = [Path(name) for name in find_named_programs(cell)]
    if sum(path.stat().st_size for path in named) > MOST_FILE_BYTES:
        raise FilesError(
            make_message(
                "the programs of {cell_name} are larger than {most_file_bytes} MB together.",
                cell_name=cell.name,
                most_file_bytes=MOST_FILE_BYTES >> 20,
            ),
            remedy="Make them with `cellcal program` at the service's computer.",
        )
    for path in named:
        inside = path.is_relative_to(cell.path.parent)
        place = Path(SOURCES) / (path.relative_to(cell.path.parent) if inside else path.name)
        place.parent.mkdir(parents=True, exist_ok=True)
        if not place.exists():
            place.write_bytes(read_plain_bytes(path))


def _of_each_brand(task: ProgramTask, total: int) -> TransferPrograms:
    """Return what makes programs of any brand, a few at once, and tells how many are done."""
    made: dict[str, TransferPrograms] = {}
    done = 0
    task.make_transfer(None)  # what the cells lack is said once, and not of every file

    def transfer_programs(programs: Sequence[ProgramFile]) -> Sequence[ProgramResult]:
        nonlocal done
        brand = programs[0].brand
        if brand not in made:
            made[brand] = task.make_transfer(brand_named(brand).configurations)
        results: list[ProgramResult] = []
        for some in _small_groups(programs):
            write_message(done=done, total=total)
            results += made[brand](some)
            done = min(done + len(some), total)
        write_message(done=done, total=total)
        return results

    return transfer_programs


def _small_groups(programs: Sequence[ProgramFile]) -> Iterator[list[ProgramFile]]:
    batch: list[ProgramFile] = []
    for program in programs:
        batch.append(program)
        if sum(len(one.positions) for one in batch) >= _AT_ONCE:
            yield batch
            batch = []
    if batch:
        yield batch


def main() -> None:
    """Make one job: the cell file and the job's folder are named, and the limits of this process."""
    log_in_lines()
    limits = Limits(*map(int, sys.argv[3:5]))
    limits.impose()
    threading.Thread(target=leave_with_the_service, daemon=True).start()
    config = read_cell_file(Path(sys.argv[1]).resolve())
    os.chdir(sys.argv[2])
    finish_job(
        lambda: make_programs(config, parse_json(read_plain_text(Path(REQUEST_FILE)))),
        limits,
        _log,
        "a job of programs",
    )


if __name__ == "__main__":
    sys.exit(run_guarded(main))
