"""The table of templates and arguments beside the texts of an answer, in ``/openapi.json``."""

from collections.abc import Iterator, Mapping
from typing import Any

from fastapi import FastAPI

from cellcal.calibration.message_table import MESSAGES

_REF = "#/components/schemas/"
_MESSAGE = {
    "title": "TextMessage",
    "type": "object",
    "description": "English template and arguments of a text; an argument is a text or such an object",
    "properties": {
        "template": {"type": "string"},
        "arguments": {
            "type": "object",
            "additionalProperties": {"anyOf": [{"type": "string"}, {"$ref": f"{_REF}TextMessage"}]},
        },
    },
    "required": ["template", "arguments"],
    "additionalProperties": False,
}
_TABLE = {
    "title": "TextMessages",
    "type": "object",
    "description": "of this object's texts that have arguments, by the English text; left out where there is none",
    "additionalProperties": {"$ref": f"{_REF}TextMessage"},
}


def describe_messages(app: FastAPI) -> None:
    """Have an app's description name the table that `MessageJsonResponse` adds to the objects of an answer."""
    plain_description = app.openapi

    def describe_with_messages() -> dict[str, Any]:
        if app.openapi_schema is None:
            description = plain_description()
            schemas = description["components"]["schemas"]
            answered = set(_answered_objects(description))
            for rows in [schemas[name].get("properties", {}).get("rows", {}) for name in answered]:
                answered |= set(_named_objects(rows))  # the monitor's rows are sent one by one
            for name in answered:
                if schemas[name].get("type") == "object":
                    schemas[name].setdefault("properties", {})[MESSAGES] = {"$ref": f"{_REF}TextMessages"}
            schemas |= {"TextMessage": _MESSAGE, "TextMessages": _TABLE}
        assert app.openapi_schema is not None
        return app.openapi_schema

    app.openapi = describe_with_messages  # type: ignore[method-assign]  # FastAPI's own way


def _answered_objects(description: Mapping[str, Any]) -> Iterator[str]:
    """Yield the names of the objects that are answers, or elements of a list that is one."""
    for operations in description["paths"].values():
        for operation in operations.values():
            for response in operation["responses"].values():
                schema = response.get("content", {}).get("application/json", {}).get("schema", {})
                yield from _named_objects(schema)


def _named_objects(schema: Mapping[str, Any]) -> Iterator[str]:
    if "$ref" in schema:
        yield schema["$ref"].removeprefix(_REF)
    inside = [schema["items"]] if "items" in schema else schema.get("anyOf", [])
    for part in inside:
        yield from _named_objects(part)
