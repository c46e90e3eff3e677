"""Which rows of a table can be used: numbers in the columns that are needed, and not called bad by the file."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from cellcal.calibration.geometry import Array
from cellcal.calibration.message import make_message
from cellcal.service.engineering.measured.headings import plain_name
from cellcal.service.engineering.measured.table import MeasurementTable

UNREAD, OUTLIER, REPEAT, ELSEWHERE = "no reading", "outlier", "repeat", "another series"
_UNBELIEVABLE = 1e9  # in any unit that instruments write
_GOOD = frozenset(
    ("ok", "okay", "good", "valid", "true", "yes", "pass", "passed", "i.o.", "io", "gut", "gültig", "ja", "measured",
     "accepted", "success", "合格", "有效", "sí", "si", "bueno", "válido")
)  # fmt: skip
_BAD = frozenset(
    ("bad", "not ok", "nok", "n.i.o.", "nio", "fail", "failed", "invalid", "false", "no", "ng", "error", "rejected",
     "schlecht", "ungültig", "nein", "not measured", "beam lost", "lost", "hidden", "timeout", "occluded",
     "不合格", "无效", "malo", "inválido", "not accepted")
)  # fmt: skip
# Headings whose 1 is a good reading and whose 0 is none; a status or a quality of 0 may mean either.
_YES = frozenset(
    ("valid", "is_valid", "isvalid", "ok", "is_ok", "isok", "good", "is_good", "visible", "is_visible", "isvisible",
     "gültig", "有效", "measurement_valid", "data_valid", "reading_valid")
)  # fmt: skip
_STATUS = frozenset(
    ("status", "state", "result", "quality", "accepted", "measured", "measurement", "messung")
)
_OF_ANYTHING = frozenset(
    ("true", "false", "yes", "no", "ja", "nein", "sí", "si", "measured", "io", "error")
)  # say that a reading is valid only below a heading that asks so
_FEWEST_GOOD = 0.5  # of the rows: where fewer are, the words say something else


@dataclass(frozen=True, slots=True)
class RejectedRow:
    """A data row, counted from 0, that takes no part, and why."""

    row: int
    reason: str
    # or OUTLIER: it was read, and the fit does not believe it; or REPEAT of another row; or ELSEWHERE
    kind: str = UNREAD


def without_invalid(
    table: MeasurementTable,
    good: NDArray[np.bool_],
    rejected: tuple[RejectedRow, ...],
    used: Sequence[str],
) -> tuple[NDArray[np.bool_], tuple[RejectedRow, ...]]:
    """Return usable and rejected rows, without rows of which a column says that their reading is not valid."""
    remaining, invalid = good.copy(), []
    for name in table.names:
        if name in used:
            continue
        bad = _rows_called_bad(table, name)
        for row in np.flatnonzero(bad & remaining).tolist():
            reason = make_message(
                "line {line}: column {name!r} says {word!r}: not a valid reading",
                line=int(table.lines[row]),
                name=name,
                word=table.column_texts(name)[row],
            )
            invalid.append(RejectedRow(row, reason))
            remaining[row] = False
    return remaining, tuple(sorted((*rejected, *invalid), key=lambda each: each.row))


def _rows_called_bad(table: MeasurementTable, name: str) -> NDArray[np.bool_]:
    """Return the rows (N,) that a column of words, or of ones and zeros that its heading explains, calls bad."""
    at = table.names.index(name)
    none = np.zeros(len(table), dtype=bool)
    if np.isfinite(table.numbers[:, at]).all() and len(table):
        numbers = table.numbers[:, at]
        explained = plain_name(name) in _YES and set(numbers.tolist()) == {0.0, 1.0}
        bad = numbers == 0.0
        return bad if explained and bad.mean() <= 1.0 - _FEWEST_GOOD else none
    words = [" ".join(text.lower().split()) for text in table.column_texts(name)]
    if not set(words) <= _GOOD | _BAD | {""}:
        return none
    if set(words) & _OF_ANYTHING and plain_name(name) not in _YES | _STATUS:
        return none
    bad = np.array([word in _BAD for word in words])
    valid = sum(word in _GOOD for word in words)
    return bad if valid >= _FEWEST_GOOD * len(words) else none


def usable_rows(
    table: MeasurementTable, names: Sequence[str], numbers: Mapping[str, Array]
) -> tuple[NDArray[np.bool_], tuple[RejectedRow, ...]]:
    """Return which rows hold a number in each column that is needed, and why the others are left out."""
    values = np.column_stack([numbers[name] for name in names])
    missing = ~(np.abs(values) < _UNBELIEVABLE)  # and what is no number at all
    good: NDArray[np.bool_] = np.logical_not(missing.any(axis=1))
    rejected = []
    for row in np.flatnonzero(~good).tolist():
        name = names[int(np.argmax(missing[row]))]
        cell = table.texts.get((row, table.names.index(name)), "")
        what = make_message("holds {cell!r}, which is no number", cell=cell) if cell else "is empty"
        if not np.isnan(numbers[name][row]):
            what = make_message(
                "holds {number:g}, which marks a missing measurement", number=numbers[name][row]
            )
        rejected.append(
            RejectedRow(
                row,
                make_message(
                    "line {line}: column {name!r} {what}", line=table.lines[row], name=name, what=what
                ),
            )
        )
    return good, tuple(rejected)
