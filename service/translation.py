"""Texts in the reader's language: a message by its template, a plain text as it is.

A catalogue is one JSON object for each language: English template -> translated template, both with braces doubled
that are no holes. A template is a sentence; its holes have names, in any order in the translation. What has no entry,
or no catalogue because the pages are not built, stays English. The rules are those of web/src/lib/say.svelte.ts.

An English text is never taken apart to find its arguments: `legacy_texts` does so for what was recorded without them.
"""

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from functools import cache, lru_cache
from pathlib import Path
from typing import Literal, TypeAlias, get_args

from cellcal.calibration.documents.json_text import parse_json
from cellcal.calibration.documents.plain_files import read_plain_text
from cellcal.calibration.message import (
    Message,
    MessageSource,
    escape_braces,
    fill_template,
    find_message,
    split_template,
)

Locale: TypeAlias = Literal["en", "de", "es", "zh"]
LOCALES: tuple[Locale, ...] = get_args(Locale)
BUILT = Path(__file__).parent / "web" / "dist" / "locales"  # beside the pages
_KINDS = ("procedures", "settings", "refusals")
_COMMA = ("de", "es")
_UNITS = ("", "%", "mm", "m", "deg", "rad")  # what may stand behind the number of an argument
_PUNCTUATION = frozenset(" .,;:\n")
_CHINESE_MARKS = tuple("，；：、。（")  # noqa: RUF001 - Chinese
_LIST = "; "
_NAMES = ", "  # between the names of a list


@dataclass(frozen=True)
class Translations:
    """One language's catalogue."""

    locale: Locale
    table: Mapping[str, str]
    commas: bool = False  # in numbers
    find: MessageSource = find_message  # the message that has a text

    @classmethod
    def read_tables(
        cls, locale: Locale, folder: Path = BUILT, find: MessageSource = find_message
    ) -> "Translations":
        """Read a language's catalogue."""
        table: dict[str, str] = {}
        for file in (folder / kind / f"{locale}.json" for kind in _KINDS):
            if file.is_file():
                table |= parse_json(read_plain_text(file))
        return cls(locale, table, writes_commas(locale), find)

    def translate(self, text: str) -> str:
        """Return a text in this language; a sentence without an entry stays English."""
        return (self._translate_text(text) or text) if self.table else text

    def is_translated(self, text: str) -> bool:
        """Whether any sentence of a text has an entry."""
        return self._translate_text(text) is not None

    def join_sentences(self, sentences: Iterable[str]) -> str:
        """Return sentences one after the other: Chinese has no space between them."""
        text = " ".join(sentences)
        return text.replace("。 ", "。") if self.locale == "zh" else text

    def format_number(self, written: str) -> str:
        """Return a number as people write it here."""
        return written.replace(".", ",") if self.commas else written

    def translate_step(self, step_name: str) -> str:
        """Return the name of a step: ``phase: name``, with a number behind either."""
        if not self.table:
            return step_name
        name = step_name.removesuffix(",")  # of a phase whose steps are numbered after a comma
        if (translated := self._translate_text(name)) is not None:
            return translated
        phase, _, rest = name.partition(": ")
        if phase and rest:
            colon = "：" if self.locale == "zh" else ": "  # noqa: RUF001 - Chinese
            return f"{self.translate_step(phase)}{colon}{self.translate_step(rest)}"
        words, _, number = name.rpartition(" ")
        return f"{self.translate_step(words)} {number}" if words and number.isdecimal() else step_name

    def _translate_text(self, text: str) -> str | None:
        if (translated := self.table.get(escape_braces(text.strip()))) is not None:
            return _with_spaces_of(text, fill_template(translated, {}))
        if (made := self.find(text)) is not None:
            return self._translate_message(made)
        sentences = list(split_sentences(text))
        if len(sentences) == 1:
            return None
        translations = [self._translate_text(sentence) for sentence in sentences]
        if not any(translations):
            return None
        return self.join_sentences(done or left for done, left in zip(translations, sentences, strict=True))

    def _translate_message(self, made: Message) -> str | None:
        """Return a message sentence by sentence; None where none of it has an entry."""
        sentences = sentences_of(made.template)
        translations = [self._translate_sentence(sentence, made) for sentence in sentences]
        if not any(translations):
            return None
        sentences_done = (
            fill_template(sentence, made.arguments) if done is None else done
            for done, sentence in zip(translations, sentences, strict=True)
        )
        return _with_spaces_of(made, self.join_sentences(sentences_done))

    def _translate_sentence(self, template: str, made: Message) -> str | None:
        translated = self._find_template(template)
        if translated is None:
            return None
        names = {name for _, name in split_template(translated) if name is not None}
        return fill_template(
            translated, {name: self._translate_argument(made.arguments[name]) for name in names}
        )

    def _find_template(self, template: str) -> str | None:
        if (translated := self.table.get(template)) is not None:
            return translated
        if is_punctuation(template):
            return _chinese_punctuation(template) if self.locale == "zh" else template
        lead, rest = split_lead(template)
        if not lead or (translated := self.table.get(rest)) is None:
            return None
        return f"{lead} {translated}"

    def _translate_argument(self, argument: str) -> str:
        if is_number(argument):
            return self.format_number(argument)
        if (translated := self._translate_text(argument)) is not None:
            return translated
        names = argument.split(_NAMES)
        if self.locale == "zh" and len(names) > 1 and all(_is_name(name) for name in names):
            return "、".join(names)
        words, _, number = argument.rpartition(" ")
        is_listed = words.endswith(",") and words[:-1].rpartition(" ")[2].isdecimal()
        return self.translate_step(argument) if words and number.isdecimal() and not is_listed else argument


