"""What stands above the numbers of a table: names, units, groups of columns, or nothing but remarks."""

import re
from collections import Counter
from collections.abc import Sequence

from cellcal.service.engineering.measured.headings import unit_named

_BRACKETS = "[]()\uff08\uff09 "
_MARKS = ("//", "#", "%")
_OTHER_UNITS = frozenset(
    {"", "degc", "°c", "℃", "c", "s", "sec", "ms", "-", "1", "k", "mbar", "hpa", "%", "n", "nm", "v"}
)
_RULE = re.compile(r"[\s|+:=\-_]*(?:--|==|-:|:-)[\s|+:=\-_]*")  # |---|:---:| of Markdown, +=====+
_ROUNDED_UNIT = 0.02  # of the square of a quaternion's length
_FEWEST_COUNTED = 3  # joints side by side
_FEWEST_ONLY_COUNTED = 5  # of a whole row
_AXES = re.compile(r"AXES\s*=\s*CARTESIAN\s*:\s*X\s*,\s*Y\s*,\s*Z\s*\(([^)]*)\)", re.IGNORECASE)

Cells = list[float | str]


def is_remark(row: Sequence[float | str]) -> bool:
    """Return whether a line is a remark: it begins with a mark that begins no number or name, or is a drawn rule."""
    filled = [cell for cell in row if cell != ""]
    if filled and all(isinstance(cell, str) and _RULE.fullmatch(cell) for cell in filled):
        return True
    first = filled[0] if filled else ""
    return isinstance(first, str) and first.lstrip().startswith(_MARKS)


def is_counting_heading(row: Cells, below: Cells) -> bool:
    """Return whether a row names some columns and counts the others: 1 to 6 below "Joint angles", and X, Y, Z."""
    named = any(
        isinstance(cell, str) and cell and isinstance(under, float)
        for cell, under in zip(row, below, strict=False)
    )
    runs: list[list[float]] = []
    for cell in row:
        if not isinstance(cell, float):
            continue
        if runs and cell == runs[-1][-1] + 1.0:
            runs[-1].append(cell)
        else:
            runs.append([cell])
    return named and bool(runs) and all(run[0] in (0.0, 1.0) and len(run) >= _FEWEST_COUNTED for run in runs)


def only_counts(row: Cells) -> bool:
    """Return whether a row does nothing but count its columns from 0 or 1, as programs write that know no names."""
    filled = [cell for cell in row if cell != ""]
    count = len(filled)
    return count >= _FEWEST_ONLY_COUNTED and filled in (
        [float(at) for at in range(count)],
        [float(at) for at in range(1, count + 1)],
    )


def numbers_groups(row: Cells, between: Sequence[Cells]) -> bool:
    """Return whether a row numbers groups of columns (the ID of Motive's rigid bodies): their names stand below it.

    ``between`` are the rows between it and the next row of numbers.
    """
    width = sum(cell != "" for cell in row)
    whole = all(cell.is_integer() for cell in row if isinstance(cell, float))
    named = [sum(isinstance(cell, str) and bool(cell) for cell in cells) for cells in between]
    return whole and any(count > width for count in named)


def heading_names(above: Sequence[Cells], width: int) -> tuple[str, ...] | None:
    """Return the header above the numbers, with a line of units or of groups if there is one; None without any."""
    lines = [words for row in above if any(words := [_word_of(cell) for cell in row]) and not _is_rule(row)]
    lines = [_with_joined_words(_without_mark(row, width), width) for row in lines]
    header = [at for at, row in enumerate(lines) if len(row) >= width or sum(map(bool, row)) >= width]
    if not header:
        return None
    at = header[-1]
    names, units = lines[at], [""] * len(lines[at])
    if len(header) > 1 and _are_units(lines[at]):
        names, units, at = lines[header[-2]], lines[at], header[-2]
    if _duplicate_names(names) or any(name.isdecimal() for name in names):
        names = _with_groups(names, lines[:at])
    joined = [
        f"{n} [{u.strip(_BRACKETS)}]" if u and u not in n else n
        for n, u in zip(names, [*units, *[""] * len(names)], strict=False)
    ]
    return tuple(name or f"column {i + 1}" for i, name in enumerate(joined))


def _word_of(cell: float | str) -> str:
    return f"{cell:g}" if isinstance(cell, float) else cell.strip()


def _is_rule(row: Cells) -> bool:
    return is_remark(row) and all(_RULE.fullmatch(_word_of(cell)) for cell in row if cell != "")


