"""Jobs that make programs: each a process of its own with a folder of its own, one after the other.

The web's loop only starts them and listens. What was made is kept until the service ends or newer jobs need the room.
"""

import asyncio
import contextlib
import datetime
import json
import logging
import os
import secrets
import sys
import tempfile
from collections import OrderedDict
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal

from cellcal.calibration.documents.json_text import parse_json
from cellcal.calibration.documents.plain_files import read_plain_bytes
from cellcal.calibration.errors import CellError
from cellcal.service.configuration.cell_file import CellConfig
from cellcal.service.engineering.parameters.parameter_sets import FOLDER
from cellcal.service.engineering.programs.jobs.files import (
    ALL,
    ARCHIVE,
    ASKED,
    PREVIEW,
    SOURCES,
    kept_projects,
    put_programs,
    put_project,
)
from cellcal.service.engineering.programs.jobs.shapes import (
    CellGiven,
    PointsMade,
    Preview,
    ProgramsFault,
    ProgramsJob,
    Wanted,
    spelled,
)
from cellcal.service.record.stored_results import all_kept
from cellcal.service.shown_paths import without_paths

_WORK_MODULE = "cellcal.service.engineering.programs.jobs.work"
_log = logging.getLogger(__name__)
_KEPT, _MOST_OPEN = 6, 4
_LONGEST_S = 900.0
_LONGEST_LINE = 1 << 20
State = Literal["waiting", "running", "done", "failed", "stopped"]
_OPEN = ("waiting", "running")


class ProgramsError(CellError):
    """Programs cannot be made as asked."""

    code = "usage"


@dataclass(eq=False)
class Work:
    """One job and its folder."""

    wanted: Wanted
    who: str
    id: str = field(default_factory=lambda: secrets.token_hex(6))
    at: datetime.datetime = field(default_factory=lambda: datetime.datetime.now(datetime.UTC))
    state: State = "waiting"
    done: int = 0
    total: int = 0
    fault: ProgramsFault | None = None
    task: asyncio.Task[None] | None = None
    _place: tempfile.TemporaryDirectory[str] = field(
        default_factory=lambda: tempfile.TemporaryDirectory(prefix="cellcal-", ignore_cleanup_errors=True)
    )

    @property
    def folder(self) -> Path:
        """Return where its files are."""
        return Path(self._place.name)

    @property
    def name(self) -> str:
        """Return what the archive is called: no source has this name."""
        return f"cellcal_{self.wanted.do}_{self.at:%Y%m%d_%H%M%S}_{self.id[:4]}"

    def told(self) -> ProgramsJob:
        """Return how it stands."""
        return ProgramsJob(
            id=self.id, do=self.wanted.do, who=self.who, at_utc=self.at.isoformat(timespec="seconds"),
            state=self.state, done=self.done, total=self.total, fault=self.fault,
        )  # fmt: skip

    def preview(self) -> Preview | None:
        """Return what was made, None while nothing is."""
        if self.state != "done":
            return None
        return Preview.model_validate_json(read_plain_bytes(self.folder / PREVIEW))

    def points(self, program: int | None, page: int) -> PointsMade:
        """Return a page of points: all worst first, or of one program.

        Raises
        ------
        ProgramsError
            It is not made, or has no such page.
        """
        file = self.folder / f"points-{ALL if program is None else program}-{page}.json"
        return PointsMade.model_validate_json(self._made(file))

    def archive(self) -> bytes:
        """Return the new programs with their reports.

        Raises
        ------
        ProgramsError
            They are not made.
        """
        return self._made(self.folder / ARCHIVE)

    def _made(self, file: Path) -> bytes:
        if self.state != "done" or not file.is_file():
            raise ProgramsError("that is not made.", remedy="Wait for it, or look at what is there.")
        return read_plain_bytes(file)

    def forget(self) -> None:
        """Remove its files."""
        self._place.cleanup()


