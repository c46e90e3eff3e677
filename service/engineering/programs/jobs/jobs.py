"""Jobs that make programs: what is asked of them, and what was made."""

import asyncio
import json
import logging
import os
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from cellcal.calibration.documents.json_text import parse_json
from cellcal.calibration.documents.plain_files import read_plain_bytes
from cellcal.calibration.errors import CellError
from cellcal.calibration.message_table import take_table
from cellcal.service.configuration.cell_file import CellConfig
from cellcal.service.engineering.page_jobs import PageJob, PageJobs
from cellcal.service.engineering.parameters.parameter_sets import FOLDER
from cellcal.service.engineering.programs.jobs.files import (
    ALL,
    ARCHIVE,
    PREVIEW,
    REQUEST_FILE,
    SOURCES,
    stored_projects,
    write_programs,
    write_project,
)
from cellcal.service.engineering.programs.jobs.limits import Limits
from cellcal.service.engineering.programs.jobs.shapes import (
    CellInput,
    JobPreview,
    PointsPage,
    ProgramsFault,
    ProgramsJob,
    ProgramsRequest,
    request_to_json,
)
from cellcal.service.record.stored_results import list_stored_results

_WORK_MODULE = "cellcal.service.engineering.programs.jobs.work"
_log = logging.getLogger(__name__)
_MOST_JOBS, _MOST_OPEN = 6, 4
_LONGEST_S = 900.0


class ProgramsError(CellError):
    """Programs cannot be made as asked."""

    code = "usage"


@dataclass(eq=False)
class TransferJob(PageJob):
    """One job that makes programs."""

    request: ProgramsRequest
    fault: ProgramsFault | None = None

    def set_fault(self, message: str, remedy: str) -> None:
        self.fault = ProgramsFault(message=message, remedy=remedy)

    @property
    def archive_name(self) -> str:
        """Return what the archive is called: no source has this name."""
        return f"cellcal_{self.request.do}_{self.at:%Y%m%d_%H%M%S}_{self.id[:4]}"

    def to_response(self) -> ProgramsJob:
        """Return how it stands."""
        return ProgramsJob(
            id=self.id, do=self.request.do, who=self.who, at_utc=self.at.isoformat(timespec="seconds"),
            state=self.state, done=self.done, total=self.total, fault=self.fault,
        )  # fmt: skip

    def read_preview(self) -> JobPreview | None:
        """Return what was made, None while nothing is."""
        if self.state != "done":
            return None
        return JobPreview.model_validate(take_table(parse_json(read_plain_bytes(self.folder / PREVIEW))))

    def read_points(self, program: int | None, page: int) -> PointsPage:
        """Return a page of points: all worst first, or of one program.

        Raises
        ------
        ProgramsError
            It is not made, or has no such page.
        """
        file = self.folder / f"points-{ALL if program is None else program}-{page}.json"
        return PointsPage.model_validate(take_table(parse_json(self._read_result(file))))

    def read_archive(self) -> bytes:
        """Return the new programs with their reports.

        Raises
        ------
        ProgramsError
            They are not made.
        """
        return self._read_result(self.folder / ARCHIVE)

    def _read_result(self, file: Path) -> bytes:
        if self.state != "done" or not file.is_file():
            raise ProgramsError("that is not made.", remedy="Wait for it, or look at what is there.")
        return read_plain_bytes(file)