def doubled_name(names: Sequence[str]) -> str:
    """Return a name that occurs twice; empty if none does."""
    return next(iter(_duplicate_names(names)), "")


def name_quaternion_apart(names: tuple[str, ...], rows: Sequence[Cells]) -> tuple[str, ...]:
    """Return names with those of a quaternion told from those of joints: q1 to q6, and q1 to q4 of unit length."""
    doubled = sorted(_duplicate_names(names))
    if [name.lower() for name in doubled] not in (["q0", "q1", "q2", "q3"], ["q1", "q2", "q3", "q4"]):
        return names
    first = [names.index(name) for name in doubled]
    second = [names.index(name, at + 1) for name, at in zip(doubled, first, strict=True)]
    are_unit = [_are_of_unit_length(rows, columns) for columns in (first, second)]
    if sum(are_unit) != 1 or max(map(names.count, doubled)) > len(are_unit):
        return names
    columns = first if are_unit[0] else second
    return tuple(f"quaternion {name}" if at in columns else name for at, name in enumerate(names))


def _are_of_unit_length(rows: Sequence[Cells], columns: Sequence[int]) -> bool:
    cells = [[row[at] for at in columns] for row in rows if len(row) > max(columns)]
    numbers = [[each for each in row if isinstance(each, float)] for row in cells]
    squares = [sum(each * each for each in row) for row in numbers if len(row) == len(columns)]
    return bool(squares) and all(abs(square - 1.0) < _ROUNDED_UNIT for square in squares)


def names_without_heading(first: Cells, lines: Sequence[str]) -> tuple[str, ...]:
    """Return names of a table that has none: by their numbers, or as a remark of the exporting program has them."""
    names = [f"column {i + 1}" for i in range(len(first))]
    axes = next((match for line in lines if (match := _AXES.search(line))), None)
    numbers = [at for at, cell in enumerate(first) if isinstance(cell, float)]
    if axes is None or len(numbers) < 3:
        return tuple(names)
    unit = unit_named(axes[1])
    for axis, at in zip("XYZ", numbers, strict=False):
        names[at] = f"{axis} [{unit}]" if unit else axis
    if numbers[0] > 0:
        names[numbers[0] - 1] = "Point Name"
    return tuple(names)


def _duplicate_names(names: Sequence[str]) -> list[str]:
    return [name for name, count in Counter(n for n in names if n).items() if count > 1]


def _with_groups(names: list[str], above: Sequence[list[str]]) -> list[str]:
    """Return names that occur twice with the groups that a line above them has: Nominal, Actual over X, Y, Z."""
    for groups in reversed(above):
        if sum(map(bool, groups)) < 2 or len(groups) > len(names):
            continue
        filled, last = [], ""
        for at, name in enumerate(names):
            last = groups[at] if at < len(groups) and groups[at] else last
            filled.append(f"{last} {name}".strip())
        if not _duplicate_names(filled):
            return filled
    return names


def _with_joined_words(row: list[str], width: int) -> list[str]:
    """Return a header between blanks whose names are two words with each name whole: Nominal X, Nominal Y, Measure X.

    Only where a row has so many more words than numbers as words that occur more than once have others behind them.
    """
    if len(row) <= width:
        return row
    counts, joined = Counter(row[:-1]), list[str]()
    begins = False  # the name before is a first word that waits for its second
    for word in row:
        if begins:
            joined[-1] += f" {word}"
            begins = False
        else:
            joined.append(word)
            begins = counts[word] > 1
    return joined if len(joined) == width and not _duplicate_names(joined) else row


def _without_mark(row: list[str], width: int) -> list[str]:
    """Drop the comment mark of a header such as ``# q1 q2``; one that names a column stays."""
    if row and row[0] in _MARKS:
        return row[1:] if len(row) > width else row
    return [re.sub(r"^(//|[#%])\s*", "", row[0]), *row[1:]] if row else row


def _are_units(row: Sequence[str]) -> bool:
    cells = [cell.strip(_BRACKETS).lower() for cell in row]
    return any(cells) and all(cell in _OTHER_UNITS or bool(unit_named(cell)) for cell in cells)


def are_numbered(names: Sequence[str]) -> bool:
    """Return whether names only count the columns of a table without heading."""
    return any(re.fullmatch(r"column \d+( \[.*\])?", name) for name in names[:1])
