"""How much memory and processor time the process of an identification may take."""

from dataclasses import dataclass

from cellcal.calibration.message import make_message
from cellcal.service.engineering.job_limits import JobLimits


@dataclass(frozen=True, slots=True)
class IdentifyProcessLimits(JobLimits):
    """Of each process that an identification takes."""

    memory_bytes: int = 1 << 30
    cpu_s: int = 300

    @property
    def too_large(self) -> str:
        return make_message(
            "identifying from this file takes more than {memory_bytes} MB of memory.",
            memory_bytes=self.memory_bytes >> 20,
        )

    @property
    def too_slow(self) -> str:
        return make_message(
            "identifying from this file takes more than {cpu_s} s of computing.", cpu_s=self.cpu_s
        )

    @property
    def remedy(self) -> str:
        return "Take fewer rows, or use `cellcal identify` at the service's computer."
