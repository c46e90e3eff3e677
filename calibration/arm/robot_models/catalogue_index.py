"""The catalogue: what it lists, how it is searched, and the data of one robot.

``catalogue/index.json`` names every robot; the numbers stand in one file a maker. Both are written by
``deploy/robot_catalogue/build.py``.
"""

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from difflib import SequenceMatcher, get_close_matches
from functools import cache
from itertools import takewhile
from pathlib import Path
from typing import Any
from unicodedata import combining, normalize

from cellcal.calibration.arm.robot_models.common_names import (
    COMMON_NAMES,
    FILLER_WORDS,
    SOLD_AS,
    axes_meant,
    kind_meant,
)
from cellcal.calibration.documents.json_text import parse_json
from cellcal.calibration.documents.plain_files import read_plain_text

_FOLDER = Path(__file__).parent / "catalogue"
_WORD = re.compile(r"[a-z]+|\d+")
_PART = re.compile(r"[\s_/()-]+")
_NEAR = 0.75
_NEAREST = 0.6  # of a name that is worth a suggestion
_FEWEST_LETTERS = 3  # of a name that is begun
_ALIKE_WORDS = 3  # that a mistyped one may stand for
_SERIES = 2  # words that name one: its letters and its number
_REACH = re.compile(r"\b\d\.\d+")
LINKAGE = "linkage"  # kind of an arm of which rods drive an axis


@dataclass(frozen=True, slots=True)
class CatalogueEntry:
    """One robot as it is listed."""

    name: str
    title: str
    maker: str
    family: str
    kind: str  # serial | linkage | scara | positioner
    axes: int
    licence: str  # of the source
    doubts: int
    file: str  # of its maker; empty where it is withheld
    withheld: str  # why its numbers do not ship; empty where they do

    @property
    def usable(self) -> bool:
        """Whether its numbers ship."""
        return not self.withheld


@cache
def catalogue_entries() -> tuple[CatalogueEntry, ...]:
    """Return all robots that the catalogue knows, sorted by name; also those that it withholds."""
    return tuple(CatalogueEntry(*row) for row in _read_file("index"))


@cache
def usable_names() -> frozenset[str]:
    """Return the names of the robots whose numbers ship."""
    return frozenset(entry.name for entry in catalogue_entries() if entry.usable)


def withheld_reason(name: str) -> str | None:
    """Return why the numbers of a listed robot do not ship; None where they do, or where it is not listed."""
    return next(
        (entry.withheld for entry in catalogue_entries() if entry.name == name and entry.withheld), None
    )


def catalogue_robot(name: str) -> Mapping[str, Any]:
    """Return the data of one robot whose numbers ship: the keys of a model file, its source and doubts.

    Raises
    ------
    KeyError
        There is none of this name.
    """
    entry = next((each for each in catalogue_entries() if each.name == name and each.usable), None)
    if entry is None:
        raise KeyError(name)
    return _maker_file(entry.file)[name]


def find_robots(words: str, maker: str = "") -> tuple[CatalogueEntry, ...]:
    """Return the robots that fit all words, best first, then those whose names are nearly so written.

    A word fits where its letters and digits stand in the name, title, maker or family, in any spelling: ``kr210``,
    ``KR 210`` and ``kr-210`` are the same. Common names (``panda``), kinds (``scara``) and numbers of axes
    (``7 axis``) fit, too.
    """
    entries = [
        entry for entry in catalogue_entries() if _plain_spelling(maker) in _plain_spelling(entry.maker)
    ]
    search_words = _wanted_words(words)
    if not search_words:
        return tuple(entries)
    together = "".join(search_words)
    fitting = [entry for entry in entries if _fits_words(entry, search_words, together)]
    if not fitting:
        meant = [_nearest_words(word, entries) for word in search_words]
        fitting = [
            entry
            for entry in entries
            if all(any(_word_fits(one, entry, _words_of_entry(entry)) for one in each) for each in meant)
        ]
    if not fitting:
        fitting = [
            entry
            for entry in entries
            if _shared_words(entry, words) >= _SERIES or _similarity(entry, together, beginning=True) >= _NEAR
        ]
    return tuple(sorted(fitting, key=lambda each: _order_key(each, words, together)))


def is_called(entry: CatalogueEntry, words: str) -> bool:
    """Return whether all words fit a robot; others of `find_robots` are only nearly so written."""
    search_words = _wanted_words(words)
    return _fits_words(entry, search_words, "".join(search_words))


def robot_spelled(words: str) -> str:
    """Return the one robot whose name or title this is in another spelling, with or without its maker; else none."""
    spelling = _plain_spelling(words)
    tells = not spelling.isalpha() and not spelling.isdecimal()  # letters or a number alone are a series
    return SOLD_AS.get(spelling) or (_names_by_spelling().get(spelling, "") if tells else "")


@cache
def _names_by_spelling() -> dict[str, str]:
    found: dict[str, str] = {}
    for entry in catalogue_entries():
        makers = {_plain_spelling(entry.file), _plain_spelling(entry.maker)}
        whole = {_plain_spelling(entry.name), _plain_spelling(entry.title)}
        for spelling in whole | {text.removeprefix(maker) for text in whole for maker in makers}:
            same = found.setdefault(spelling, entry.name) == entry.name and entry.usable
            found[spelling] = entry.name if same else ""
    return found


def nearest_names(name: str) -> list[str]:
    """Return names that a mistyped one may stand for, the nearest first."""
    found = [entry.name for entry in find_robots(name.replace("_", " ")) if entry.usable]
    return found[:3] or get_close_matches(name, sorted(usable_names()), n=1, cutoff=0.8)


