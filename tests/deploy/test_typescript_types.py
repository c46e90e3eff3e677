"""The pages' types are those of the service: written from its description, and written again when that changes."""

import pytest

from deploy.typescript_types import TARGET, described_schemas, write_types


def test_the_types_of_the_pages_are_those_of_the_service() -> None:
    assert TARGET.read_text(encoding="utf-8") == write_types(described_schemas()), "run `make types`"


@pytest.mark.parametrize(
    ("schema", "expected"),
    [
        ({"type": "array", "items": {"type": "number"}}, "number[]"),
        ({"anyOf": [{"type": "string"}, {"type": "null"}]}, "string | null"),
        ({"type": "array", "items": {"anyOf": [{"type": "integer"}, {"type": "null"}]}}, "(number | null)[]"),
        ({"type": "array", "prefixItems": [{"type": "number"}, {"type": "string"}]}, "[number, string]"),
        ({"enum": ["a", "b"]}, '"a" | "b"'),
        ({"const": 3}, "3"),
        (
            {"type": "object", "additionalProperties": {"$ref": "#/components/schemas/A-Input"}},
            "Record<string, AInput>",
        ),
        ({}, "unknown"),
    ],
)
def test_a_schema_becomes_its_type(schema: dict[str, object], expected: str) -> None:
    assert f"export type X = {expected};" in write_types({"X": schema})


def test_a_field_with_a_default_may_be_missing() -> None:
    schema = {
        "type": "object",
        "properties": {"a": {"type": "number"}, "b-c": {"type": "string"}},
        "required": ["a"],
    }
    assert write_types({"x": schema}).endswith('export interface X {\n  a: number;\n  "b-c"?: string;\n}\n')
