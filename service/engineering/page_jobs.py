"""Jobs that pages have begun: each a process of its own with a folder of its own, one after the other.

The web's loop only starts them and listens. What was made is kept until the service ends or newer jobs need the room.
"""

import asyncio
import datetime
import secrets
import tempfile
from abc import ABC, abstractmethod
from collections import OrderedDict
from collections.abc import Coroutine, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Generic, Literal, TypeVar

from cellcal.calibration.message_table import remember_table
from cellcal.service.engineering.job_limits import JobLimits
from cellcal.service.engineering.job_processes import run_job_process
from cellcal.service.path_redaction import without_paths

JobState = Literal["waiting", "running", "done", "failed", "stopped"]
_OPEN = ("waiting", "running")


@dataclass(eq=False, kw_only=True)
class PageJob(ABC):
    """One job and its folder."""

    who: str
    id: str = field(default_factory=lambda: secrets.token_hex(6))
    at: datetime.datetime = field(default_factory=lambda: datetime.datetime.now(datetime.UTC))
    state: JobState = "waiting"
    done: int = 0
    total: int = 0
    task: asyncio.Task[None] | None = None
    _place: tempfile.TemporaryDirectory[str] = field(
        default_factory=lambda: tempfile.TemporaryDirectory(prefix="cellcal-", ignore_cleanup_errors=True)
    )

    @property
    def folder(self) -> Path:
        """Return where its files are."""
        return Path(self._place.name)

    @property
    def is_open(self) -> bool:
        """Whether it waits or runs."""
        return self.state in _OPEN

    @abstractmethod
    def set_fault(self, message: str, remedy: str) -> None:
        """Keep why it failed, and the cure."""

    def take_message(self, message: dict[str, Any]) -> None:
        """Take what its process says: how far it is, or how it ended."""
        remember_table(message)
        if "end" in message:
            self.state = message["end"]
            if self.state == "failed":
                self.set_fault(without_paths(message["message"]), without_paths(message["remedy"]))
        elif "done" in message:
            self.done, self.total = message["done"], message["total"]

    async def run_process(self, module: str, arguments: Sequence[str], limits: JobLimits) -> None:
        """Run its process until that ends, however it ends; raises as `run_job_process`."""
        code = await run_job_process(module, (*arguments, *limits.as_words()), self.take_message)
        if self.state == "running":
            self.state = "failed"
            self.set_fault(*limits.words_of_end(code))

    def delete_files(self) -> None:
        """Remove its files."""
        self._place.cleanup()


Job = TypeVar("Job", bound=PageJob)


class PageJobs(Generic[Job]):
    """All jobs of one kind of one service, by their ids, oldest first."""

    def __init__(self, most: int, most_open: int) -> None:
        self._most, self._most_open = most, most_open
        self._turn = asyncio.Lock()  # of the job that runs
        self._jobs: OrderedDict[str, Job] = OrderedDict()

    @property
    def is_full(self) -> bool:
        """Whether as many jobs wait or run as may."""
        return sum(job.is_open for job in self._jobs.values()) >= self._most_open

    async def stop_job(self, job: Job) -> None:
        """End a job that is not done; what it had made is forgotten."""
        if job.task is not None and job.is_open:
            if not job.task.cancelling():  # a second one would not wait for the process to end
                job.task.cancel()
            await asyncio.wait([job.task])  # continues after the client has left

    async def close_all(self) -> None:
        """End every job and forget what was made."""
        for job in self._jobs.values():
            await self.stop_job(job)
            await asyncio.to_thread(job.delete_files)
        self._jobs.clear()

    def _start_job(self, job: Job, work: Coroutine[Any, Any, None], name: str) -> None:
        """Keep a job whose files are written, in place of an old one if need be, and begin its work."""
        self._jobs[job.id] = job
        old = [each for each, one in self._jobs.items() if not one.is_open]
        for each in old[: max(0, len(self._jobs) - self._most)]:
            self._jobs.pop(each).delete_files()
        job.task = asyncio.create_task(work, name=name)
