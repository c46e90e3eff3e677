"""Files that hold a posture over several lines, or each number behind its name: written as a table of one row each.

``POSE 1`` / ``JOINTS 10.0 …`` / ``LENGTH 812.3``, ``J1: 10.0`` one below the other, ``J1=10.0 J2=-5.0 … X=812.3``.
Read only where every record holds the same names with as many numbers, in one order.
"""

import re
from collections.abc import Sequence
from pathlib import Path

from cellcal.calibration.message import make_message
from cellcal.service.engineering.measured.errors import MeasurementError

_NUMBER = r"[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?"
_NAMED = re.compile(rf"\s*([^\W\d_][\w .()\[\]/°-]*?)\s*[=:]\s*({_NUMBER})(?=[\s,;]|$)[\s,;]*")
_LISTED = re.compile(rf"\s*([^\W\d_][\w()\[\]/°-]*)[\s,;:=]+({_NUMBER}(?:[\s,;]+{_NUMBER})*)[\s,;]*")
_APART = re.compile(r"[\s,;]+")
_FEWEST_RECORDS = 5
_FEWEST_NUMBERS = 4  # of a record
_MOST_ABOVE = 60  # lines before the first record
_LONGEST = 2000  # characters of a line

_Part = tuple[str, tuple[str, ...]]  # a name and the numbers behind it


def holds_records(lines: Sequence[str]) -> bool:
    """Return whether the first lines of a file are records; the last of them may be cut off."""
    parts = _parts_behind(lines)
    length = _record_length(parts)
    shapes = (
        [_shape(parts[at : at + length]) for at in range(0, len(parts) - length + 1, length)]
        if length
        else []
    )
    some = shapes[:_FEWEST_RECORDS]
    if len(some) < _FEWEST_RECORDS or any(shape != some[0] for shape in some):
        return False
    counts = [count for _, count in some[0]]
    # As many numbers behind each name are rows of a table whose points come again (P1, P2, P3, P1 …).
    return sum(counts) >= _FEWEST_NUMBERS and (max(counts) == 1 or len(set(counts)) > 1)


def join_records(path: Path, lines: Sequence[str]) -> list[str]:
    """Return a table with a heading and one row a record.

    Raises
    ------
    MeasurementError
        A record that is not like the first one.
    """
    parts = _parts_behind(lines)
    length = _record_length(parts)
    records = [parts[at : at + length] for at in range(0, len(parts), length)]
    shape = _shape(records[0])
    for number, record in enumerate(records, start=1):
        if _shape(record) != shape:
            raise MeasurementError(
                make_message(
                    "{path} holds a posture over several lines ({names}), and posture {number} has others.",
                    path=path,
                    names=", ".join(name for name, _ in shape),
                    number=number,
                ),
                remedy="Write one row a posture: the names once above, below them the numbers.",
            )
    heading = [name if count == 1 else f"{name} {k}" for name, count in shape for k in range(1, count + 1)]
    return [";".join(heading), *(";".join(n for _, numbers in record for n in numbers) for record in records)]


def _shape(record: Sequence[_Part]) -> list[tuple[str, int]]:
    return [(name, len(numbers)) for name, numbers in record]


def _parts_behind(lines: Sequence[str]) -> list[_Part]:
    """Return the parts of all records; a line that is none of them is a part without numbers."""
    filled = [line for line in lines if line.strip()]
    first = next((at for at in range(min(len(filled), _MOST_ABOVE)) if _names_return(filled, at)), None)
    if first is None:
        return []
    return [part for line in filled[first:] for part in _parts_of(line) or [(line.strip(), ())]]


def _names_return(filled: Sequence[str], at: int) -> bool:
    """Return whether a line may begin the records: its first name comes again soon, with as many numbers."""
    own = _parts_of(filled[at])
    if not own:
        return False
    name, numbers = own[0]
    behind = [part for line in filled[at + 1 : at + 1 + _MOST_ABOVE] for part in _parts_of(line)]
    return (name, len(numbers)) in [(other, len(more)) for other, more in behind]


def _record_length(parts: Sequence[_Part]) -> int:
    """Return how many names there are until the first one comes again; zero for a name that stands in every line."""
    names = [name for name, _ in parts]
    length = names.index(names[0], 1) if names and names.count(names[0]) > 1 else 0
    return length if length > 1 and len(set(names[:length])) == length else 0


def _parts_of(line: str) -> list[_Part]:
    """Return the names of a line with their numbers; none where it holds anything else."""
    if len(line) > _LONGEST:
        return []
    for pattern in (_NAMED, _LISTED):
        found, at = list[_Part](), 0
        while at < len(line) and (match := pattern.match(line, at)):
            found.append((match[1].strip(), tuple(_APART.split(match[2].strip()))))
            at = match.end()
        if found and at == len(line):
            return found
    return []
