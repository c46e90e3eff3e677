"""What is said in English, in the reader's language: the tables of the pages, for what is made without a page.

The rules are those of web/src/lib/say.svelte.ts. The English sentence is the key; "#" stands for a number in it, or
"{1}" for a hole as in the source. What has no entry, or no table because the pages are not built, stays English.
"""

import re
from collections.abc import Iterable
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path
from typing import Literal, TypeAlias, get_args

from cellcal.calibration.documents.json_text import parse_json
from cellcal.calibration.documents.plain_files import read_plain_text

Locale: TypeAlias = Literal["en", "de", "es", "zh"]
LOCALES: tuple[Locale, ...] = get_args(Locale)
BUILT = Path(__file__).parent / "web" / "dist" / "locales"  # beside the pages
_KINDS = ("procedures", "refusals")
_COMMA = ("de", "es")
_NUMBER = re.compile(r"(?<![A-Za-z_\d.])[-+]?\d+(?:\.\d+)?")
_ONLY_A_NUMBER = re.compile(r"[-+]?\d+(?:\.\d+)?(?: ?(?:%|mm|m|deg|rad))?")
_SENTENCE = re.compile(r"(?<=[.?!])\s+")
_NUMBERED = re.compile(r"(.*?),? (\d+)")
_HOLE = re.compile(r"\{(\d+)\}")
_NAMED = re.compile(r"([\w/-]+(?: [\w-]+){0,2}|[\w ,/-]+ \d+): (.+)", re.DOTALL)


@dataclass(frozen=True, slots=True)
class _Pattern:
    matches: re.Pattern[str]
    said: str

    @classmethod
    def of(cls, english: str, said: str) -> "_Pattern":
        literals = _HOLE.split(english)[::2]
        return cls(re.compile("(.*?)".join(map(re.escape, literals)), re.DOTALL), said)


@dataclass(frozen=True)
class Sayings:
    """One language's tables."""

    locale: Locale
    table: dict[str, str]
    commas: bool = False  # in numbers
    _patterns: list[_Pattern] = field(default_factory=list)
    _found: dict[str, _Pattern | None] = field(default_factory=dict)  # by sentences without their numbers

    @classmethod
    def read(cls, locale: Locale, folder: Path = BUILT) -> "Sayings":
        """Read a language's tables."""
        table: dict[str, str] = {}
        for file in (folder / kind / f"{locale}.json" for kind in _KINDS):
            if file.is_file():
                table |= parse_json(read_plain_text(file))
        return cls.of(locale, table, commas=locale in _COMMA)

    @classmethod
    def of(cls, locale: Locale, table: dict[str, str], *, commas: bool) -> "Sayings":
        """Make the sayings of a table."""
        holed = sorted(
            (english for english in table if _HOLE.search(english)),
            key=lambda english: -len(_HOLE.sub("", english)),  # what says more is tried first
        )
        return cls(locale, table, commas, [_Pattern.of(english, table[english]) for english in holed])

    def say(self, text: str) -> str:
        """Return a text in this language, sentence by sentence."""
        if not self.table:
            return text
        return self.join(self._said(part) or part for part in _SENTENCE.split(text))

    def join(self, sentences: Iterable[str]) -> str:
        """Return sentences one after the other: Chinese has no space between them."""
        told = " ".join(sentences)
        return told.replace("。 ", "。") if self.locale == "zh" else told

    def number(self, written: str) -> str:
        """Return a number as people write it here."""
        return written.replace(".", ",") if self.commas else written

    def step(self, given: str) -> str:
        """Return the name of a step, whose number may be its own."""
        if not self.table:
            return given
        name = given.removesuffix(",")  # of a phase whose steps are numbered after a comma
        if (said := self._said(name)) is not None:
            return said
        phase, _, rest = name.partition(": ")
        if phase and rest:
            return f"{self.step(phase)}: {self.step(rest)}"
        numbered = _NUMBERED.fullmatch(name)
        return f"{self.step(numbered[1])} {numbered[2]}" if numbered else given

    def _said(self, text: str) -> str | None:
        text = text.strip()
        return self._counted(text) or self._filled(text) or self._of_named(text) or self._listed(text)

    def _counted(self, text: str) -> str | None:
        said = self.table.get(text, self.table.get(_NUMBER.sub("#", text)))
        if said is None:
            return None
        numbers = iter(_NUMBER.findall(text))
        return re.sub("#", lambda _: self.number(next(numbers, "#")), said)

    def _filled(self, text: str) -> str | None:
        alike = _NUMBER.sub("0", text)  # a million reasons differ in their numbers alone
        if alike not in self._found:
            self._found[alike] = next((p for p in self._patterns if p.matches.fullmatch(text)), None)
        pattern = self._found[alike]
        found = None if pattern is None else pattern.matches.fullmatch(text)
        if pattern is None or found is None:
            return None
        return _HOLE.sub(lambda hole: self._value(found[int(hole[1])]), pattern.said)

    def _of_named(self, text: str) -> str | None:
        found = _NAMED.fullmatch(text)
        said = None if found is None else self._said(found[2])
        if found is None or said is None:
            return None
        return f"{self._name(found[1])}: {said}"

    def _name(self, words: str) -> str:
        return self.step(words) if _NUMBERED.fullmatch(words) else words  # a device has its own name

    def _listed(self, text: str) -> str | None:
        first, cut, rest = text.partition("; ")
        said = [self._said(part) for part in (first, rest)] if cut else [None]
        return None if None in said else self._between.join(part for part in said if part)

    @property
    def _between(self) -> str:
        return "；" if self.locale == "zh" else "; "  # noqa: RUF001 - Chinese

    def _value(self, words: str) -> str:
        if _ONLY_A_NUMBER.fullmatch(words):
            return self.number(words)
        parts = words.split("; ")  # a list: of names, or of a controller's own words and ours
        told = [self._said(part) for part in parts]
        if len(parts) > 1 and any(told) and self._counted(words) is None:
            return self._between.join(said or part for said, part in zip(told, parts, strict=True))
        return self._said(words) or self._name(words)


@cache
def sayings(locale: Locale) -> Sayings:
    """Return a language's tables as they were built with the pages."""
    return Sayings.read(locale)
