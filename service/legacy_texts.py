"""Messages of records without templates: earlier journals and signed certificates hold English texts alone.

This is the one place that takes English sentences apart. Each sentence is compared with the templates of the
catalogue; what stands in their holes becomes the arguments. What is recorded today has its templates beside it.
"""

import re
from collections.abc import Iterable
from dataclasses import dataclass, field
from functools import cache
from typing import Any

from cellcal.calibration.message import (
    Message,
    escape_braces,
    fill_template,
    find_message,
    remember_message,
    split_template,
)
from cellcal.calibration.message_table import texts_of
from cellcal.service.translation import load_translations, split_sentences

_NUMBER = re.compile(r"(?<![A-Za-z_\d.])[-+]?\d+(?:\.\d+)?")
_NAMED = re.compile(r"([\w/-]+(?: [\w-]+){0,2}|[\w ,/-]+ \d+): (.+)", re.DOTALL)
_LIST = "; "


@dataclass(frozen=True, slots=True)
class _SentencePattern:
    template: str
    names: tuple[str, ...]
    matches: re.Pattern[str]

    @classmethod
    def compile_pattern(cls, template: str) -> "_SentencePattern":
        parts = split_template(template)
        names = tuple(name for _, name in parts if name is not None)
        written = "".join(re.escape(literal) + ("" if name is None else "(.*?)") for literal, name in parts)
        return cls(template, names, re.compile(written, re.DOTALL))

    @property
    def weight(self) -> int:
        """The number of letters that are not filled in: longer ones are tried first."""
        return sum(len(literal) for literal, _ in split_template(self.template))


@dataclass(frozen=True)
class LegacyTexts:
    """Finds template and arguments of English texts."""

    plain: frozenset[str]  # texts without arguments
    patterns: tuple[_SentencePattern, ...]
    _found: dict[str, _SentencePattern | None] = field(default_factory=dict)  # by texts without their numbers

    @classmethod
    def from_templates(cls, templates: Iterable[str]) -> "LegacyTexts":
        """Prepare to compare with a catalogue's templates."""
        with_holes, plain = [], []
        for template in templates:
            has_holes = any(name is not None for _, name in split_template(template))
            if has_holes:
                with_holes.append(template)
            else:
                plain.append(fill_template(template, {}))
        patterns = map(_SentencePattern.compile_pattern, with_holes)
        return cls(frozenset(plain), tuple(sorted(patterns, key=lambda pattern: -pattern.weight)))

    def find_message(self, text: str) -> Message | None:
        """Return the message that a text was made of; None where no template gives it."""
        return find_message(text) or self._recover_text(text)

    def _recover_text(self, text: str) -> Message | None:
        sentences = list(split_sentences(text))
        if len(sentences) == 1:
            return self._recover_sentence(text.strip())
        parts = [self._recover_part(sentence) for sentence in sentences]
        return _join_parts(" ", parts) if any(isinstance(part, Message) for part in parts) else None

    def _recover_part(self, text: str) -> str:
        """Return a text as an argument: a message where a template gives it."""
        return text if text in self.plain else self._recover_sentence(text) or text

    def _recover_sentence(self, text: str) -> Message | None:
        return self._match_template(text) or self._match_name(text) or self._match_list(text)

    def _match_template(self, text: str) -> Message | None:
        alike = _NUMBER.sub("0", text)  # a million reasons differ in their numbers alone
        if alike not in self._found:
            self._found[alike] = next((p for p in self.patterns if p.matches.fullmatch(text)), None)
        pattern = self._found[alike]
        found = None if pattern is None else pattern.matches.fullmatch(text)
        if pattern is None or found is None:
            return None
        arguments: dict[str, str] = {}
        for name, words in zip(pattern.names, found.groups(), strict=True):
            if arguments.setdefault(name, words) != words or words == text:
                return None
        return Message(
            text, pattern.template, {name: self._recover_value(words) for name, words in arguments.items()}
        )

    def _recover_value(self, words: str) -> str:
        if words in self.plain:
            return words
        return self._match_words(words) or self._recover_part(words)

    def _match_name(self, text: str) -> Message | None:
        """Return the message of a device's trouble, which begins with its name, or of a step's or a setting's."""
        found = _NAMED.fullmatch(text)
        if found is None:
            return None
        recovered = self._recover_part(found[2])
        if not self._is_known(recovered):
            return None
        return Message(text, "{name}: {text}", {"name": found[1], "text": recovered})

    def _match_list(self, text: str) -> Message | None:
        first, cut, rest = text.partition(_LIST)
        parts = [self._recover_part(part) for part in (first, rest)] if cut else []
        return _join_parts(_LIST, parts) if parts and all(map(self._is_known, parts)) else None

    def _match_words(self, text: str) -> Message | None:
        """Return the message of a list: of names, or of a controller's own words and ours."""
        parts = [self._recover_part(part) for part in text.split(_LIST)] if _LIST in text else []
        return _join_parts(_LIST, parts) if any(map(self._is_known, parts)) else None

    def _is_known(self, part: str) -> bool:
        return isinstance(part, Message) or part in self.plain


def remember_recorded_texts(document: Any) -> None:
    """Have `find_message` find the messages of a document that was recorded with English texts alone."""
    recorded = _load_legacy_texts()
    for text in texts_of(document):
        if " " in text and text not in recorded.plain and (made := recorded.find_message(text)) is not None:
            remember_message(made)


@cache
def _load_legacy_texts() -> LegacyTexts:
    """Return the templates of the catalogue; they are the same for every language."""
    return LegacyTexts.from_templates(load_translations("de").table)


def _join_parts(separator: str, parts: Iterable[str]) -> Message:
    named = {f"part_{place}": part for place, part in enumerate(parts, start=1)}
    return Message.from_template(escape_braces(separator).join(f"{{{name}}}" for name in named), named)
