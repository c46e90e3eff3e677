"""Cells that hold a list of numbers: RAPID jointtargets, KRL aggregates, poses of URScript, lists of Python.

Such a cell becomes one column a number, before the separator of the file is looked for: the commas inside are no
separators.
"""

import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from cellcal.calibration.documents.csv_text import split_row
from cellcal.calibration.message import make_message
from cellcal.service.engineering.measured.errors import MeasurementError

_OPEN, _CLOSE = "[{(", "]})"
_QUOTE = '"'
_FEWEST = 3  # numbers of a list
_FEWEST_IN_QUOTES = 5
_MOSTLY = 0.5  # of the lines
_LONGEST_LINE = 20_000
_MOST_BRACKETS = 100
_SEPARATORS = (";", "\t", ",", "|")
_MARK = "\x00"  # stands for a list
_ITEM = re.compile(
    r"\s*(?:(?P<name>[A-Za-z]\w?)[\s=:]+)?(?P<number>[+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?)\s*(?:,|;|\s|$)"
)
_DECIMAL_COMMA = re.compile(r"(?<=\d),(?=\d)")
_UNUSED = 8.9e9  # 9E9 marks an axis that is not there
_PLACE_WORDS = re.compile(  # joint_positions are no place
    r"^(?!.*(?:joint|axes|axis)).*(?:pose|robtarget|position|point|place|tcp|xyz|flange|tool|measured|tracker)",
    re.IGNORECASE,
)
_ATTITUDE_WORDS = re.compile(r"orientation|rotation|quat|attitude", re.IGNORECASE)
_QUATERNION = 4  # numbers
_PLACES = {
    3: "x y z",
    6: "x y z rx ry rz",
    7: "x y z q1 q2 q3 q4",
    11: "x y z q1 q2 q3 q4 cf1 cf4 cf6 cfx",
}  # names by how many numbers
_PROGRAM = re.compile(r"\b(jointtarget|robtarget|E6AXIS|E6POS|movej|movel)\b", re.IGNORECASE)
_CURE = "Write each number into a column of its own, one row a posture: q1 to q6, then what the device read."


@dataclass(frozen=True, slots=True)
class _Item:
    name: str
    number: str


def has_lists(lines: Sequence[str]) -> bool:
    """Return whether most of the first lines of a file hold lists of numbers in brackets."""
    filled = [line for line in lines if line.strip()]
    return bool(filled) and sum(bool(_take_lists(line)[1]) for line in filled) > _MOSTLY * len(filled)


def spread_lists(path: Path, lines: Sequence[str]) -> list[str]:
    """Return the lines of a table with one column a number of each list.

    Raises
    ------
    MeasurementError
        It is a program, its lists differ in length, or its columns cannot be told from the commas inside the lists.
    """
    taken = [_take_lists(line.rstrip("\r\n")) for line in lines]
    rows = [at for at, (_, lists) in enumerate(taken) if lists]
    if sum(bool(_PROGRAM.search(taken[at][0])) for at in rows) > _MOSTLY * len(rows):
        raise MeasurementError(
            make_message(
                "{path} holds the positions of a program, and nothing that a device read.", path=path
            ),
            remedy=_CURE,
        )
    above = [at for at in range(rows[0]) if taken[at][0].strip()]
    heading = above[-1] if above else -1
    separator = _separator_of(taken[heading][0] if above else "", taken[rows[0]][0])
    if not separator or len({tuple(map(len, taken[at][1])) for at in rows}) > 1:
        raise MeasurementError(
            make_message(
                "{path}: a cell of line {line} holds a list of numbers.", path=path, line=rows[0] + 1
            ),
            remedy=_CURE,
        )
    found = list(lines)
    found[heading] = separator.join(_spread_heading(taken[heading][0], taken[rows[0]], separator))
    for at in rows:
        found[at] = separator.join(_spread_row(taken[at], separator))
    return found


def _separator_of(heading: str, row: str) -> str:
    """Return what divides a heading and a row into equally many cells."""
    for separator in _SEPARATORS:
        count = len(split_row(heading, separator))
        if count > 1 and count == len(split_row(row, separator)):
            return separator
    return ""


