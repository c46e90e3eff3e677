"""ABSO.DAT: the absolute data of each axis, which are the encoder counts of its home position.

::

    //ABSO
    ///CRC 3436094589
    ///RBPRM 3,63,63,0,0, ...
    1,-52,1,-81234,1,70125,1,4903
    1,-11020,1,-79008,1,133,1,-80117

Seen in public backups of an SDA20D, a GP88 (YAS4.30) and two GP25 (YAS4.81): RBPRM has a bit for each control group
and a bit for each axis of each group; pairs of a flag and a number follow, those of robot 1 first. Only the newest of
them has the CRC. What the flag means beyond "there" is in no document that was found.
"""

import re

_GROUPS = re.compile(r"///RBPRM\s+(\d{1,9})\s*,\s*(\d{1,9})\s*(?:,|\Z)")
_ROW = re.compile(r"(?:\d,-?\d{1,10})(?:,\d,-?\d{1,10})*\Z")  # flag and count of an axis
_ROBOT_1 = 1


def read_absolute_data(text: str) -> tuple[int | None, ...]:
    """Return the numbers of robot 1, None of an axis without one; empty where the text is no such file."""
    axes = 0
    values: list[int | None] = []
    for line in (line.strip() for line in text.splitlines()):
        found = _GROUPS.match(line)
        if found is not None:
            axes = int(found[2]).bit_count() if int(found[1]) & _ROBOT_1 else 0
        elif axes and line and not line.startswith("/"):
            if not _ROW.match(line):
                return ()  # what follows would be taken for other axes
            numbers = [int(number) for number in line.split(",")]
            values += [
                number if flag else None for flag, number in zip(numbers[::2], numbers[1::2], strict=True)
            ]
    return tuple(values[:axes]) if len(values) >= axes else ()
