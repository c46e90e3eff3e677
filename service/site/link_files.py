"""The folder that one part of the site is given: its zenoh configuration, its key and certificates.

Paths in a configuration are relative to its folder, which may be carried anywhere; ``zenohd -c router.json5`` reads
the same file when started in that folder.
"""

import contextlib
import json
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeVar

import zenoh
from pydantic import BaseModel, ConfigDict, ValidationError

from cellcal.calibration.documents.json_text import parse_json
from cellcal.calibration.documents.plain_files import read_plain_bytes, read_plain_text
from cellcal.calibration.message import make_message
from cellcal.service.site.keys import SiteError
from cellcal.service.site.time_fields import ZonedTime

ROUTER_FILE, CELL_FILE, MONITOR_FILE = "router.json5", "cell.json5", "monitor.json5"
STATION_FILE, STATIONS_FILE = "station.json", "stations.json"
_TLS_FILES = (
    "root_ca_certificate",
    "listen_private_key",
    "listen_certificate",
    "connect_private_key",
    "connect_certificate",
)


class _LinkTable(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid")


class StationFile(_LinkTable):
    """The identity of a cell on the bus."""

    site: str
    cell: str


class EnrolledCell(_LinkTable):
    """A cell as the site knows it. ``public_key`` is the one that signs its certificates and messages."""

    public_key: str
    enrolled_utc: ZonedTime


class StationsFile(_LinkTable):
    """Every cell that a monitor believes."""

    site: str
    cells: dict[str, EnrolledCell]


_Known = TypeVar("_Known", bound=_LinkTable)


@dataclass(frozen=True, slots=True)
class LinkFolder:
    """One part's folder."""

    path: Path
    config: dict[str, Any]

    @property
    def own_certificate(self) -> Path:
        """Return this part's own certificate."""
        return Path(self.config["transport"]["link"]["tls"]["connect_certificate"])

    def zenoh_config(self, changes: Iterable[tuple[str, Any]] = ()) -> zenoh.Config:
        """Return the configuration as zenoh takes it, with absolute paths."""
        config = zenoh.Config.from_json5(json.dumps(self.config))
        for key, value in changes:
            config.insert_json5(key, json.dumps(value))
        return config


def close_session(session: zenoh.Session) -> None:
    """Close a session; without that a process whose callbacks are Python's never ends."""
    with contextlib.suppress(zenoh.ZError):
        session.close()  # type: ignore[no-untyped-call]  # zenoh's stubs


def read_link_folder(folder: Path, name: str) -> LinkFolder:
    """Read a folder's zenoh configuration.

    Raises
    ------
    SiteError
        It is not there, is no configuration of ours, lacks a file, or its key is open to others.
    """
    path = folder / name
    try:
        config = parse_json(read_plain_text(path))
        tls = config["transport"]["link"]["tls"]
        files = {key: (folder / tls[key]).absolute() for key in _TLS_FILES}
    except (OSError, ValueError, KeyError, TypeError) as error:
        why = str(getattr(error, "strerror", None) or error).rstrip(".")
        raise SiteError(
            f"{path} is no configuration that `cellcal site enroll` wrote: {why}.",
            remedy="Copy the folder that it made, whole.",
            code="config",
        ) from error
    for file in files.values():
        if not file.is_file():
            raise SiteError(
                make_message("{path} is not there.", path=file),
                remedy="Copy the folder that enroll made, whole.",
                code="config",
            )
    key = files["connect_private_key"]
    if key.stat().st_mode & 0o077:
        raise SiteError(
            f"other users of this computer may read the private key {key}.",
            remedy=f"`chmod 600 {key}`; if others may have read it, enrol the cell anew.",
            code="config",
        )
    tls.update({key: str(file) for key, file in files.items()})
    return LinkFolder(folder, config)


def read_station(folder: Path) -> StationFile:
    """Return who the cell of a folder is."""
    return _read_table(folder / STATION_FILE, StationFile)


def read_stations(folder: Path) -> StationsFile:
    """Return whom the monitor of a folder believes."""
    return _read_table(folder / STATIONS_FILE, StationsFile)


def _read_table(path: Path, what: type[_Known]) -> _Known:
    try:
        return what.model_validate_json(read_plain_bytes(path))
    except (OSError, ValidationError) as error:
        raise SiteError(
            make_message("{path} cannot be used: {reason}.", path=path, reason=error),
            remedy="Copy the folder that `cellcal site enroll` made, whole.",
            code="config",
        ) from error