def least_unlike(words: str) -> list[str]:
    """Return the names of up to three robots that are least unlike words which fit none."""
    together = "".join(_wanted_words(words))
    usable = [entry for entry in catalogue_entries() if entry.usable]
    alike = [(_similarity(entry, together, beginning=True), entry.name) for entry in usable]
    return [
        name
        for similarity, name in sorted(alike, key=lambda each: (-each[0], each[1]))[:3]
        if similarity >= _NEAREST
    ]


def _wanted_words(words: str) -> list[str]:
    """Return the words that say something, a number of axes as one: ``7 axis`` is ``7axis``."""
    plain = [_plain_spelling(word).removesuffix("series") for word in words.split()]
    plain = [word for word in plain if word]
    joined: list[str] = []
    for word in plain:
        if joined and axes_meant(joined[-1] + word) is not None:
            joined[-1] += word
        else:
            joined.append(word)
    return [word for word in joined if word not in FILLER_WORDS] or joined


def _fits_words(entry: CatalogueEntry, search_words: list[str], together: str) -> bool:
    text = _words_of_entry(entry)
    return _is_called_so(together, text) or all(_word_fits(word, entry, text) for word in search_words)


def _word_fits(word: str, entry: CatalogueEntry, text: Sequence[str]) -> bool:
    axes, kind = axes_meant(word), kind_meant(word)
    if axes is not None:
        return entry.axes == axes
    if kind is not None:
        return entry.kind == kind
    return _is_called_so(word, text) or any(meant in "".join(text) for meant in COMMON_NAMES.get(word, ()))


def _is_called_so(word: str, text: Sequence[str]) -> bool:
    """Return whether a word stands in the words of a robot; letters alone do not begin in one and end in another.

    ``wam`` is no part of ``yaskawa mh5``.
    """
    if not word.isalpha():
        return word in "".join(text)
    return any(word in part or "".join(text[first:]).startswith(word) for first, part in enumerate(text))


def _nearest_words(word: str, entries: Sequence[CatalogueEntry]) -> tuple[str, ...]:
    """Return the words of the catalogue that a mistyped one is nearest to; the word itself where none is near."""
    if any(_word_fits(word, entry, _words_of_entry(entry)) for entry in entries):
        return (word,)
    parts = (_PART.split(f"{entry.name} {entry.title} {entry.maker} {entry.family}") for entry in entries)
    catalogue_words = {_plain_spelling(part) for some in parts for part in some} | COMMON_NAMES.keys()
    begun = tuple(name for name in COMMON_NAMES if len(word) >= _FEWEST_LETTERS and name.startswith(word))
    return (
        begun
        or tuple(get_close_matches(word, sorted(catalogue_words), n=_ALIKE_WORDS, cutoff=_NEAR))
        or (word,)
    )


def _order_key(entry: CatalogueEntry, words: str, together: str) -> tuple[bool, int, float, str]:
    """Return what sorts the robot that is meant first."""
    return (
        not _is_called_so(together, _words_of_entry(entry)),
        -_shared_words(entry, words),
        -_similarity(entry, together),
        entry.name,
    )


def _shared_words(entry: CatalogueEntry, words: str) -> int:
    """Return how many words the name or title begins with as these do, without the maker: ``irb 6700`` are two."""
    makers = {*_WORD.findall(entry.file), *_WORD.findall(entry.maker.lower())}
    query, *spellings = (
        [word for word in _split_words(text) if word not in makers]
        for text in (words, entry.name, entry.title)
    )
    alike = (takewhile(lambda pair: pair[0] == pair[1], zip(own, query, strict=False)) for own in spellings)
    return max(len(list(begun)) for begun in alike)


@cache
def _words_of_entry(entry: CatalogueEntry) -> tuple[str, ...]:
    """Return the words of everything a robot is called; 0.58 m of reach also as 58, as in makers' file names."""
    reach = _REACH.sub(lambda found: f"{float(found[0]) * 100.0:.0f}", entry.title)
    return tuple(_split_words(f"{entry.name} {entry.title} {reach} {entry.maker} {entry.family}"))


def _similarity(entry: CatalogueEntry, together: str, *, beginning: bool = False) -> float:
    """Return how alike the words are to the model's name or its beginning, with or without its maker, 0 to 1."""
    own = _plain_spelling(entry.name)
    maker = _plain_spelling(entry.file or entry.maker)
    spellings = {
        own,
        own.removeprefix(maker),
        _plain_spelling(entry.title),
        _plain_spelling(entry.title).removeprefix(maker),
    }
    if beginning:
        spellings |= {spelling[: len(together)] for spelling in spellings}
    return max(SequenceMatcher(None, spelling, together).ratio() for spelling in spellings)


def _plain_spelling(text: str) -> str:
    return "".join(_split_words(text))


def _split_words(text: str) -> list[str]:
    """Return letters and numbers apart, numbers without leading zeros: 007 is 7."""
    found = _WORD.findall(_without_accents(text).lower())
    return [word.lstrip("0") or "0" if word.isdecimal() else word for word in found]


def _without_accents(text: str) -> str:
    """Return a text in plain letters: the maker St\u00e4ubli is written staubli in names."""
    if text.isascii():
        return text
    return "".join(sign for sign in normalize("NFKD", text) if not combining(sign))


@cache
def _maker_file(file: str) -> dict[str, Mapping[str, Any]]:
    return {robot["name"]: robot for robot in _read_file(file)["robots"]}


def _read_file(file: str) -> Any:
    return parse_json(read_plain_text(_FOLDER / f"{file}.json"))
