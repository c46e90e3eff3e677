"""Which run was under way, so that a service that was killed goes on with it by itself."""

import json
import logging
from dataclasses import asdict, dataclass
from pathlib import Path

from cellcal.calibration.documents.json_text import parse_json
from cellcal.calibration.documents.plain_files import read_plain_text
from cellcal.service.files import replace_file

_log = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True)
class UnfinishedRun:
    """A run that has not ended."""

    run_id: str
    robot: str
    hold_to_move: bool


class RunInProgress:
    """One small file; gone while no run is under way."""

    def __init__(self, data_dir: Path) -> None:
        self._path = data_dir / "under_way.json"

    def save_run(self, run_id: str, robot: str, *, hold_to_move: bool) -> None:
        """Note that a run began."""
        replace_file(self._path, json.dumps(asdict(UnfinishedRun(run_id, robot, hold_to_move))) + "\n")

    def clear_run(self) -> None:
        """Note that it has ended, or that a person ended it."""
        self._path.unlink(missing_ok=True)

    def read_unfinished(self) -> UnfinishedRun | None:
        """Return the run that was under way when the service ended, if it can be read."""
        try:
            found = parse_json(read_plain_text(self._path))
            return UnfinishedRun(str(found["run_id"]), str(found["robot"]), bool(found["hold_to_move"]))
        except FileNotFoundError:
            return None
        except (OSError, ValueError, KeyError, TypeError) as error:
            _log.warning("which run was under way cannot be read and is ignored: %s", error)
            return None
