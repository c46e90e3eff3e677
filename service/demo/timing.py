"""Where the robot time of a recovery goes, by the fake world's own clock."""

import time
from dataclasses import dataclass, field

from cellcal.procedures.progress import StepProgress

TRUE_FACTOR = 4.0  # above it, sockets and computing count too often for the sum to be robot time
_PARTS = (
    ("turn J", "motors past their index"),
    ("go to", "moving"),
    (("capture", "check", "memory check", "final check"), "measuring"),
    (("plan", "judge", "confirm"), "computing"),
)


@dataclass(frozen=True, slots=True)
class RobotTime:
    """World seconds from the first look at the alarms to the confirmed mastering."""

    total_s: float
    time_factor: float
    parts_s: tuple[tuple[str, float], ...]

    @property
    def is_real_time(self) -> bool:
        """Whether the clock ran slowly enough for the figure to be that of a real robot."""
        return self.time_factor <= TRUE_FACTOR

    def describe_time(self) -> str:
        """Return the figure with what it is made of; of a world that ran too fast to tell, how to get it."""
        if not self.is_real_time:
            return (
                f"the fake world runs {self.time_factor:g} times as fast as a robot: "
                "--time-factor 1 shows how long a robot takes in all"
            )
        minutes, seconds = divmod(round(self.total_s), 60)
        parts = ", ".join(f"{name} {part_s:.0f} s" for name, part_s in self.parts_s)
        return f"robot time {minutes} min {seconds} s by the world's clock ({parts})"


@dataclass
class StepClock:
    """Adds up how long steps took, by what they are for."""

    time_factor: float
    _began_s: float | None = None
    _parts_s: dict[str, float] = field(default_factory=dict)

    def on_event(self, event: StepProgress) -> None:
        """Follow a run."""
        if event.kind == "started":
            self._began_s = time.monotonic()
        elif event.kind in ("finding", "condition", "failed") and self._began_s is not None:
            part, took_s = _part_of(event.step), time.monotonic() - self._began_s
            self._parts_s[part] = self._parts_s.get(part, 0.0) + took_s * self.time_factor
            self._began_s = None

    def split_total(self, total_s: float) -> RobotTime:
        """Return the split of a total [world s] that was read from the control port; the rest is between steps."""
        parts = dict(self._parts_s)
        parts["other"] = parts.get("other", 0.0) + max(0.0, total_s - sum(parts.values()))
        return RobotTime(total_s, self.time_factor, tuple(parts.items()))


def _part_of(step: str) -> str:
    return next((part for starts, part in _PARTS if step.startswith(starts)), "other")
