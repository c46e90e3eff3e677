"""Identifications that pages have begun. A job that no page asks about any more is stopped."""

import asyncio
import datetime
import logging
import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from cellcal.calibration.documents.json_text import parse_json
from cellcal.calibration.documents.plain_files import read_plain_bytes
from cellcal.calibration.errors import CellError
from cellcal.calibration.message import make_message
from cellcal.calibration.message_table import take_table
from cellcal.service.configuration.cell_file import CellConfig
from cellcal.service.engineering.identification.jobs.descriptions import DescribedRobot, read_description
from cellcal.service.engineering.identification.jobs.limits import IdentifyProcessLimits
from cellcal.service.engineering.identification.jobs.shapes import (
    CHECK,
    DRAFTS,
    JOINTS,
    LAYOUT,
    REQUEST_FILE,
    RESULT_FILE,
    SOURCES,
    IdentifyFault,
    IdentifyJob,
    IdentifyRequest,
    IdentifyResult,
    IdentifyWishes,
    JobRequest,
)
from cellcal.service.engineering.job_limits import JobLimits
from cellcal.service.engineering.measured.embedded_files import content_of, plain_name
from cellcal.service.engineering.page_jobs import PageJob, PageJobs
from cellcal.service.engineering.parameters.parameter_set import ParameterSet
from cellcal.service.engineering.parameters.parameter_sets import FOLDER, ParameterSets
from cellcal.service.engineering.programs.jobs.shapes import MOST_FILE_BYTES

_WORK_MODULE = "cellcal.service.engineering.identification.jobs.work"
_MOST_JOBS, _MOST_OPEN = 4, 2
_PATIENCE_S = 150.0  # a browser lets the timers of a page in the background run once a minute
_log = logging.getLogger(__name__)


class IdentifyJobError(CellError):
    """A robot cannot be identified as asked."""

    code = "usage"


@dataclass(eq=False)
class IdentificationJob(PageJob):
    """One identification."""

    file: str
    robot: str
    serial: str
    model: str
    described: DescribedRobot | None = None
    stage: str = ""
    joints: str = ""
    check: str = ""
    layout: str = ""
    wishes: IdentifyWishes = field(default_factory=IdentifyWishes)
    headings: list[str] = field(default_factory=list)
    understood: dict[str, Any] = field(default_factory=dict)
    fault: IdentifyFault | None = None
    saved_version: int | None = None
    patience: asyncio.Timeout | None = None
    saving: asyncio.Lock = field(default_factory=asyncio.Lock)  # one save at a time

    def set_fault(self, message: str, remedy: str) -> None:
        self.fault = IdentifyFault(message=message, remedy=remedy)

    def take_message(self, message: dict[str, Any]) -> None:
        super().take_message(message)
        self.headings = message.get("headings", self.headings)
        self.understood = message.get("understood", self.understood)
        if "stage" in message:
            self.stage, self.done, self.total = message["stage"], 0, 0

    def to_response(self) -> IdentifyJob:
        """Return how it stands."""
        return IdentifyJob(
            id=self.id, file=self.file, robot=self.robot, serial=self.serial, model=Path(self.model).name,
            who=self.who, at_utc=self.at.isoformat(timespec="seconds"), wishes=self.wishes,
            joints=self.joints, check=self.check, layout=self.layout, headings=self.headings,
            understood=self.understood,
            state=self.state, stage=self.stage, done=self.done, total=self.total, fault=self.fault,
            saved_version=self.saved_version,
        )  # fmt: skip

    def read_result(self) -> IdentifyResult | None:
        """Return what was found, None while nothing is."""
        if self.state != "done":
            return None
        document = parse_json(read_plain_bytes(self.folder / RESULT_FILE))
        return IdentifyResult.model_validate(take_table(document))

    def read_draft(self) -> ParameterSet:
        """Return the parameters that were found, as a set that is not saved yet.

        Raises
        ------
        IdentifyJobError
            There is none.
        """
        result = self.read_result()
        if result is None:
            raise IdentifyJobError("that is not computed.", remedy="Wait for it, or look at what is there.")
        if result.not_savable is not None:
            raise IdentifyJobError(result.not_savable.message, remedy=result.not_savable.remedy)
        return ParameterSets(self.folder / DRAFTS).load_set(self.serial)


