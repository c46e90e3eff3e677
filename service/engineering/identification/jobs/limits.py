"""How much memory and processor time the process of an identification may take."""

import signal
from dataclasses import dataclass

from cellcal.calibration.message import make_message
from cellcal.service.engineering.programs.jobs.limits import Limits

_FEWER_ROWS = "Take fewer rows, or use `cellcal identify` at the service's computer."


@dataclass(frozen=True, slots=True)
class IdentifyProcessLimits(Limits):
    """Of each process that an identification takes."""

    memory_bytes: int = 1 << 30
    cpu_s: int = 300

    @property
    def too_large(self) -> str:
        """What is said where the memory is not enough."""
        return make_message(
            "identifying from this file takes more than {memory_bytes} MB of memory.",
            memory_bytes=self.memory_bytes >> 20,
        )

    def words_of_end(self, code: int) -> tuple[str, str]:
        """Return how a process ended that did not say so itself, and what to do."""
        if code == -signal.SIGXCPU:
            message = make_message(
                "identifying from this file takes more than {cpu_s} s of computing.", cpu_s=self.cpu_s
            )
            return message, _FEWER_ROWS
        if code == -signal.SIGKILL:
            return "the job was ended from outside: memory was full, perhaps.", _FEWER_ROWS
        return "The job ended by itself.", "The service's log has the cause."

    @property
    def remedy(self) -> str:
        """What to do where memory or time are not enough."""
        return _FEWER_ROWS
