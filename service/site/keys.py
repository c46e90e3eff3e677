"""Names on the bus: one place that spells every key, so that no two parts disagree about one.

``cellcal/v1/<site>/<cell>/<purpose>…``: the purpose stands before the detail, so one wildcard asks for one purpose.
Nothing here commands anything: a cell publishes and answers, and subscribes to nothing.
"""

import hashlib
import re
from dataclasses import dataclass

from cellcal.calibration.errors import CellError

ROOT = "cellcal/v1"
ROUTER_NAME, MONITOR_NAME = "site-router", "site-monitor"
_IDENTIFIER = re.compile(r"[a-z0-9](?:[a-z0-9-]{0,30}[a-z0-9])?")
_NOT_IN_A_CHUNK = re.compile(r"[^a-z0-9]+")


class SiteError(CellError):
    """The view from afar cannot be set up or used."""

    code = "site"


def checked_identifier(text: str, what: str) -> str:
    """Return the id of a site or a cell.

    Raises
    ------
    SiteError
        It is none, or it is the name of the router or the monitor, whose rights it would get.
    """
    if _IDENTIFIER.fullmatch(text) is None:
        raise SiteError(
            f"{text!r} is no name of a {what} on the bus.",
            remedy="Use 1 to 32 of a-z, 0-9 and '-', no '-' at either end. The cell's own name is shown beside it.",
            code="usage",
        )
    if text in (ROUTER_NAME, MONITOR_NAME):
        raise SiteError(
            f"{text!r} is the name of a part of the site.", remedy=f"Name the {what} otherwise.", code="usage"
        )
    return text


def key_part(name: str, most: int = 32) -> str:
    """Return a name as one part of a key; two names that differ stay different."""
    plain = _NOT_IN_A_CHUNK.sub("-", name.lower()).strip("-")[:most].strip("-")
    if plain == name:
        return plain
    mark = hashlib.sha256(name.encode()).hexdigest()[:6]
    return f"{plain[: most - 7].strip('-')}-{mark}".strip("-")


@dataclass(frozen=True, slots=True)
class StationKeys:
    """The keys of one cell; with ``*`` for the cell, those of all of them."""

    site: str
    cell: str

    @property
    def base_key(self) -> str:
        """The beginning of every key of the cell."""
        return f"{ROOT}/{self.site}/{self.cell}"

    @property
    def alive_key(self) -> str:
        """Liveliness token."""
        return f"{self.base_key}/alive"

    @property
    def state_key(self) -> str:
        """The key of the cell's state: once a second and on change."""
        return f"{self.base_key}/state"

    @property
    def joints_key(self) -> str:
        """Joints of the robot, ten times a second."""
        return f"{self.base_key}/joints"

    @property
    def alarm_key(self) -> str:
        """Alarms, raised and cleared."""
        return f"{self.base_key}/alarm"

    def device_key(self, name: str, what: str) -> str:
        """Value or state of one device."""
        return f"{self.base_key}/device/{key_part(name)}/{what}"

    def session_event(self, run_id: str) -> str:
        """Journal events of one run."""
        return f"{self.base_key}/session/{key_part(run_id, 64)}/event"

    @property
    def any_session_event(self) -> str:
        """Journal events of all runs."""
        return f"{self.base_key}/session/*/event"

    def answer_key(self, verb: str) -> str:
        """Return the key of a question that the cell answers; ``*`` for all of them."""
        return f"{self.base_key}/rpc/{verb}"

    def certificate_key(self, run_id: str) -> str:
        """Return the key of a signed certificate, by the id of its run; ``*`` for any."""
        return f"{self.base_key}/cert/{run_id}"


def everything_below(base: str) -> list[str]:
    """Return the key expressions that cover all below a key.

    The second one is for caches and heartbeats of advanced publishers: chunks that begin with ``@`` are matched by
    no wildcard, so access to them has to be given by name.
    """
    return [f"{base}/**", f"{base}/**/@adv/**"]


def cell_of(key: str) -> str:
    """Return the cell's part of a key; nothing where there is none."""
    parts = key.split("/", 4)
    return parts[3] if len(parts) == 5 else ""