class IdentificationJobs(PageJobs[IdentificationJob]):
    """All identifications of one service."""

    def __init__(
        self, config: CellConfig, limits: JobLimits | None = None, patience_s: float = _PATIENCE_S
    ) -> None:
        super().__init__(_MOST_JOBS, _MOST_OPEN)
        self._config, self._limits = config, limits or IdentifyProcessLimits()
        self._patience_s = patience_s  # between two questions of pages about a job

    def newest_first(self) -> list[IdentifyJob]:
        """Return every job that is kept."""
        return [job.to_response() for job in reversed(self._jobs.values())]

    def find_job(self, job_id: str) -> IdentificationJob:
        """Return a job; while pages ask for it, it goes on.

        Raises
        ------
        IdentifyJobError
            It is not there, or not any more.
        """
        if job_id not in self._jobs:
            raise _job_is_gone()
        job = self._jobs[job_id]
        if job.patience is not None and job.is_open and not job.patience.expired():
            job.patience.reschedule(asyncio.get_running_loop().time() + self._patience_s)
        return job

    async def begin_job(self, request: IdentifyRequest, who: str) -> IdentificationJob:
        """Take the file and start.

        Raises
        ------
        CellError
            Too many wait; there is no such robot; a file did not arrive, is too large, or is not there any more.
        """
        if self.is_full:
            raise IdentifyJobError(
                "other measurements are being computed just now.",
                remedy="Ask again in a moment.",
                code="measurements.busy",
            )
        before = self.find_job(request.again) if request.again else None
        if (before is None) == (request.file is None):
            raise IdentifyJobError(
                "measurements are one file, or those of an identification before.", remedy="Choose one file."
            )
        robot = self._config.robot_named(request.robot or (before.robot if before else None))
        files = [] if before is None else await asyncio.to_thread(_files_of, before)
        files += [
            (place, plain_name(file.name, what), content_of(file.content_base64, what))
            for place, file, what in (
                (SOURCES, request.file, "measurements"),
                (JOINTS, request.joints, "joints"),
                (CHECK, request.check, "check"),
                (LAYOUT, request.layout, "layout"),
            )
            if file is not None
        ]
        _refuse_large([content for _, _, content in files])
        names = {place: name for place, name, _ in files}
        if SOURCES not in names:  # newer jobs took the room of the one before
            raise _job_is_gone()
        described = before.described if before else None
        if request.description is not None:
            described = read_description(request.description)
        model = robot.model if described is None else described.reference
        job = IdentificationJob(
            names[SOURCES], robot.name, robot.serial, model, described, joints=names.get(JOINTS, ""),
            check=names.get(CHECK, ""), layout=names.get(LAYOUT, ""), wishes=request.wishes, who=who,
        )  # fmt: skip
        try:
            await asyncio.to_thread(_write_files, job, {place: content for place, _, content in files})
        except BaseException:
            job.delete_files()
            raise
        self._start_job(job, self._carry_out(job), f"identification {job.id}")
        return job

    async def _carry_out(self, job: IdentificationJob) -> None:
        try:
            async with asyncio.timeout(self._patience_s) as job.patience, self._turn:
                job.state = "running"
                await job.run_process(_WORK_MODULE, (os.fspath(job.folder),), self._limits)
        except asyncio.CancelledError:
            job.state = "stopped"
            raise
        except TimeoutError:
            job.state = "stopped"
            job.fault = IdentifyFault(
                message="no page waited for it any more.", remedy="Bring the file along again."
            )
        except OSError:
            _log.exception("the identification %s could not be started", job.id)
            job.state = "failed"
            job.fault = IdentifyFault(
                message="The job could not be started.", remedy="The service's log has the cause."
            )


def _job_is_gone() -> IdentifyJobError:
    return IdentifyJobError("there is no such identification any more.", remedy="Bring the file along again.")


def save_result(job: IdentificationJob, config: CellConfig, name: str, note: str) -> ParameterSet:
    """Save what a job found as the newest version of its robot's parameters, in a person's name.

    Raises
    ------
    CellError
        There is nothing to save, or another version was written at the same moment.
    """
    now = datetime.datetime.now(datetime.UTC).isoformat(timespec="seconds")
    draft = replace(job.read_draft(), version=0, previous_sha256="", made_by=name, made_at=now, note=note)
    saved = ParameterSets(Path(config.path).parent / FOLDER).save_draft(draft)
    job.saved_version = saved.version
    return saved


def newest_version(config: CellConfig, serial: str) -> int:
    """Return the newest version of a robot's parameters, 0 where none were saved."""
    sets = ParameterSets(Path(config.path).parent / FOLDER)
    return sets.load_set(serial).version if serial in sets.robot_serials() else 0


def _files_of(job: IdentificationJob) -> list[tuple[str, str, bytes]]:
    """Return the files of a job: where each stands in its folder, its name, its content."""
    return [
        (place, path.name, read_plain_bytes(path))
        for place in (SOURCES, JOINTS, CHECK, LAYOUT)
        if (job.folder / place).is_dir()
        for path in (job.folder / place).iterdir()
    ]


def _refuse_large(contents: Sequence[bytes]) -> None:
    if sum(map(len, contents)) > MOST_FILE_BYTES:
        raise IdentifyJobError(
            make_message(
                "the file is larger than {most_file_bytes} MB.", most_file_bytes=MOST_FILE_BYTES >> 20
            ),
            remedy="Take fewer rows, or use `cellcal identify` at the service's computer.",
        )


def _write_files(job: IdentificationJob, contents: Mapping[str, bytes]) -> None:
    for place, name in (
        (SOURCES, job.file),
        (JOINTS, job.joints),
        (CHECK, job.check),
        (LAYOUT, job.layout),
    ):
        if name:
            (job.folder / place).mkdir()
            (job.folder / place / name).write_bytes(contents[place])
    if job.described is not None:
        job.described.write_file(job.folder)
    request = JobRequest(
        file=job.file,
        joints=job.joints,
        check=job.check,
        layout=job.layout,
        wishes=job.wishes,
        model=job.model,
        described=job.described is not None,
        serial=job.serial,
        who=job.who,
        at_utc=job.at.isoformat(timespec="seconds"),
    )
    (job.folder / REQUEST_FILE).write_text(request.model_dump_json(), encoding="utf-8")
