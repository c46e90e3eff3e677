"""The site's router: a process that hosts zenoh's own router; the data go through Rust, not through Python.

Rules are read at the start only, so a changed configuration (a cell was enrolled) starts the router anew. Cells come
back within a second or two, and what they had to tell meanwhile is recovered.
"""

import logging
import threading
from collections.abc import Callable
from pathlib import Path

import zenoh

from cellcal.drivers.supervision import start_thread
from cellcal.service.site.keys import SiteError
from cellcal.service.site.link_files import ROUTER_FILE, LinkFolder, close_session, read_link_folder

_LOG = logging.getLogger(__name__)
_LOOK_S = 1.0
_REOPEN_S = 0.5
_PATIENCE = 5
_LEAVE_S = 10.0


TASK = "router of the site"


def host_router(folder: Path, leave: threading.Event, tell: Callable[[str], None]) -> None:
    """Host the router of a folder until ``leave`` is set; once it has listened, whatever ends it opens it anew.

    Raises
    ------
    SiteError
        The folder is not whole, or its address cannot be listened on.
    """
    hosted = _Hosted(folder, leave, tell)
    keeping = start_thread(TASK, hosted.follow_rules, leave)
    try:
        # In turns: a signal that another thread takes ends no wait of the main thread, which runs its handler.
        while not leave.wait(_LOOK_S):
            pass
    finally:
        leave.set()
        keeping.join(_LEAVE_S)
        hosted.close()


class _Hosted:
    """The router as it runs, with the rules that it has."""

    def __init__(self, folder: Path, leave: threading.Event, tell: Callable[[str], None]) -> None:
        self._folder, self._leave, self._tell = folder, leave, tell
        self._link = read_link_folder(folder, ROUTER_FILE)
        self._session: zenoh.Session | None = _open_session(self._link, leave)
        tell(_listening_text(self._link))

    def follow_rules(self) -> None:
        """Look for changed rules, and see that it listens, until it may leave."""
        while not self._leave.wait(_LOOK_S):
            changed = _changed_link(self._folder, self._link)
            if changed is not None:
                self._link = changed
                self.close()
            if self._session is None or self._session.is_closed():
                self._session = _open_session(self._link, self._leave, attempts=_PATIENCE)
                self._tell(f"{'The rules have changed. ' if changed else ''}{_listening_text(self._link)}")

    def close(self) -> None:
        """Listen no more."""
        session, self._session = self._session, None
        if session is not None:
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
