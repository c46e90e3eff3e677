"""A procedure's settings in words: what each takes and what stands where none is given."""

import json
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from pydantic import TypeAdapter

from cellcal.procedures.catalogue import entry_named

_BOUNDS = (
    ("minimum", "from"),
    ("exclusiveMinimum", "above"),
    ("maximum", "to"),
    ("exclusiveMaximum", "below"),
)
_PLAIN = {
    "integer": "whole number",
    "number": "number",
    "string": "text",
    "boolean": "true or false",
    "null": "null",
}


@dataclass(frozen=True)
class Setting:
    """One setting. ``default`` is JSON, or None where a person must say something; units stand in the name, SI."""

    name: str
    takes: str
    default: str | None


def settings_of(procedure: str, usual: Mapping[str, Any] | None = None) -> tuple[Setting, ...]:
    """Return the settings of a procedure, those that must be given first; ``usual`` is what a cell decides.

    Raises
    ------
    UnknownProcedureError
        No procedure has this name.
    """
    schema = schema_of(procedure, usual or {})
    known = schema.get("$defs", {})
    needed = set(schema.get("required", ()))
    told = [
        Setting(name, _takes(each, known), None if name in needed else _default(each))
        for name, each in schema.get("properties", {}).items()
    ]
    return tuple(sorted(told, key=lambda setting: setting.name not in needed))


def schema_of(procedure: str, usual: Mapping[str, Any]) -> dict[str, Any]:
    """Return the settings as JSON schema; what is usual in a cell stands as default and need not be given."""
    schema = TypeAdapter(entry_named(procedure).spec_type).json_schema()
    for name, value in usual.items():
        schema["properties"][name]["default"] = value
    schema["required"] = [name for name in schema.get("required", ()) if name not in usual]
    return schema


def _default(schema: Mapping[str, Any]) -> str:
    return json.dumps(schema["default"]) if "default" in schema else "the procedure's own"


def _takes(schema: Mapping[str, Any], known: Mapping[str, Any]) -> str:
    if "$ref" in schema:
        return _parts(known[schema["$ref"].rpartition("/")[2]])
    if "anyOf" in schema:
        return " or ".join(_takes(each, known) for each in schema["anyOf"])
    if "enum" in schema or "const" in schema:
        return ", ".join(map(str, schema.get("enum", [schema.get("const")])))
    if schema.get("type") == "array":
        return _list(schema, known)
    if schema.get("type") == "object":
        return _parts(schema)
    words = [_PLAIN.get(str(schema.get("type")), "JSON")]
    words += [f"{word} {schema[bound]:g}" for bound, word in _BOUNDS if bound in schema]
    return " ".join(words)


def _list(schema: Mapping[str, Any], known: Mapping[str, Any]) -> str:
    least, most = schema.get("minItems"), schema.get("maxItems")
    items: Mapping[str, Any] = schema.get("items") or next(iter(schema.get("prefixItems", ())), {})
    each = _takes(items, known)
    if least is not None and least == most:
        return f"[{least} x {each}]"
    many = f", {least or 0} to {most} of them" if most else ""
    return f"[{each}, …{many}]"


def _parts(schema: Mapping[str, Any]) -> str:
    return "{" + ", ".join(schema.get("properties", {})) + "}"
