"""How much memory and processor time the process of a job may take, and in words how one that took more ended."""

import signal
import sys
from abc import ABC, abstractmethod
from dataclasses import dataclass

if sys.platform != "win32":
    import resource

_GRACE_S = 5  # between the signal and the kill


@dataclass(frozen=True, slots=True)
class JobLimits(ABC):
    """Of one process. A subclass says what the job is, and what to do where it is too large."""

    memory_bytes: int
    cpu_s: int

    @property
    @abstractmethod
    def too_large(self) -> str:
        """The sentence where the memory is not enough."""

    @property
    @abstractmethod
    def too_slow(self) -> str:
        """The sentence where the processor time is not enough."""

    @property
    @abstractmethod
    def remedy(self) -> str:
        """What to do where memory or time are not enough."""

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

    def words_of_end(self, code: int) -> tuple[str, str]:
        """Return how a process ended that did not say so itself, and what to do."""
        if code == -signal.SIGXCPU:
            return self.too_slow, self.remedy
        if code == -signal.SIGKILL:
            return "the job was ended from outside: memory was full, perhaps.", self.remedy
        return "The job ended by itself.", "The service's log has the cause."
