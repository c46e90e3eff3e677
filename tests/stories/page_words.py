"""What a reader of one language knows: the words of the pages, and what English texts are in that language."""

import json
import re
from collections.abc import Iterable
from pathlib import Path
from typing import Any

from pydantic import TypeAdapter

from cellcal.procedures.catalogue import definition_named

LOCALES = Path(__file__).parents[2] / "web" / "src" / "locales"
_NUMBERED = re.compile(r"(.*?),? (\d+)", re.DOTALL)


class PageWords:
    """The words of the pages in ``locale`` (en, de, es, zh)."""

    def __init__(self, locale: str) -> None:
        self.locale = locale
        self._words: dict[str, str] = _read_texts(LOCALES / f"{locale}.json")
        self._sayings: dict[str, str] = {}
        for kind in ("procedures", "settings", "refusals") if locale != "en" else ():
            self._sayings |= _read_texts(LOCALES / kind / f"{locale}.json")

    def word(self, key: str, **values: object) -> str:
        """Return a text of the pages themselves."""
        return self._words[key].format(**values)

    def keys_of(self, prefix: str) -> tuple[str, ...]:
        """Return the keys of the pages' own texts that begin so."""
        return tuple(key for key in self._words if key.startswith(prefix))

    def translate(self, english: str) -> str:
        """Return a text of a procedure or a setting, without arguments.

        Raises
        ------
        KeyError
            The language has no such text: a reader of it would find English on the page.
        """
        return english if self.locale == "en" else self._sayings[english]

    def recognise(self, shown: str, known: Iterable[str]) -> tuple[str, int]:
        """Return which of the known English texts is shown, and the number behind it (0 where there is none).

        Raises
        ------
        AssertionError
            It is none of them.
        """
        whole = " ".join(shown.split()).casefold()
        numbered = _NUMBERED.fullmatch(whole)
        for english in known:
            translated = self.translate(english).casefold()
            if whole == translated:
                return english, 0
            if numbered is not None and numbered[1] == translated:
                return english, int(numbered[2])
        raise AssertionError(f"{shown!r} is none of the things that a technician knows")


def _read_texts(path: Path) -> dict[str, str]:
    texts: dict[str, str] = json.loads(path.read_text(encoding="utf-8"))
    return texts


def label_settings(procedure: str, settings: dict[str, Any]) -> dict[str, Any]:
    """Return settings of a procedure by their English labels, as its page and ``cellcal procedures`` name them."""
    schema = TypeAdapter(definition_named(procedure).spec_type).json_schema()
    return _label_group(schema, schema.get("$defs", {}), settings)


def _label_group(
    group: dict[str, Any], definitions: dict[str, Any], settings: dict[str, Any]
) -> dict[str, Any]:
    fields = group["properties"]
    return {
        fields[name]["title"]: _label_value(fields[name], definitions, value)
        for name, value in settings.items()
    }


def _label_value(field: dict[str, Any], definitions: dict[str, Any], value: Any) -> Any:
    if choices := field.get("x-choices"):
        return choices[value]
    part = _resolve(field, definitions)
    is_group = isinstance(value, dict) and not {"position_m", "file", "content_base64"} & set(value)
    return _label_group(part, definitions, value) if is_group and "properties" in part else value


def _resolve(field: dict[str, Any], definitions: dict[str, Any]) -> dict[str, Any]:
    real = next((one for one in field.get("anyOf", [field]) if one.get("type") != "null"), field)
    found: dict[str, Any] = definitions.get(real.get("$ref", "").rpartition("/")[2], real)
    return found