def _spread_heading(heading: str, row: tuple[str, list[list[_Item]]], separator: str) -> list[str]:
    names, lists = [], iter(row[1])
    for name, cell in zip(split_row(heading, separator), split_row(row[0], separator), strict=True):
        names += _names_of(name.strip(), next(lists)) if _MARK in cell else [name]
    return names


def _names_of(name: str, items: Sequence[_Item]) -> list[str]:
    """Return names of the numbers of a list: its own, those of a place, or their count."""
    if all(item.name for item in items):
        return [f"{name} {item.name}" for item in items]
    if len(items) == _FEWEST or _PLACE_WORDS.search(name):
        axes = _PLACES.get(len(items), "")
        if axes:
            return [f"{name} {axis}" for axis in axes.split()]
    quaternion = "q" if len(items) == _QUATERNION and _ATTITUDE_WORDS.search(name) else ""
    separator = f" {quaternion}" if quaternion else "_"
    return [f"{name}{separator}{at}" for at in range(1, len(items) + 1)]


def _spread_row(row: tuple[str, list[list[_Item]]], separator: str) -> list[str]:
    lists = iter(row[1])
    cells: list[str] = []
    for cell in split_row(row[0], separator):
        cells += [item.number for item in next(lists)] if _MARK in cell else [_quoted(cell, separator)]
    return cells


def _quoted(cell: str, separator: str) -> str:
    return f'"{cell}"' if separator in cell and '"' not in cell else cell


def _take_lists(line: str) -> tuple[str, list[list[_Item]]]:
    """Return a line with a mark in place of each list of numbers, and the lists."""
    if len(line) > _LONGEST_LINE or sum(map(line.count, _OPEN)) > _MOST_BRACKETS:
        return line, []
    plain_cells: list[str] = []
    lists: list[list[_Item]] = []
    at, quoted = 0, False
    while at < len(line):
        quoted ^= line[at] == _QUOTE
        end, items = _list_from(line, at, opens=quoted)
        if items:
            lists.append(items)
            plain_cells.append(_MARK)
            at, quoted = end + 1, quoted and line[at] != _QUOTE
        else:
            plain_cells.append(line[at])
            at += 1
    return "".join(plain_cells), lists


def _list_from(line: str, at: int, *, opens: bool) -> tuple[int, list[_Item]]:
    """Return where a list that begins here ends, and its numbers; empty without one.

    In quotes alone stand lists of at least five numbers, or of numbers with a point: "1,234,567" is one number.
    """
    if line[at] in _OPEN:
        end = _end_of(line, at)
        items = _items_of(line[at : end + 1]) if end else []
        return end, items if len(items) >= _FEWEST else []
    if line[at] != _QUOTE or not opens:
        return 0, []
    end = line.find(_QUOTE, at + 1)
    items = _items_of(line[at + 1 : end]) if end > 0 else []
    pointed = len(items) >= _FEWEST and all("." in item.number for item in items)
    return end, items if pointed or len(items) >= _FEWEST_IN_QUOTES else []


def _end_of(line: str, start: int) -> int:
    """Return where the bracket that opens here closes; zero where it does not."""
    depth = 0
    for at in range(start, len(line)):
        depth += (line[at] in _OPEN) - (line[at] in _CLOSE)
        if depth == 0:
            return at
    return 0


def _items_of(text: str) -> list[_Item]:
    """Return the numbers of a list, without those that mark axes which are not there; empty for anything else."""
    inside = re.sub(r"[\[\](){}]", " ", text)
    if ";" in inside and "." not in inside:  # then a comma is decimal
        inside = _DECIMAL_COMMA.sub(".", inside)
    inside = re.sub(r"\s*,\s*", ",", inside.strip())
    items, at = [], 0
    while at < len(inside):
        match = _ITEM.match(inside, at)
        if match is None:
            return []
        items.append(_Item(match["name"] or "", match["number"]))
        at = match.end()
    return [item for item in items if abs(float(item.number)) < _UNUSED]
