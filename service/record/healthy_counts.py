"""Where the motors stood when a robot was last healthy: one small file per robot."""

from dataclasses import asdict, dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from cellcal.drivers.interfaces import Counts, MasteringStore
from cellcal.service.record.robot_files import RobotFiles
from cellcal.service.times import read_time


@dataclass(frozen=True, slots=True)
class HealthyCounts:
    """The motors' counts when all was well."""

    robot: str
    counts: Counts
    epoch: int
    seen_utc: str


class LastHealthyCounts:
    """One small file per robot, replaced atomically: an observation, not a record."""

    def __init__(self, data_dir: Path) -> None:
        self._files = RobotFiles(data_dir, "last_healthy", "the observation of the last healthy counts")

    def load_counts(self, robot: str) -> HealthyCounts | None:
        """Return what was seen last, or None where nothing (readable) is stored."""
        return self._files.load_content(robot, _parse_counts)

    def save_counts(self, observed: HealthyCounts) -> None:
        """Replace the file so that a crash leaves the old or the new one, never half of it."""
        self._files.save_document(observed.robot, asdict(observed))


def _parse_counts(document: Any) -> HealthyCounts:
    counts = tuple(int(count) for count in document["counts"])
    seen_utc = str(document["seen_utc"])
    read_time(seen_utc)
    return HealthyCounts(str(document["robot"]), counts, int(document["epoch"]), seen_utc)


async def remember_healthy(robot: str, encoders: MasteringStore, memory: LastHealthyCounts) -> HealthyCounts:
    """Keep the present counts as healthy: after a record was taken, or a recovery has passed."""
    counts, epoch = await encoders.encoder_counts(), await encoders.encoder_epoch()
    observed = HealthyCounts(robot, counts, epoch, datetime.now(UTC).isoformat())
    memory.save_counts(observed)
    return observed
