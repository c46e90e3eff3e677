"""The site's router: a process that hosts zenoh's own router; the data go through Rust, not through Python.

Rules are read at the start only, so a changed configuration (a cell was enrolled) starts the router anew. Cells come
back within a second or two, and what they had to tell meanwhile is recovered.
"""

import logging
import threading
from collections.abc import Callable
from pathlib import Path

import zenoh

from cellcal.service.site.keys import SiteError
from cellcal.service.site.link_files import ROUTER_FILE, LinkFolder, close_session, read_link_folder

_LOG = logging.getLogger(__name__)
_LOOK_S = 1.0
_REOPEN_S = 0.5
_PATIENCE = 20


def host_router(folder: Path, leave: threading.Event, tell: Callable[[str], None]) -> None:
    """Host the router of a folder until ``leave`` is set.

    Raises
    ------
    SiteError
        The folder is not whole, or its address cannot be listened on.
    """
    link = read_link_folder(folder, ROUTER_FILE)
    session = _open_session(link, leave)
    tell(_listening_text(link))
    try:
        while not leave.wait(_LOOK_S):
            changed = _changed_link(folder, link)
            if changed is None:
                continue
            link = changed
            close_session(session)
            session = _open_session(link, leave, attempts=_PATIENCE)
            tell(f"The rules have changed. {_listening_text(link)}")
    finally:
        close_session(session)


def _changed_link(folder: Path, link: LinkFolder) -> LinkFolder | None:
    try:
        found = read_link_folder(folder, ROUTER_FILE)
        found.zenoh_config()
    except (SiteError, zenoh.ZError) as error:
        _LOG.warning("the router goes on with the rules that it has: %s", error)
        return None
    return found if found.config != link.config else None


def _open_session(link: LinkFolder, leave: threading.Event, attempts: int = 1) -> zenoh.Session:
    while True:
        try:
            return zenoh.open(link.zenoh_config())
        except zenoh.ZError as error:
            attempts -= 1
            if attempts <= 0 or leave.wait(_REOPEN_S):
                where = ", ".join(link.config["listen"]["endpoints"])
                raise SiteError(
                    f"the router cannot listen on {where}: {error}.",
                    remedy="End what else listens there, or correct the address.",
                    code="device.unreachable",
                ) from error


def _listening_text(link: LinkFolder) -> str:
    where = ", ".join(link.config["listen"]["endpoints"])
    cells = sum(1 for rule in link.config["access_control"]["rules"] if rule["id"].startswith("cell-"))
    return f"The site's router listens on {where}; {cells} cells may speak."
