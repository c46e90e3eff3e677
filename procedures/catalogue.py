"""Everything that can be run."""

from difflib import get_close_matches

from procedures import mastering_record, six_point_tcp, three_point_frame
from procedures.entry import Entry
from procedures.run import ProcedureError

ENTRIES: tuple[Entry, ...] = (mastering_record.ENTRY, six_point_tcp.ENTRY, three_point_frame.ENTRY)


class UnknownProcedureError(ProcedureError):
    """No procedure has this name."""

    code = "procedure.unknown"


def entry_named(name: str) -> Entry:
    """Return one procedure's card.

    Raises
    ------
    UnknownProcedureError
        There is none of that name; the remedy names the nearest.
    """
    known = {entry.name: entry for entry in ENTRIES}
    if name not in known:
        near = get_close_matches(name, known, n=1) or sorted(known)
        raise UnknownProcedureError(f"there is no procedure {name!r}.", remedy=f"Did you mean {near[0]}?")
    return known[name]
