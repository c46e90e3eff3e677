"""What the alarm history says of the position: lists of 100 alarms each, which outlive a reset.

Source: the numbers of the lists as three clients cite them from HW1483358 and 160766-1CD: major alarms from 1, minor
ones from 1001. Which list an alarm is in depends on its number and the controller, so both are read.
"""

from cellcal.drivers.errors import RefusedError
from cellcal.drivers.interfaces import PositionHistory
from cellcal.drivers.yaskawa.condition import concerns_position, describe_alarm
from cellcal.drivers.yaskawa.hses_link import HsesLink
from cellcal.drivers.yaskawa.state import MARKED, LoggedAlarm, marks_of, read_logged_alarms

_LISTS = (1, 1001)
_BETWEEN = " | "  # marks of one list


async def read_position_history(link: HsesLink, since: tuple[str, ...]) -> PositionHistory:
    """Return what concerns the position behind the alarms with these marks, one for each list.

    Raises
    ------
    RefusedError
        The controller gives no history.
    """
    earlier = [tuple(filter(None, mark.split(_BETWEEN))) for mark in since]
    lists = [
        await _read_list(link, first, earlier[k] if k < len(earlier) else None)
        for k, first in enumerate(_LISTS)
    ]
    marks = tuple(_BETWEEN.join(marks_of(found[:MARKED])) for found in lists)
    if not since:
        return PositionHistory((), marks, is_whole=True)
    later: list[LoggedAlarm] = []
    is_whole = True
    for found, places in zip(lists, earlier, strict=False):
        new = len(found) - len(places)
        is_reached = new >= 0 and marks_of(found[new:]) == places
        later += found[:new] if is_reached else found
        is_whole = is_whole and is_reached
    alarms = [alarm for each in later for alarm in describe_alarm(each.alarm) if concerns_position(alarm)]
    return PositionHistory(tuple(alarms), marks, is_whole)


async def _read_list(link: HsesLink, first: int, known: tuple[str, ...] | None) -> tuple[LoggedAlarm, ...]:
    """Return one list; an empty one where the controller does not have it."""
    try:
        return await read_logged_alarms(link, first, known)
    except RefusedError:
        if first == _LISTS[0]:
            raise
        return ()
