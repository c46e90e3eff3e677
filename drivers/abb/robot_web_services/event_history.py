"""The controller's event log since an entry: whether the position was lost in between, and is back.

Source: 3HAC050973-001 rev M, "Get elog messages in domain": order=fifo, and elogseqnum, from which entries are given.
The title of an entry ends in its number.
"""

from collections.abc import Mapping
from typing import Any

from cellcal.drivers.abb.robot_web_services.event_log import COMMON_LOG, is_entry, position_alarms
from cellcal.drivers.abb.robot_web_services.web_link import WebLink
from cellcal.drivers.interfaces import PositionHistory

_MOST_PAGES = 40
_EMPTY = "-"  # the mark of a log without entries
Entries = dict[int, Mapping[str, Any]]  # by their numbers


async def read_position_history(link: WebLink, since: tuple[str, ...]) -> PositionHistory:
    """Return what concerns the position behind the entry with a mark; not whole where the log begins after it.

    A log that was cleared counts anew: then every entry that it holds came after the mark.

    Raises
    ------
    RefusedError
        The controller gives this user no log.
    """
    newest = await _read_entries(link, order="lifo")
    last = max(newest, default=0)
    marks = (_mark_of(last, newest[last]) if newest else _EMPTY,)
    if not since or since == (_EMPTY,):
        later = [] if not since else list(newest.values())
        return PositionHistory(position_alarms(later), marks, is_whole=True)
    number = _number_of(since[0])
    found = newest if number is None or number > last else newest | await _read_from(link, number, last)
    is_whole = number in found and _mark_of(number, found[number]) == since[0]
    later = [entry for n, entry in found.items() if not is_whole or n > (number or 0)]
    return PositionHistory(position_alarms(later), marks, is_whole)


async def _read_from(link: WebLink, number: int, last: int) -> Entries:
    """Return the entries from a number on, as many at a time as the controller gives."""
    found: Entries = {}
    begin = number
    for _ in range(_MOST_PAGES):
        page = await _read_entries(link, order="fifo", elogseqnum=str(begin))
        if not page or max(page) <= max(found, default=-1):
            break
        found |= page
        begin = max(found)
        if begin >= last:
            break
    return found


async def _read_entries(link: WebLink, **query: str) -> Entries:
    document = await link.get_document(COMMON_LOG, lang="en", **query)
    states = link.dialect.states_in(document) or ()
    numbered = ((_number_of(str(state.get("_title", ""))), state) for state in states if is_entry(state))
    return {number: state for number, state in numbered if number is not None}


def _mark_of(number: int, entry: Mapping[str, Any]) -> str:
    return f"{entry['tstamp']} {entry['code']}/{number}"


def _number_of(title: str) -> int | None:
    text = title.rpartition("/")[2]
    return int(text) if text.isascii() and text.isdigit() and len(text) < 10 else None
