"""Joints on one sheet or in one file, readings on another: joined where a column of both proves the pairs."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from cellcal.calibration.message import join_messages, make_message
from cellcal.service.engineering.measured.headings import plain_name
from cellcal.service.engineering.measured.table import MeasurementError, MeasurementTable, read_table

_FEWEST_PAIRED = 0.5  # of the rows of the shorter sheet
_MOST_NAMED = 4

Pairs = tuple[tuple[int, int], ...]  # rows of the one and of the other


@dataclass(frozen=True, slots=True)
class _Key:
    """A column of each of two tables whose values name the rows; none where their order does."""

    columns: tuple[int, int] | None
    pairs: Pairs
    only_counts: bool  # both count their own rows, one more or less


def joined_tables(
    path: Path, table: MeasurementTable, stands_alone: Callable[[MeasurementTable], bool]
) -> Iterator[MeasurementTable]:
    """Give a sheet with each further sheet whose rows are provably those of the same points.

    Sheets that stand alone, such as another day's series, are passed over.

    Raises
    ------
    MeasurementError
        A sheet has columns that would pair its rows, and they contradict each other, or only count rows and differ in
        number.
    """
    for name in table.sheets[1:]:
        other = read_table(path, sheet=name)
        other = replace(other, sheets=(name,))
        key = None if stands_alone(other) else _key_of(table, other)
        if key is not None:
            yield _join(table, other, key)


def joined_files(readings: MeasurementTable, joints: MeasurementTable) -> MeasurementTable:
    """Return readings with the joints of another file, by a column that both have, else row by row.

    Columns that both have begin with "measured" and "robot". Whether rows that only their order pairs belong
    together is for the fit to say.

    Raises
    ------
    MeasurementError
        Neither a column nor equal numbers of rows tell which belong together.
    """
    readings, joints = replace(readings, sheets=("measured",)), replace(joints, sheets=("robot",))
    key = _key_of(readings, joints)
    if key is None and len(readings) != len(joints):
        raise MeasurementError(
            make_message(
                "{count} rows of readings and {other_count} of joints: no column of both names the points, and which "
                "rows belong together is not told.",
                count=len(readings),
                other_count=len(joints),
            ),
            remedy="Give every point a name or number of its own in both files, or leave only rows that belong "
            "together, in one order.",
        )
    every = tuple((at, at) for at in range(len(readings)))
    return _join(readings, joints, key or _Key(None, every, only_counts=True))


def _key_of(table: MeasurementTable, other: MeasurementTable) -> _Key | None:
    found = [key for key in _possible_keys(table, other) if _is_enough(key, table, other)]
    sure = [key for key in found if not key.only_counts] or found
    if not sure:
        return None
    sheets = {"sheet": table.sheets[0], "other": other.sheets[0]}
    if len({key.pairs for key in sure}) > 1:
        raise MeasurementError(
            make_message(
                "columns {columns} pair the rows of sheets {sheet!r} and {other!r} differently.",
                columns=", ".join(repr(table.names[key.columns[0]]) for key in sure if key.columns),
                **sheets,
            ),
            remedy="Leave one column in both sheets that names the points, or bring joints and readings into one "
            "sheet.",
        )
    if sure[0].only_counts and len(table) != len(other):
        raise MeasurementError(
            make_message(
                "column {column!r} only counts the rows of sheets {sheet!r} and {other!r}, which have {count} and "
                "{other_count}: which belong together is not told.",
                column=table.names[sure[0].columns[0]] if sure[0].columns else "",
                count=len(table),
                other_count=len(other),
                **sheets,
            ),
            remedy="Give every point a name or number of its own, in both sheets, or bring them into one sheet.",
        )
    return sure[0]


def _possible_keys(table: MeasurementTable, other: MeasurementTable) -> Iterator[_Key]:
    """Give columns called alike, and columns of words that say the same, whatever they are called."""
    columns, others = _texts_of(table), _texts_of(other)
    words, other_words = [_are_words(texts) for texts in columns], [_are_words(texts) for texts in others]
    for at, mine in enumerate(columns):
        for to, theirs in enumerate(others):
            alike = plain_name(table.names[at]) == plain_name(other.names[to])
            pairs = _paired(mine, theirs) if alike or (words[at] and other_words[to]) else ()
            if pairs:
                yield _Key((at, to), pairs, _counts_rows(mine) and _counts_rows(theirs))


def _texts_of(table: MeasurementTable) -> list[list[str]]:
    return [[text.strip().casefold() for text in table.column_texts(name)] for name in table.names]


def _are_words(texts: Sequence[str]) -> bool:
    return not any(text.replace(".", "", 1).lstrip("+-").isdecimal() for text in texts)


def _counts_rows(texts: Sequence[str]) -> bool:
    """Return whether a column holds 1, 2, 3 … or 0, 1, 2 … and no more."""
    return any(list(texts) == [str(at + first) for at in range(len(texts))] for first in (0, 1))


def _paired(mine: Sequence[str], theirs: Sequence[str]) -> Pairs:
    """Return rows of the same value; none where a value names several rows of both, or none at all."""
    filled, others = [text for text in mine if text], [text for text in theirs if text]
    if len(set(others)) == len(others):
        row = {text: at for at, text in enumerate(theirs) if text}
        return tuple((at, row[text]) for at, text in enumerate(mine) if text in row)
    if len(set(filled)) == len(filled):
        return tuple((at, to) for to, at in _paired(theirs, mine))
    return ()


def _is_enough(key: _Key, table: MeasurementTable, other: MeasurementTable) -> bool:
    paired = [len({rows[side] for rows in key.pairs}) for side in (0, 1)]
    return max(paired) >= 2 and max(paired) >= _FEWEST_PAIRED * min(len(table), len(other))


def _join(table: MeasurementTable, other: MeasurementTable, key: _Key) -> MeasurementTable:
    own_key = None if key.columns is None else key.columns[1]
    other_columns = [at for at in range(len(other.names)) if at != own_key]
    rows, others = ([pair[side] for pair in key.pairs] for side in (0, 1))
    width = len(table.names)
    place = {at: width + new for new, at in enumerate(other_columns)}
    texts = {
        (new, at): text
        for new, row in enumerate(rows)
        for at in range(width)
        if (text := table.texts.get((row, at)))
    }
    texts |= {
        (new, place[at]): text
        for new, row in enumerate(others)
        for at in other_columns
        if (text := other.texts.get((row, at)))
    }
    return MeasurementTable(
        names=_names_apart(table, other, other_columns),
        numbers=np.hstack([table.numbers[rows], other.numbers[others][:, other_columns]]),
        texts=texts,
        lines=table.lines[rows],
        dialect=_dialect(table, other, key),
        doubts={**table.doubts, **{place[at]: why for at, why in other.doubts.items() if at in place}},
        uncalculated={
            **table.uncalculated,
            **{place[at]: line for at, line in other.uncalculated.items() if at in place},
        },
    )


def _names_apart(
    table: MeasurementTable, other: MeasurementTable, other_columns: Sequence[int]
) -> tuple[str, ...]:
    """Return the names of all columns; those that both sheets have begin with the sheet's."""
    behind = [other.names[at] for at in other_columns]
    both = {plain_name(name) for name in table.names} & {plain_name(name) for name in behind}
    return tuple(
        f"{sheet} {name}" if plain_name(name) in both else name
        for sheet, names in ((table.sheets[0], table.names), (other.sheets[0], behind))
        for name in names
    )


def _dialect(table: MeasurementTable, other: MeasurementTable, key: _Key) -> str:
    if key.columns is None:
        return make_message(
            "joints and readings are joined row by row: {count} rows; no column of both names the points, and the "
            "fit must show that they belong together",
            count=len(key.pairs),
        )
    words = [
        make_message(
            "{sheet!r} and {other!r}, joined by column {column!r}: {count} rows",
            sheet=table.sheets[0],
            other=other.sheets[0],
            column=table.names[key.columns[0]],
            count=len(key.pairs),
        )
    ]
    for side, one in enumerate((table, other)):
        paired = {rows[side] for rows in key.pairs}
        alone = [
            text for at, text in enumerate(one.column_texts(one.names[key.columns[side]])) if at not in paired
        ]
        if alone:
            words.append(
                make_message(
                    "{count} rows of {sheet!r} have no partner: {names}",
                    count=len(alone),
                    sheet=one.sheets[0],
                    names=", ".join(alone[:_MOST_NAMED]),
                )
            )
    return join_messages("; ", words)
