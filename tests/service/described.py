"""Whether answers are what ``/openapi.json`` says: status, kind of content, and every JSON value by its schema.

It knows the words of JSON Schema that the service's schemas use, and stops at one that it does not know.
"""

import json
import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import httpx
from fastapi import FastAPI

_TYPES: dict[str, tuple[type, ...]] = {
    "object": (dict,), "array": (list,), "string": (str,), "boolean": (bool,), "null": (type(None),),
    "integer": (int,), "number": (int, float),
}  # fmt: skip
_SAID_BESIDE = {"title", "description", "default", "discriminator", "examples", "format", "contentMediaType"}


@dataclass
class Described:
    """What an app says of itself; ``check`` is a hook of httpx clients."""

    app: FastAPI

    @cached_property
    def spec(self) -> dict[str, Any]:
        """The app's description."""
        return self.app.openapi()

    @cached_property
    def paths(self) -> list[tuple[re.Pattern[str], dict[str, Any]]]:
        """Every described path, those without a hole first."""
        known = sorted(self.spec["paths"].items(), key=lambda each: each[0].count("{"))
        return [(re.compile(re.sub(r"\\\{\w+\\\}", "[^/]+", re.escape(path))), ops) for path, ops in known]

    async def check(self, answer: httpx.Response) -> None:
        """Hold an answer to what is said of its route; who asks for no route at all is refused by the wall."""
        path, method = answer.request.url.path, answer.request.method.lower()
        said = next((ops[method] for form, ops in self.paths if form.fullmatch(path) and method in ops), None)
        if said is None:
            return
        await answer.aread()
        told = said["responses"].get(str(answer.status_code), said["responses"].get("default"))
        where = f"{method} {path}: {answer.status_code}"
        assert told is not None, f"{where} is not described"
        assert answer.is_error == (told is not said["responses"].get("200", said["responses"].get("202"))), (
            where
        )
        kind = answer.headers.get("content-type", "").partition(";")[0]
        assert kind in told.get("content", {}), f"{where}: {kind} is not described"
        if kind == "application/json":
            wrong = list(self.faults(told["content"][kind].get("schema", {}), answer.json(), where))
            assert not wrong, wrong

    def faults(self, schema: Mapping[str, Any], value: Any, at: str) -> Iterator[str]:
        """Yield where a value is not as a schema says."""
        unknown = schema.keys() - _SAID_BESIDE - _WORDS.keys()
        assert not unknown, f"{at}: nobody here knows {unknown}"
        for word, limit in schema.items():
            if word in _WORDS:
                yield from _WORDS[word](self, limit, value, at, schema)

    def _ref(self, ref: str, value: Any, at: str, _: Any) -> Iterator[str]:
        named = self.spec["components"]["schemas"][ref.removeprefix("#/components/schemas/")]
        yield from self.faults(named, value, at)

    def _type(self, name: str, value: Any, at: str, _: Any) -> Iterator[str]:
        right = isinstance(value, _TYPES[name]) and (name == "boolean" or not isinstance(value, bool))
        if not right:
            yield f"{at}: {json.dumps(value)[:80]} is no {name}"

    def _const(self, only: Any, value: Any, at: str, _: Any) -> Iterator[str]:
        if value != only:
            yield f"{at}: {value!r} is not {only!r}"

    def _enum(self, known: list[Any], value: Any, at: str, _: Any) -> Iterator[str]:
        if value not in known:
            yield f"{at}: {value!r} is none of {known}"

    def _any_of(self, schemas: list[Any], value: Any, at: str, _: Any) -> Iterator[str]:
        found = [list(self.faults(schema, value, at)) for schema in schemas]
        if all(found):
            yield f"{at}: fits none: {found}"

    def _required(self, names: list[str], value: Any, at: str, _: Any) -> Iterator[str]:
        if isinstance(value, dict):
            yield from (f"{at}: {name} is missing" for name in names if name not in value)

    def _properties(self, known: Mapping[str, Any], value: Any, at: str, _: Any) -> Iterator[str]:
        if isinstance(value, dict):
            for name in known.keys() & value.keys():
                yield from self.faults(known[name], value[name], f"{at}.{name}")

    def _others(self, schema: Any, value: Any, at: str, beside: Mapping[str, Any]) -> Iterator[str]:
        if not isinstance(value, dict) or schema is True:
            return
        for name in value.keys() - beside.get("properties", {}).keys():
            if schema is False:
                yield f"{at}: nobody said {name}"
            else:
                yield from self.faults(schema, value[name], f"{at}.{name}")

    def _names(self, schema: Any, value: Any, at: str, _: Any) -> Iterator[str]:
        for name in value if isinstance(value, dict) else ():
            yield from self.faults(schema, name, f"{at}, its name")

    def _first_items(self, schemas: list[Any], value: Any, at: str, _: Any) -> Iterator[str]:
        for k, (schema, each) in enumerate(zip(schemas, value, strict=False)):
            yield from self.faults(schema, each, f"{at}[{k}]")

    def _items(self, schema: Any, value: Any, at: str, beside: Mapping[str, Any]) -> Iterator[str]:
        begin = len(beside.get("prefixItems", ()))
        for k, each in enumerate(value if isinstance(value, list) else ()):
            if k >= begin:
                yield from self.faults(schema, each, f"{at}[{k}]")

    def _least(self, least: float, value: Any, at: str, _: Any) -> Iterator[str]:
        if (len(value) if isinstance(value, list | str) else value) < least:
            yield f"{at}: {value!r} is below {least}"

    def _most(self, most: float, value: Any, at: str, _: Any) -> Iterator[str]:
        if (len(value) if isinstance(value, list | str) else value) > most:
            yield f"{at}: {value!r} is above {most}"

    def _pattern(self, pattern: str, value: Any, at: str, _: Any) -> Iterator[str]:
        if not re.search(pattern, value):
            yield f"{at}: {value!r} is not like {pattern}"


_WORDS: dict[str, Any] = {
    "$ref": Described._ref, "type": Described._type, "const": Described._const, "enum": Described._enum,
    "anyOf": Described._any_of, "oneOf": Described._any_of, "required": Described._required,
    "properties": Described._properties, "additionalProperties": Described._others,
    "propertyNames": Described._names, "prefixItems": Described._first_items, "items": Described._items,
    "minItems": Described._least, "minLength": Described._least, "minimum": Described._least,
    "maxItems": Described._most, "maxLength": Described._most, "maximum": Described._most,
    "pattern": Described._pattern,
}  # fmt: skip
