"""The controller's event log: what its newest entries say about the position."""

from collections.abc import Mapping
from functools import cache
from typing import Any

from cellcal.drivers.abb.robot_web_services.web_link import WebLink
from cellcal.drivers.errors import RefusedError, WireProtocolError
from cellcal.drivers.interfaces import Alarm, AlarmKind
from cellcal.drivers.wire.tables import read_table_rows

COMMON_LOG = "/rw/elog/0"  # the domain of all events
_ENTRY = "elog-message-li"
_NEWEST = 50


@cache
def event_kinds() -> Mapping[str, AlarmKind]:
    """Return what the codes that are known here mean for the position."""
    rows = read_table_rows(__package__, "events.tsv")
    return {row["code"]: AlarmKind(row["kind"]) for row in rows}


async def read_position_events(link: WebLink) -> tuple[Alarm, ...]:
    """Return the newest event of each code that concerns the position, newest first; () where no log can be read.

    A log holds what was, not what is: these alarms explain a lost position, and never say that one is lost.
    """
    try:
        entries = await link.get_states(COMMON_LOG, lang="en", order="lifo", limit=str(_NEWEST))
    except (RefusedError, WireProtocolError):
        return ()  # an empty log, or none for this user
    return position_alarms(entries)


def position_alarms(entries: list[Mapping[str, Any]]) -> tuple[Alarm, ...]:
    """Return the newest entry of each known code, newest first; one without code, time or title counts for none."""
    named_entries = [entry for entry in entries if is_entry(entry) and entry["code"] in event_kinds()]
    found: dict[str, Alarm] = {}
    for entry in sorted(named_entries, key=lambda one: str(one["tstamp"]), reverse=True):
        code = entry["code"]
        found.setdefault(
            code, Alarm(code, ", ".join((entry["title"], entry["tstamp"])), None, event_kinds()[code])
        )
    return tuple(found.values())


def is_entry(state: Mapping[str, Any]) -> bool:
    """Return whether a state is an entry of the log that can be read."""
    return state.get("_type") == _ENTRY and all(
        isinstance(state.get(key), str) for key in ("code", "tstamp", "title")
    )
