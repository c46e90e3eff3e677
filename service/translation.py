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
class _SentencePattern:
    matches: re.Pattern[str]
    translated: str

    @classmethod
    def compile_pattern(cls, english: str, translated: str) -> "_SentencePattern":
        literals = _HOLE.split(english)[::2]
        return cls(re.compile("(.*?)".join(map(re.escape, literals)), re.DOTALL), translated)


@dataclass(frozen=True)
class Translations:
    """One language's tables."""

    locale: Locale
    table: dict[str, str]
    commas: bool = False  # in numbers
    _patterns: list[_SentencePattern] = field(default_factory=list)
    _found: dict[str, _SentencePattern | None] = field(
        default_factory=dict
    )  # by sentences without their numbers

    @classmethod
    def read_tables(cls, locale: Locale, folder: Path = BUILT) -> "Translations":
        """Read a language's tables."""
        table: dict[str, str] = {}
        for file in (folder / kind / f"{locale}.json" for kind in _KINDS):
            if file.is_file():
                table |= parse_json(read_plain_text(file))
        return cls.from_table(locale, table, commas=locale in _COMMA)

    @classmethod
    def from_table(cls, locale: Locale, table: dict[str, str], *, commas: bool) -> "Translations":
        """Make the sayings of a table."""
        holed = sorted(
            (english for english in table if _HOLE.search(english)),
            key=lambda english: -len(_HOLE.sub("", english)),  # what says more is tried first
        )
        return cls(
            locale,
            table,
            commas,
            [_SentencePattern.compile_pattern(english, table[english]) for english in holed],
        )

    def translate(self, text: str) -> str:
        """Return a text in this language, sentence by sentence."""
        if not self.table:
            return text
        return self.join_sentences(self._translate_part(part) or part for part in _SENTENCE.split(text))

    def join_sentences(self, sentences: Iterable[str]) -> str:
        """Return sentences one after the other: Chinese has no space between them."""
        text = " ".join(sentences)
        return text.replace("。 ", "。") if self.locale == "zh" else text

    def format_number(self, written: str) -> str:
        """Return a number as people write it here."""
        return written.replace(".", ",") if self.commas else written

    def translate_step(self, step_name: str) -> str:
        """Return the name of a step, whose number may be its own."""
        if not self.table:
            return step_name
        name = step_name.removesuffix(",")  # of a phase whose steps are numbered after a comma
        if (translated := self._translate_part(name)) is not None:
            return translated
        phase, _, rest = name.partition(": ")
        if phase and rest:
            return f"{self.translate_step(phase)}: {self.translate_step(rest)}"
        numbered = _NUMBERED.fullmatch(name)
        return f"{self.translate_step(numbered[1])} {numbered[2]}" if numbered else step_name

    def _translate_part(self, text: str) -> str | None:
        text = text.strip()
        return (
            self._translate_counted(text)
            or self._translate_pattern(text)
            or self._of_named(text)
            or self._translate_list(text)
        )

    def _translate_counted(self, text: str) -> str | None:
        translated = self.table.get(text, self.table.get(_NUMBER.sub("#", text)))
        if translated is None:
            return None
        numbers = iter(_NUMBER.findall(text))
        return re.sub("#", lambda _: self.format_number(next(numbers, "#")), translated)

    def _translate_pattern(self, text: str) -> str | None:
        alike = _NUMBER.sub("0", text)  # a million reasons differ in their numbers alone
        if alike not in self._found:
            self._found[alike] = next((p for p in self._patterns if p.matches.fullmatch(text)), None)
        pattern = self._found[alike]
        found = None if pattern is None else pattern.matches.fullmatch(text)
        if pattern is None or found is None:
            return None
        return _HOLE.sub(lambda hole: self._translate_value(found[int(hole[1])]), pattern.translated)

    def _of_named(self, text: str) -> str | None:
        found = _NAMED.fullmatch(text)
        translated = None if found is None else self._translate_part(found[2])
        if found is None or translated is None:
            return None
        return f"{self._translate_name(found[1])}: {translated}"

    def _translate_name(self, words: str) -> str:
        return (
            self.translate_step(words) if _NUMBERED.fullmatch(words) else words
        )  # a device has its own name

    def _translate_list(self, text: str) -> str | None:
        first, cut, rest = text.partition("; ")
        translated = [self._translate_part(part) for part in (first, rest)] if cut else [None]
        return None if None in translated else self._separator.join(part for part in translated if part)

    @property
    def _separator(self) -> str:
        return "；" if self.locale == "zh" else "; "  # noqa: RUF001 - Chinese

    def _translate_value(self, words: str) -> str:
        if _ONLY_A_NUMBER.fullmatch(words):
            return self.format_number(words)
        parts = words.split("; ")  # a list: of names, or of a controller's own words and ours
        translations = [self._translate_part(part) for part in parts]
        if len(parts) > 1 and any(translations) and self._translate_counted(words) is None:
            return self._separator.join(
                translated or part for translated, part in zip(translations, parts, strict=True)
            )
        return self._translate_part(words) or self._translate_name(words)


@cache
def load_translations(locale: Locale) -> Translations:
    """Return a language's tables as they were built with the pages."""
    return Translations.read_tables(locale)
