"""How much memory and processor time the making of programs may take."""

from dataclasses import dataclass

from cellcal.calibration.message import make_message
from cellcal.service.engineering.job_limits import JobLimits


@dataclass(frozen=True, slots=True)
class Limits(JobLimits):
    """Of one process that makes programs."""

    memory_bytes: int = 512 << 20
    cpu_s: int = 600

    @property
    def too_large(self) -> str:
        return make_message(
            "making these programs takes more than {memory_bytes} MB of memory.",
            memory_bytes=self.memory_bytes >> 20,
        )

    @property
    def too_slow(self) -> str:
        return make_message("making these programs takes more than {cpu_s} s of computing.", cpu_s=self.cpu_s)

    @property
    def remedy(self) -> str:
        return "Make fewer programs at once."
