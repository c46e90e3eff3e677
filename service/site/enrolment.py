"""Set up a site, and add cells to it: authority, keys, certificates, and the configurations with their rules.

    site/
      site.json  ca.pem  ca.key       the authority; keep ca.key where no other person has access
      router/    router.json5 …       for the site's computer
      monitor/   monitor.json5 stations.json …
      cells/<id>/  cell.json5 station.json …   to be carried to that cell, and deleted here

Keys and certificates are never written over. Only the router's rules and the list of cells grow.
"""

import json
import re
from dataclasses import dataclass
from pathlib import Path

from pydantic import BaseModel, ConfigDict, ValidationError

from cellcal.calibration.documents.plain_files import read_plain_bytes
from cellcal.calibration.message import make_message
from cellcal.service.configuration.cell_file import read_cell_file
from cellcal.service.files import replace_file
from cellcal.service.record.signing import read_public_key, station_key
from cellcal.service.site.access import Config, cell_config, monitor_config, router_config
from cellcal.service.site.authority import SiteAuthority, new_authority, read_authority, write_new
from cellcal.service.site.keys import MONITOR_NAME, ROUTER_NAME, SiteError, checked_identifier, key_part
from cellcal.service.site.link_files import (
    CELL_FILE,
    MONITOR_FILE,
    ROUTER_FILE,
    STATION_FILE,
    STATIONS_FILE,
    EnrolledCell,
    StationsFile,
)
from cellcal.service.site.signed_messages import wall_utc

SITE_FILE = "site.json"
_ENDPOINT = re.compile(r"([A-Za-z0-9.-]+|\[[0-9A-Fa-f:.]+\]):([0-9]{1,5})")