class Jobs:
    """All jobs of one service."""

    def __init__(self, config: CellConfig) -> None:
        self._config = config
        self._turn = asyncio.Lock()
        self._works: OrderedDict[str, Work] = OrderedDict()

    def newest_first(self) -> list[ProgramsJob]:
        """Return every job that is kept."""
        return [work.told() for work in reversed(self._works.values())]

    def find(self, job_id: str) -> Work:
        """Return a job.

        Raises
        ------
        ProgramsError
            It is not there, or not any more.
        """
        if job_id not in self._works:
            raise ProgramsError("there is no such job any more.", remedy="Make the programs again.")
        return self._works[job_id]

    async def begin(self, wanted: Wanted, who: str) -> Work:
        """Take the files of a job and start it.

        Raises
        ------
        CellError
            Too many wait; what is asked for does not fit together; what came along cannot be used.
        """
        if sum(work.state in _OPEN for work in self._works.values()) >= _MOST_OPEN:
            raise ProgramsError(
                "other programs are being made just now.",
                remedy="Ask again in a moment.",
                code="programs.busy",
            )
        check(wanted)
        work = Work(wanted, who)
        try:
            await asyncio.to_thread(_unpack, work, self._config)
        except BaseException:
            work.forget()
            raise
        self._works[work.id] = work
        self._forget_old()
        work.task = asyncio.create_task(self._make(work), name=f"programs {work.id}")
        return work

    async def stop(self, work: Work) -> None:
        """End a job that is not done; what it had made is forgotten."""
        if work.task is not None and work.state in _OPEN:
            if not work.task.cancelling():  # a second one would not wait for the process to end
                work.task.cancel()
            await asyncio.wait([work.task])  # goes on where whoever asked has left

    async def leave(self) -> None:
        """End every job and forget what was made."""
        for work in self._works.values():
            await self.stop(work)
            await asyncio.to_thread(work.forget)
        self._works.clear()

    def _forget_old(self) -> None:
        old = [name for name, work in self._works.items() if work.state not in _OPEN]
        for name in old[: max(0, len(self._works) - _KEPT)]:
            self._works.pop(name).forget()

    async def _make(self, work: Work) -> None:
        try:
            async with self._turn:
                work.state = "running"
                async with asyncio.timeout(_LONGEST_S):
                    await self._run(work)
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

    async def _run(self, work: Work) -> None:
        process = await asyncio.create_subprocess_exec(
            sys.executable, "-m", _WORK_MODULE, os.fspath(self._config.path), os.fspath(work.folder),
            stdin=asyncio.subprocess.PIPE, stdout=asyncio.subprocess.PIPE,
            limit=_LONGEST_LINE, start_new_session=True,  # Ctrl-C is for the service
            env={**os.environ, "OPENBLAS_NUM_THREADS": "1"},
        )  # fmt: skip
        assert process.stdout is not None
        try:
            while line := await process.stdout.readline():
                _take(work, parse_json(line))
        finally:
            with contextlib.suppress(ProcessLookupError):
                process.kill()
            await process.wait()
        if work.state == "running":
            work.state = "failed"
            work.fault = ProgramsFault(
                message="The job ended by itself.", remedy="The service's log has the cause."
            )


def _take(work: Work, said: dict[str, Any]) -> None:
    if "end" in said:
        work.state = said["end"]
        if work.state == "failed":
            work.fault = ProgramsFault(
                message=without_paths(said["message"]), remedy=without_paths(said["remedy"])
            )
    elif "done" in said:
        work.done, work.total = said["done"], said["total"]


def check(wanted: Wanted) -> None:
    """Refuse what does not fit together, before any file is written.

    Raises
    ------
    ProgramsError
        With the cure.
    """
    if (wanted.clone is not None) != (wanted.do == "clone"):
        raise ProgramsError(
            "a clone takes two cells, anything else one.", remedy="Name the cell that gets it."
        )
    if (wanted.offset is not None) != (wanted.do == "move"):
        raise ProgramsError("a move takes an offset, anything else none.", remedy="Say how the work moved.")
    if wanted.own_files and wanted.cell.kind != "kept":
        raise ProgramsError("only a project that is kept here names programs.", remedy="Choose files.")
    if not wanted.files and not wanted.own_files:
        raise ProgramsError("no program came along.", remedy="Choose the program files.")
    for cell in (wanted.cell, wanted.clone):
        if cell is not None and cell.kind != "here" and (cell.tools or cell.frames):
            raise ProgramsError("a project names its own tools and frames.", remedy="Leave them out.")


def _unpack(work: Work, config: CellConfig) -> None:
    """Write all that came along into the job's folder, and what is asked of it."""
    wanted, folder = work.wanted, work.folder
    refused = put_programs(wanted.files, folder / SOURCES)
    asked = spelled(wanted)
    for name, cell in (("cell", wanted.cell), ("clone", wanted.clone)):
        if cell is not None:
            asked[name] |= _looked_up(cell, folder / name, config)
    told = {**asked, "refused": [one.model_dump() for one in refused], "archive": work.name}
    (folder / ASKED).write_text(json.dumps(told), encoding="utf-8")


def _looked_up(cell: CellGiven, folder: Path, config: CellConfig) -> dict[str, Any]:
    """Return what the process must know of a cell beside what a page said of it."""
    if cell.kind == "carried":
        return {"project": put_project(cell.files, folder).name}
    if cell.kind == "here":
        serial = config.robot(cell.name or None).serial
        kept = [{"what": k.what, "subject": k.subject, "value": k.value} for k in all_kept(config, serial)]
        return {"sets": FOLDER, "measured": kept}
    if cell.name not in kept_projects(Path(config.path).resolve().parent):
        raise ProgramsError(
            "there is no such project beside the cell file.", remedy="Choose one of the list."
        )
    return {}