def _chinese_punctuation(template: str) -> str:
    """Return a template of holes with its lists and its full stop as Chinese writes them."""
    listed = template.replace(_LIST, "；").replace(_NAMES, "、")  # noqa: RUF001 - Chinese
    return f"{listed[:-1]}。" if listed.endswith("}.") else listed


def _is_name(text: str) -> bool:
    """Return whether a text is one name, such as the one of an axis: "A2"."""
    return text[:1].isascii() and text[:1].isalpha() and text.replace(".", "").isidentifier()


def _with_spaces_of(english: str, translated: str) -> str:
    """Return a translation with the spaces around the English text, which may be a part of another."""
    before, after = len(english) - len(english.lstrip()), len(english) - len(english.rstrip())
    if translated.strip()[:1] in _CHINESE_MARKS:  # which have no space before them
        before = 0
    return english[:before] + translated.strip() + (english[-after:] if after else "")


def split_sentences(text: str) -> Iterator[str]:
    """Yield the sentences of a text: each ends behind a full stop, question or exclamation mark and a space."""
    begin = 0
    for place in range(1, len(text)):
        if text[place].isspace() and text[place - 1] in ".?!":
            yield text[begin:place].strip()
            begin = place
    yield text[begin:].strip()


@lru_cache(maxsize=4096)
def sentences_of(template: str) -> tuple[str, ...]:
    """Return the sentences of a template."""
    return tuple(split_sentences(template))


@lru_cache(maxsize=4096)
def split_lead(sentence: str) -> tuple[str, str]:
    """Return what is filled in before the first word of a sentence, such as other sentences, and the rest of it."""
    lead = 0
    for literal, name in split_template(sentence):
        if literal.strip() or name is None:
            break
        lead += len(literal) + len(name) + 2
    return sentence[:lead].strip(), sentence[lead:].strip()


@lru_cache(maxsize=4096)
def is_punctuation(template: str) -> bool:
    """Whether a template has nothing to translate but what is filled in."""
    parts = split_template(template)
    return any(name is not None for _, name in parts) and all(
        _PUNCTUATION.issuperset(each) for each, _ in parts
    )


def writes_commas(locale: Locale) -> bool:
    """Return whether the decimal mark of a language is a comma."""
    return locale in _COMMA


def is_number(text: str) -> bool:
    """Whether a text is a number, or one with its unit."""
    number, _, unit = text.partition(" ")
    return unit in _UNITS and number.lstrip("+-").replace(".", "", 1).isdecimal()


@cache
def load_translations(locale: Locale) -> Translations:
    """Return a language's catalogue as it was built with the pages."""
    return Translations.read_tables(locale)