class _SiteFile(BaseModel):
    """The description of a site; the list of its cells is the monitor's."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    site: str
    endpoint: str
    listen: str


@dataclass(frozen=True, slots=True)
class NewSite:
    """The options of a new site. ``endpoint`` is host:port as cells reach the router; ``listen`` where it listens."""

    name: str
    endpoint: str
    listen: str = ""


@dataclass(frozen=True, slots=True)
class CellApplicant:
    """A cell that is to be added, and the public key that signs for it."""

    cell: str
    public_key: str


def parse_applicant(text: str) -> CellApplicant:
    """Return whom a word of the command line means: a cell file here, or ``id=public key`` of a cell elsewhere.

    Raises
    ------
    SiteError
        Neither, or no good id.
    """
    name, separator, key = text.partition("=")
    if separator:
        return CellApplicant(checked_identifier(name, "cell"), read_public_key(key))
    if not Path(text).is_file():
        raise SiteError(
            f"{text!r} is no cell file.",
            remedy="Name a cell file of this computer, or ID=PUBLIC_KEY of a cell elsewhere: `cellcal certificate "
            "key --cell CELL` prints it there. Without the key nothing that the cell says could be believed.",
            code="usage",
        )
    config = read_cell_file(text)
    return CellApplicant(
        checked_identifier(key_part(config.cell.name), "cell"), station_key(config.cell.data_dir).public_key
    )


def enroll_cells(folder: Path, applicants: list[CellApplicant], new: NewSite | None = None) -> list[Path]:
    """Add cells to the site in a folder, and begin the site where there is none; return the cells' folders.

    Raises
    ------
    SiteError
        A cell is enrolled already, a file would be written over, or the site cannot be begun.
    """
    begun = (folder / SITE_FILE).exists()
    if begun and new is not None:
        raise SiteError(
            f"{folder} holds a site already.", remedy="Leave --name and --endpoint away.", code="usage"
        )
    names = [one.cell for one in applicants]
    for name in names:
        if names.count(name) > 1:
            raise SiteError(
                f"two cells would be called {name!r}.", remedy="Name them ID=PUBLIC_KEY.", code="usage"
            )
    site = _read_site(folder) if begun else _begin_site(folder, new)
    authority = read_authority(folder)
    stations = _read_enrolled(folder, site)
    for one in applicants:
        _refuse_enrolled(folder, stations, one)
    made = [_write_cell(folder, site, authority, one) for one in applicants]
    enrolled = dict(stations.cells) | {
        one.cell: EnrolledCell(public_key=one.public_key, enrolled_utc=wall_utc()) for one in applicants
    }
    _write_lists(folder, site, StationsFile(site=site.site, cells=enrolled))
    return made


def _begin_site(folder: Path, new: NewSite | None) -> _SiteFile:
    if new is None:
        raise SiteError(
            f"{folder} holds no site yet.",
            remedy="Give --name of the site and --endpoint HOST:PORT, as cells reach its router.",
            code="usage",
        )
    name, host = checked_identifier(new.name, "site"), _host_of(new.endpoint)
    listen = new.listen or new.endpoint
    _host_of(listen)
    for part in (folder, folder / "router", folder / "monitor", folder / "cells"):
        part.mkdir(parents=True, exist_ok=True, mode=0o700)
    authority = new_authority(name, folder)
    authority.issue_certificate(ROUTER_NAME, folder / "router", serves=host)
    authority.issue_certificate(MONITOR_NAME, folder / "monitor")
    for name_of_part in ("router", "monitor"):
        write_new(folder / name_of_part / "ca.pem", authority.certificate_pem)
    write_new(folder / "monitor" / MONITOR_FILE, _as_text(monitor_config(new.endpoint)))
    site = _SiteFile(site=name, endpoint=new.endpoint, listen=listen)
    _write_lists(folder, site, StationsFile(site=name, cells={}))
    write_new(folder / SITE_FILE, _as_text(site.model_dump()))  # last: a site that has it is whole
    return site


def _host_of(endpoint: str) -> str:
    found = _ENDPOINT.fullmatch(endpoint)
    if found is None or not 0 < int(found[2]) < 65536:
        raise SiteError(f"{endpoint!r} is no HOST:PORT.", remedy="For example site.local:7447.", code="usage")
    return found[1].strip("[]")


def _refuse_enrolled(folder: Path, stations: StationsFile, one: CellApplicant) -> None:
    keys = {station.public_key: cell for cell, station in stations.cells.items() if cell != one.cell}
    if one.public_key in keys:
        raise SiteError(
            f"the key of {one.cell} is the one of {keys[one.public_key]}: they would be one cell to the site.",
            remedy="Give each cell a data_dir, and so a key, of its own.",
            code="usage",
        )
    if one.cell in stations.cells and (folder / "cells" / one.cell).exists():
        raise SiteError(
            f"the cell {one.cell} is enrolled already; nothing is written over.",
            remedy=f"To give it new keys, move {folder / 'cells' / one.cell} away and enrol it again.",
            code="usage",
        )


def _write_cell(folder: Path, site: _SiteFile, authority: SiteAuthority, one: CellApplicant) -> Path:
    path = folder / "cells" / one.cell
    try:
        path.mkdir(mode=0o700)
    except FileExistsError as error:
        raise SiteError(
            make_message("{path} is there already.", path=path), remedy="Move it away first.", code="usage"
        ) from error
    authority.issue_certificate(one.cell, path)
    write_new(path / "ca.pem", authority.certificate_pem)
    write_new(path / CELL_FILE, _as_text(cell_config(site.site, one.cell, site.endpoint)))
    write_new(path / STATION_FILE, _as_text({"site": site.site, "cell": one.cell}))
    return path


def _write_lists(folder: Path, site: _SiteFile, stations: StationsFile) -> None:
    router = router_config(site.site, site.listen, sorted(stations.cells))
    replace_file(folder / "monitor" / STATIONS_FILE, _as_text(stations.model_dump()).decode())
    replace_file(folder / "router" / ROUTER_FILE, _as_text(router).decode())


def _read_site(folder: Path) -> _SiteFile:
    try:
        return _SiteFile.model_validate_json(read_plain_bytes(folder / SITE_FILE))
    except (OSError, ValidationError) as error:
        raise SiteError(
            make_message("{path} cannot be used: {reason}.", path=folder / SITE_FILE, reason=error),
            remedy="Restore it.",
        ) from error


def _read_enrolled(folder: Path, site: _SiteFile) -> StationsFile:
    path = folder / "monitor" / STATIONS_FILE
    try:
        found = StationsFile.model_validate_json(read_plain_bytes(path))
    except (OSError, ValidationError) as error:
        raise SiteError(
            make_message("{path} cannot be used: {reason}.", path=path, reason=error), remedy="Restore it."
        ) from error
    if found.site != site.site:
        raise SiteError(f"{path} belongs to the site {found.site!r}.", remedy="Restore it.")
    return found


def _as_text(document: Config) -> bytes:
    return (json.dumps(document, indent=1, ensure_ascii=False) + "\n").encode()
