"""How much memory and processor time the process of a job may take, and in words how one that took more ended."""

import signal
import sys
from dataclasses import dataclass

from cellcal.calibration.message import make_message

if sys.platform != "win32":
    import resource

_GRACE_S = 5  # between the signal and the kill


@dataclass(frozen=True, slots=True)
class Limits:
    """Of one process."""

    memory_bytes: int = 512 << 20
    cpu_s: int = 600

    def impose(self) -> None:
        """Hold this process, and those that it begins, to the limits from now on; none is ever loosened."""
        if sys.platform == "win32":  # it has no such limits
            return
        for what, soft, hard in (
            (resource.RLIMIT_DATA, self.memory_bytes, self.memory_bytes),
            (resource.RLIMIT_CPU, self.cpu_s, self.cpu_s + _GRACE_S),
            (resource.RLIMIT_CORE, 0, 0),
        ):
            _, allowed = resource.getrlimit(what)
            most = hard if allowed == resource.RLIM_INFINITY else min(hard, allowed)
            resource.setrlimit(what, (min(soft, most), most))

    def as_words(self) -> tuple[str, str]:
        """Return them for a command line."""
        return str(self.memory_bytes), str(self.cpu_s)

    @property
    def too_large(self) -> str:
        """What is said where the memory is not enough."""
        return make_message(
            "making these programs takes more than {memory_bytes} MB of memory.",
            memory_bytes=self.memory_bytes >> 20,
        )

    def words_of_end(self, code: int) -> tuple[str, str]:
        """Return how a process ended that did not say so itself, and what to do."""
        if code == -signal.SIGXCPU:
            return (
                make_message(
                    "making these programs takes more than {cpu_s} s of computing.", cpu_s=self.cpu_s
                ),
                "Make fewer programs at once.",
            )
        if code == -signal.SIGKILL:
            return "the job was ended from outside: memory was full, perhaps.", "Make fewer programs at once."
        return "The job ended by itself.", "The service's log has the cause."
