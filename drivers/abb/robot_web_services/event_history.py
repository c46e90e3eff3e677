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
_FIRST = 1  # number of a log's first entry; where it is gone, so may others be
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
    if not since:
        return PositionHistory((), marks, is_whole=True)
    number = 0 if since[0] == _EMPTY else _number_of(since[0])
    if number is None or number > last:
        found, is_whole = newest, False
    else:
        earlier = await _read_from(link, number, last)
        found = newest | earlier
        is_joined = max(earlier, default=0) >= min(newest, default=0)
        is_whole = is_joined and _begins_at(since[0], number, found)
    later = [entry for n, entry in found.items() if not is_whole or n > (number or 0)]
    return PositionHistory(position_alarms(later), marks, is_whole)


def _begins_at(mark: str, number: int, found: Entries) -> bool:
    """Return whether entries reach back to a mark: of a log without entries to the first one that it got."""
    if mark == _EMPTY:
        return min(found, default=0) <= _FIRST
    return number in found and _mark_of(number, found[number]) == mark


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
