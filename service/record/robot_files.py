"""One small file per robot, replaced atomically: an observation, not a record."""

import json
import logging
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, TypeVar

from cellcal.calibration.documents.json_text import parse_json
from cellcal.calibration.documents.plain_files import read_plain_text
from cellcal.service.files import make_private_folder, replace_file

_LOG = logging.getLogger(__name__)
Content = TypeVar("Content")


class RobotFiles:
    """The files of one kind, by robot; ``what`` names their content in the log where one cannot be read."""

    def __init__(self, folder: Path, kind: str, what: str) -> None:
        self._folder, self._kind, self._what = folder, kind, what

    def load_content(self, robot: str, parse: Callable[[Any], Content]) -> Content | None:
        """Return what is stored of a robot, or None where nothing (readable) is."""
        try:
            return parse(parse_json(read_plain_text(self._path_of(robot))))
        except FileNotFoundError:
            return None
        except (OSError, ValueError, KeyError, TypeError) as error:
            _LOG.warning("%s of %s cannot be read and is ignored: %s", self._what, robot, error)
            return None

    def save_document(self, robot: str, document: Mapping[str, Any]) -> None:
        """Replace the file so that a crash leaves the old or the new one, never half of it."""
        make_private_folder(self._folder)
        replace_file(self._path_of(robot), json.dumps(document))

    def _path_of(self, robot: str) -> Path:
        return self._folder / f"{self._kind}_{robot}.json"
