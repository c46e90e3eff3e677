"""Where the motors stood when a robot was last healthy: one small file per robot."""

import json
import logging
from dataclasses import asdict, dataclass
from datetime import UTC, datetime
from pathlib import Path

from cellcal.calibration.documents.json_text import parse_json
from cellcal.calibration.documents.plain_files import read_plain_text
from cellcal.drivers.interfaces import Counts, MasteringStore
from cellcal.service.files import make_private_folder, replace_file
from cellcal.service.times import read_time

_LOG = logging.getLogger(__name__)


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
        self._dir = data_dir

    def load_counts(self, robot: str) -> HealthyCounts | None:
        """Return what was seen last, or None where nothing (readable) is stored."""
        try:
            document = parse_json(read_plain_text(self._counts_path(robot)))
            counts = tuple(int(count) for count in document["counts"])
            seen_utc = str(document["seen_utc"])
            read_time(seen_utc)
            return HealthyCounts(str(document["robot"]), counts, int(document["epoch"]), seen_utc)
        except FileNotFoundError:
            return None
        except (OSError, ValueError, KeyError, TypeError) as error:
            _LOG.warning("the last healthy counts of %s cannot be read and are ignored: %s", robot, error)
            return None

    def save_counts(self, observed: HealthyCounts) -> None:
        """Replace the file so that a crash leaves the old or the new one, never half of it."""
        make_private_folder(self._dir)
        path = self._counts_path(observed.robot)
        replace_file(path, json.dumps(asdict(observed)))

    def _counts_path(self, robot: str) -> Path:
        return self._dir / f"last_healthy_{robot}.json"


async def remember_healthy(robot: str, encoders: MasteringStore, memory: LastHealthyCounts) -> HealthyCounts:
    """Keep the present counts as healthy: after a record was taken, or a recovery has passed."""
    counts, epoch = await encoders.encoder_counts(), await encoders.encoder_epoch()
    observed = HealthyCounts(robot, counts, epoch, datetime.now(UTC).isoformat())
    memory.save_counts(observed)
    return observed
