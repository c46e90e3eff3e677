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
_DESCRIPTIONS: dict[tuple[str, tuple[str, ...]], dict[str, Any]] = {}


@dataclass
class DescribedApi:
    """What an app says of itself; ``check_answer`` is a hook of httpx clients."""

    app: FastAPI

    @cached_property
    def api_description(self) -> dict[str, Any]:
        """The app's description, made once for all apps of the same routers: it takes longer than most tests."""
        own_paths = tuple(getattr(route, "path", "") for route in self.app.routes)
        kind = (self.app.title, own_paths)  # a router that was included has no path of its own
        if kind not in _DESCRIPTIONS:
            _DESCRIPTIONS[kind] = self.app.openapi()
        return _DESCRIPTIONS[kind]

    @cached_property
    def described_paths(self) -> list[tuple[re.Pattern[str], dict[str, Any]]]:
        """Every described path, those without a hole first."""
        sorted_paths = sorted(self.api_description["paths"].items(), key=lambda each: each[0].count("{"))
        return [
            (re.compile(re.sub(r"\\\{\w+\\\}", "[^/]+", re.escape(path))), ops) for path, ops in sorted_paths
        ]

    async def check_answer(self, answer: httpx.Response) -> None:
        """Hold an answer to what is said of its route; who asks for no route at all is refused by the wall."""
        path, method = answer.request.url.path, answer.request.method.lower()
        operation = next(
            (ops[method] for form, ops in self.described_paths if form.fullmatch(path) and method in ops),
            None,
        )
        if operation is None:
            return
        await answer.aread()
        response_description = operation["responses"].get(
            str(answer.status_code), operation["responses"].get("default")
        )
        where = f"{method} {path}: {answer.status_code}"
        assert response_description is not None, f"{where} is not described"
        assert answer.is_error == (
            response_description is not operation["responses"].get("200", operation["responses"].get("202"))
        ), where
        kind = answer.headers.get("content-type", "").partition(";")[0]
        assert kind in response_description.get("content", {}), f"{where}: {kind} is not described"
        if kind == "application/json":
            wrong = list(
                self.schema_faults(
                    response_description["content"][kind].get("schema", {}), answer.json(), where
                )
            )
            assert not wrong, wrong

    def schema_faults(self, schema: Mapping[str, Any], value: Any, at: str) -> Iterator[str]:
        """Yield where a value is not as a schema says."""
        unknown = schema.keys() - _SAID_BESIDE - _WORDS.keys()
        assert not unknown, f"{at}: unknown here: {unknown}"
        for word, limit in schema.items():
            if word in _WORDS:
                yield from _WORDS[word](self, limit, value, at, schema)

    def _check_ref(self, ref: str, value: Any, at: str, _: Any) -> Iterator[str]:
        named = self.api_description["components"]["schemas"][ref.removeprefix("#/components/schemas/")]
        yield from self.schema_faults(named, value, at)

    def _check_type(self, name: str, value: Any, at: str, _: Any) -> Iterator[str]:
        right = isinstance(value, _TYPES[name]) and (name == "boolean" or not isinstance(value, bool))
        if not right:
            yield f"{at}: {json.dumps(value)[:80]} is no {name}"

    def _check_const(self, only: Any, value: Any, at: str, _: Any) -> Iterator[str]:
        if value != only:
            yield f"{at}: {value!r} is not {only!r}"

    def _check_enum(self, allowed: list[Any], value: Any, at: str, _: Any) -> Iterator[str]:
        if value not in allowed:
            yield f"{at}: {value!r} is none of {allowed}"

    def _any_of(self, schemas: list[Any], value: Any, at: str, _: Any) -> Iterator[str]:
        found = [list(self.schema_faults(schema, value, at)) for schema in schemas]
        if all(found):
            yield f"{at}: fits none: {found}"

    def _check_required(self, names: list[str], value: Any, at: str, _: Any) -> Iterator[str]:
        if isinstance(value, dict):
            yield from (f"{at}: {name} is missing" for name in names if name not in value)

    def _check_properties(self, schemas: Mapping[str, Any], value: Any, at: str, _: Any) -> Iterator[str]:
        if isinstance(value, dict):
            for name in schemas.keys() & value.keys():
                yield from self.schema_faults(schemas[name], value[name], f"{at}.{name}")

    def _check_additional(self, schema: Any, value: Any, at: str, beside: Mapping[str, Any]) -> Iterator[str]:
        if not isinstance(value, dict) or schema is True:
            return
        for name in value.keys() - beside.get("properties", {}).keys():
            if schema is False:
                yield f"{at}: {name} is missing"
            else:
                yield from self.schema_faults(schema, value[name], f"{at}.{name}")

    def _check_property_names(self, schema: Any, value: Any, at: str, _: Any) -> Iterator[str]:
        for name in value if isinstance(value, dict) else ():
            yield from self.schema_faults(schema, name, f"{at}, its name")

    def _first_items(self, schemas: list[Any], value: Any, at: str, _: Any) -> Iterator[str]:
        for k, (schema, each) in enumerate(
            zip(schemas, value if isinstance(value, list) else (), strict=False)
        ):
            yield from self.schema_faults(schema, each, f"{at}[{k}]")

    def _check_items(self, schema: Any, value: Any, at: str, beside: Mapping[str, Any]) -> Iterator[str]:
        begin = len(beside.get("prefixItems", ()))
        for k, each in enumerate(value if isinstance(value, list) else ()):
            if k >= begin:
                yield from self.schema_faults(schema, each, f"{at}[{k}]")

    def _check_minimum(self, least: float, value: Any, at: str, _: Any) -> Iterator[str]:
        if (size := _size_of(value)) is not None and size < least:
            yield f"{at}: {value!r} is below {least}"

    def _check_maximum(self, most: float, value: Any, at: str, _: Any) -> Iterator[str]:
        if (size := _size_of(value)) is not None and size > most:
            yield f"{at}: {value!r} is above {most}"

    def _check_pattern(self, pattern: str, value: Any, at: str, _: Any) -> Iterator[str]:
        if not re.search(pattern, value):
            yield f"{at}: {value!r} is not like {pattern}"


def _size_of(value: Any) -> float | None:
    """Return what a bound counts; None for a value that no bound speaks of, such as null."""
    if isinstance(value, list | str):
        return len(value)
    return value if isinstance(value, int | float) else None


_WORDS: dict[str, Any] = {
    "$ref": DescribedApi._check_ref, "type": DescribedApi._check_type, "const": DescribedApi._check_const, "enum": DescribedApi._check_enum,
    "anyOf": DescribedApi._any_of, "oneOf": DescribedApi._any_of, "required": DescribedApi._check_required,
    "properties": DescribedApi._check_properties, "additionalProperties": DescribedApi._check_additional,
    "propertyNames": DescribedApi._check_property_names, "prefixItems": DescribedApi._first_items,
    "items": DescribedApi._check_items,
    "minItems": DescribedApi._check_minimum, "minLength": DescribedApi._check_minimum, "minimum": DescribedApi._check_minimum,
    "maxItems": DescribedApi._check_maximum, "maxLength": DescribedApi._check_maximum, "maximum": DescribedApi._check_maximum,
    "pattern": DescribedApi._check_pattern,
}  # fmt: skip