class Jobs(PageJobs[TransferJob]):
    """All jobs of one service that make programs."""

    def __init__(self, config: CellConfig, limits: Limits | None = None) -> None:
        super().__init__(_MOST_JOBS, _MOST_OPEN)
        self._config, self._limits = config, limits or Limits()

    def newest_first(self) -> list[ProgramsJob]:
        """Return every job that is kept."""
        return [work.to_response() for work in reversed(self._jobs.values())]

    def find_job(self, job_id: str) -> TransferJob:
        """Return a job.

        Raises
        ------
        ProgramsError
            It is not there, or not any more.
        """
        if job_id not in self._jobs:
            raise ProgramsError("there is no such job any more.", remedy="Make the programs again.")
        return self._jobs[job_id]

    async def begin_job(self, request: ProgramsRequest, who: str) -> TransferJob:
        """Take the files of a job and start it.

        Raises
        ------
        CellError
            Too many wait; what is asked for does not fit together; what came along cannot be used.
        """
        if self.is_full:
            raise ProgramsError(
                "other programs are being made just now.",
                remedy="Ask again in a moment.",
                code="programs.busy",
            )
        check_request(request)
        work = TransferJob(request, who=who)
        try:
            await asyncio.to_thread(_unpack_files, work, self._config)
        except BaseException:
            work.delete_files()
            raise
        self._start_job(work, self._make_programs(work), f"programs {work.id}")
        return work

    async def _make_programs(self, work: TransferJob) -> None:
        try:
            async with self._turn:
                work.state = "running"
                async with asyncio.timeout(_LONGEST_S):
                    arguments = os.fspath(self._config.path), os.fspath(work.folder)
                    await work.run_process(_WORK_MODULE, arguments, self._limits)
        except asyncio.CancelledError:
            work.state = "stopped"
            raise
        except TimeoutError:
            work.state = "failed"
            work.fault = ProgramsFault(message="This took too long.", remedy="Make fewer programs at once.")
        except OSError:
            _log.exception("the job %s could not be started", work.id)
            work.state = "failed"
            work.fault = ProgramsFault(
                message="The job could not be started.", remedy="The service's log has the cause."
            )


def check_request(request: ProgramsRequest) -> None:
    """Refuse what does not fit together, before any file is written.

    Raises
    ------
    ProgramsError
        With the cure.
    """
    if (request.clone is not None) != (request.do == "clone"):
        raise ProgramsError(
            "a clone takes two cells, anything else one.", remedy="Name the cell that gets it."
        )
    if (request.offset is not None) != (request.do == "move"):
        raise ProgramsError("a move takes an offset, anything else none.", remedy="Say how the work moved.")
    if request.own_files and request.cell.kind != "kept":
        raise ProgramsError("only a project that is kept here names programs.", remedy="Choose files.")
    if not request.files and not request.own_files:
        raise ProgramsError("no program came along.", remedy="Choose the program files.")
    for cell in (request.cell, request.clone):
        if cell is not None and cell.kind != "here" and (cell.tools or cell.frames):
            raise ProgramsError("a project names its own tools and frames.", remedy="Leave them out.")


def _unpack_files(work: TransferJob, config: CellConfig) -> None:
    """Write all that came along into the job's folder, and what is asked of it."""
    request, folder = work.request, work.folder
    refused = write_programs(request.files, folder / SOURCES)
    request_json = request_to_json(request)
    for name, cell in (("cell", request.cell), ("clone", request.clone)):
        if cell is not None:
            request_json[name] |= _looked_up(cell, folder / name, config)
    document = {
        **request_json,
        "refused": [one.model_dump() for one in refused],
        "archive": work.archive_name,
    }
    (folder / REQUEST_FILE).write_text(json.dumps(document), encoding="utf-8")


def _looked_up(cell: CellInput, folder: Path, config: CellConfig) -> dict[str, Any]:
    """Return what the process must know of a cell beside what a page said of it."""
    if cell.kind == "carried":
        return {"project": write_project(cell.files, folder).name}
    if cell.kind == "here":
        serial = config.robot_named(cell.name or None).serial
        results = [
            {"what": k.what, "subject": k.subject, "value": k.value}
            for k in list_stored_results(config, serial)
        ]
        return {"sets": FOLDER, "measured": results}
    if cell.name not in stored_projects(Path(config.path).resolve().parent):
        raise ProgramsError(
            "there is no such project beside the cell file.", remedy="Choose one of the list."
        )
    return {}
