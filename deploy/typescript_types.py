"""Write web/src/lib/api_types.ts from the OpenAPI description of the service: `make types`. A test finds it stale."""

import json
import sys
import tempfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from cellcal.service.demo.fake_cell import write_cell_file
from cellcal.service.web.app import create_app
from cellcal.service.web.context import ServiceSettings

TARGET = Path(__file__).parents[1] / "web" / "src" / "lib" / "api_types.ts"
_HEAD = """\
// Written by `make types` from the service's OpenAPI description. Do not edit: a test compares it with the service.

"""
_PLAIN = {"string": "string", "integer": "number", "number": "number", "boolean": "boolean", "null": "null"}

Schema = Mapping[str, Any]


def described_schemas() -> dict[str, Schema]:
    """Return the schemas of the service's description by their names."""
    with tempfile.TemporaryDirectory() as folder:
        cell = write_cell_file(Path(folder), "127.0.0.1", seed=1, time_factor=1.0)
        description = create_app(ServiceSettings(cell, open_access=True)).openapi()
    return dict(description["components"]["schemas"])


def write_types(schemas: Mapping[str, Schema]) -> str:
    """Return the TypeScript declarations of schemas, in the order of their names."""
    return _HEAD + "\n".join(_type_declaration(name, schemas[name]) for name in sorted(schemas))


def _type_declaration(name: str, schema: Schema) -> str:
    if schema.get("type") != "object" or "properties" not in schema:
        return f"export type {_quoted_identifier(name)} = {_type_of(schema)};\n"
    required = set(schema.get("required", ()))
    lines = [
        f"  {key if key.isidentifier() else json.dumps(key)}{'' if key in required else '?'}: {_type_of(each)};"
        for key, each in schema["properties"].items()
    ]
    return "\n".join([f"export interface {_quoted_identifier(name)} {{", *lines, "}\n"])


def _type_of(schema: Schema) -> str:
    if "$ref" in schema:
        return _quoted_identifier(schema["$ref"].rpartition("/")[2])
    if "const" in schema or "enum" in schema:
        return " | ".join(json.dumps(value) for value in schema.get("enum", [schema.get("const")]))
    choices = schema.get("anyOf", schema.get("oneOf"))
    if choices:
        return " | ".join(dict.fromkeys(_type_of(each) for each in choices))
    structured = {"array": _array_of, "object": _record_of}.get(str(schema.get("type")))
    return structured(schema) if structured else _PLAIN.get(str(schema.get("type")), "unknown")


def _array_of(schema: Schema) -> str:
    if "prefixItems" in schema:
        return f"[{', '.join(_type_of(each) for each in schema['prefixItems'])}]"
    item = _type_of(schema.get("items", {}))
    return f"({item})[]" if " " in item else f"{item}[]"


def _record_of(schema: Schema) -> str:
    values = schema.get("additionalProperties", True)
    return f"Record<string, {'unknown' if isinstance(values, bool) else _type_of(values)}>"


def _quoted_identifier(name: str) -> str:
    return "".join(part[:1].upper() + part[1:] for part in name.replace(".", "_").split("-"))


if __name__ == "__main__":
    TARGET.write_text(write_types(described_schemas()), encoding="utf-8")
    sys.stderr.write(f"{TARGET} is written.\n")
