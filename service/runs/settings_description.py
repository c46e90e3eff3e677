"""A procedure's settings in words: what each takes and what stands where none is given."""

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from pydantic import TypeAdapter

from cellcal.procedures.catalogue import definition_named
from cellcal.procedures.part_texts import PART_TEXTS

_BOUNDS = (
    ("minimum", "from"),
    ("exclusiveMinimum", "above"),
    ("maximum", "to"),
    ("exclusiveMaximum", "below"),
)
_AXES = "axes as the pendant names them, such as A2,A3, or by their numbers"
_PLAIN = {
    "integer": "whole number",
    "number": "number",
    "string": "text",
    "boolean": "true or false",
    "null": "null",
}


@dataclass(frozen=True)
class SettingDescription:
    """One setting. ``default`` is JSON, or None where a person must say something; values are in ``unit``, SI."""

    name: str
    label: str
    help_text: str
    group: str
    unit: str  # empty where the value is no number
    basic: bool  # one that a technician knows; the others are for an engineer
    takes: str
    default: str | None


def settings_of(procedure: str, usual: Mapping[str, Any] | None = None) -> tuple[SettingDescription, ...]:
    """Return the settings of a procedure, those that must be given first; ``usual`` is what a cell decides.

    Raises
    ------
    UnknownProcedureError
        No procedure has this name.
    """
    schema = schema_of(procedure, usual or {})
    definitions = schema.get("$defs", {})
    needed = set(schema.get("required", ()))
    described = [
        SettingDescription(
            name=name,
            label=each["title"],
            help_text=each["description"],
            group=each["x-group"],
            unit=each["x-unit"],
            basic=each["x-basic"],
            takes=_AXES if each.get("x-axes") else _describe_type(each, definitions),
            default=None if name in needed else _describe_default(each),
        )
        for name, each in schema.get("properties", {}).items()
    ]
    return tuple(sorted(described, key=lambda setting: setting.name not in needed))


def schema_of(procedure: str, usual: Mapping[str, Any]) -> dict[str, Any]:
    """Return the settings as JSON schema; what is usual in a cell stands as default and need not be given."""
    schema = TypeAdapter(definition_named(procedure).spec_type).json_schema()
    _add_part_texts(schema.get("$defs", {}))
    for name, value in usual.items():
        schema["properties"][name]["default"] = value
    schema["required"] = [name for name in schema.get("required", ()) if name not in usual]
    return schema


def label_of(procedure: str, path: Sequence[str]) -> str:
    """Return what a setting or a part of one is called, its place in a list as a number: ``Boxes · 1 · Name``."""
    schema = schema_of(procedure, {})
    definitions, here, labels = schema.get("$defs", {}), schema, list[str]()
    for name in path:
        if name.isdecimal():
            labels.append(str(int(name) + 1))
            here = here.get("items") or next(iter(here.get("prefixItems", ())), {})
        else:
            here = here.get("properties", {}).get(name, {})
            labels.append(here.get("title", name))
        here = _resolve(here, definitions)
    return " · ".join(labels)


def _resolve(schema: Mapping[str, Any], definitions: Mapping[str, Any]) -> dict[str, Any]:
    """Return the schema of a value that is there: without null, a name of another schema looked up."""
    choices = [each for each in schema.get("anyOf", (schema,)) if each.get("type") != "null"]
    there = choices[0] if choices else schema
    found: dict[str, Any] = dict(definitions.get(str(there.get("$ref", "")).rpartition("/")[2], there))
    return found


def _add_part_texts(definitions: Mapping[str, Any]) -> None:
    for name in PART_TEXTS.keys() & definitions.keys():
        for part, text in PART_TEXTS[name].items():
            extra = {"title": text.title, "description": text.description, **text.json_schema_extra}
            definitions[name]["properties"][part].update(extra)


def _describe_default(schema: Mapping[str, Any]) -> str:
    return json.dumps(schema["default"]) if "default" in schema else "the procedure's own"


def _describe_type(schema: Mapping[str, Any], definitions: Mapping[str, Any]) -> str:
    if "$ref" in schema:
        return _describe_parts(definitions[schema["$ref"].rpartition("/")[2]])
    if "anyOf" in schema:
        return " or ".join(_describe_type(each, definitions) for each in schema["anyOf"])
    if "enum" in schema or "const" in schema:
        return ", ".join(map(str, schema.get("enum", [schema.get("const")])))
    if schema.get("type") == "array":
        axes = "axes as the pendant names them, such as A2,A3, or by their numbers"
        return axes if schema.get("x-axes") else _describe_list(schema, definitions)
    if schema.get("type") == "object":
        return _describe_parts(schema)
    words = [_PLAIN.get(str(schema.get("type")), "JSON")]
    words += [f"{word} {schema[bound]:g}" for bound, word in _BOUNDS if bound in schema]
    return " ".join(words)


def _describe_list(schema: Mapping[str, Any], definitions: Mapping[str, Any]) -> str:
    least, most = schema.get("minItems"), schema.get("maxItems")
    items: Mapping[str, Any] = schema.get("items") or next(iter(schema.get("prefixItems", ())), {})
    each = _describe_type(items, definitions)
    if least is not None and least == most:
        return f"[{least} x {each}]"
    many = f", {least or 0} to {most} of them" if most else ""
    return f"[{each}, …{many}]"


def _describe_parts(schema: Mapping[str, Any]) -> str:
    return "{" + ", ".join(schema.get("properties", {})) + "}"
