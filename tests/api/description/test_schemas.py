"""Schemas are made simple for generators of clients."""

from __future__ import annotations

from typing import Any

from vaoi_station.api.description.schemas import (
    not_null,
    open_answers,
    optional_not_null,
    sent_parameters,
    simplify,
    used_by,
)

TEXT_OR_NULL = {"anyOf": [{"type": "string"}, {"type": "null"}], "default": None}


def test_numbers_state_their_size() -> None:
    """A generator without a format would make 32-bit integers of bytes, and decimals of 1e-30."""
    schema: dict[str, Any] = {"properties": {"size_bytes": {"type": "integer"}, "row": {"type": "integer"}}}
    schema["properties"] |= {"x": {"type": "number"}, "number": {"type": "integer"}}
    simplify(schema)
    formats = {name: field.get("format") for name, field in schema["properties"].items()}
    assert formats == {"size_bytes": "int64", "row": None, "x": "double", "number": "int64"}


def test_signs_have_names_for_the_constants_of_a_client() -> None:
    """Generators make names of letters alone, and gave ≤ and ≥ the same one."""
    relation: dict[str, Any] = {"type": "string", "enum": ["≤", "≥"]}
    simplify({"properties": {"relation": relation}})
    assert relation["enum"] == ["≤", "≥"]
    assert relation["x-enum-varnames"] == relation["x-enumNames"] == ["AtMost", "AtLeast"]
    plain: dict[str, Any] = {"type": "string", "enum": ["up", "down"]}
    simplify(plain)
    assert plain == {"type": "string", "enum": ["up", "down"]}


def test_a_fixed_number_is_a_number_with_equal_limits() -> None:
    """The C++ client of openapi-generator does not compile with an enumeration of numbers."""
    version = {"const": 1, "type": "integer", "title": "Version"}
    simplify({"properties": {"version": version}})
    assert version == {"minimum": 1, "maximum": 1, "type": "integer", "title": "Version"}


def test_tuples_are_lists_of_fixed_length() -> None:
    same = {"prefixItems": [{"type": "integer"}] * 2, "minItems": 2, "maxItems": 2}
    mixed = {"prefixItems": [{"type": "integer"}, {"type": "number"}], "minItems": 2, "maxItems": 2}
    simplify([same, mixed])
    assert same["items"] == {"type": "integer"}
    assert mixed["items"] == {"type": "number", "format": "double"}
    assert "prefixItems" not in same | mixed


def test_a_field_that_may_be_null_is_optional_and_never_null() -> None:
    schema: dict[str, Any] = {"properties": {"a": TEXT_OR_NULL, "b": {"type": "integer"}}, "required": ["a", "b"]}
    optional_not_null(schema)
    assert schema == {"properties": {"a": {"type": "string"}, "b": {"type": "integer"}}, "required": ["b"]}
    assert not_null({"type": "string"}) == {"type": "string"}
    three = {"anyOf": [{"type": "string"}, {"type": "integer"}, {"type": "null"}]}
    assert not_null(three) == {"anyOf": [{"type": "string"}, {"type": "integer"}]}
    matrices: dict[str, Any] = {"title": "Matrices", "properties": {"cad_matrix": TEXT_OR_NULL}}
    optional_not_null(matrices)
    assert matrices["properties"]["cad_matrix"] is TEXT_OR_NULL


def test_answers_are_open_and_requests_closed() -> None:
    schemas: dict[str, Any] = {name: {"additionalProperties": False} for name in ("Asked", "Inside", "Answer")}
    schemas["Asked"]["properties"] = {"inside": {"$ref": "#/components/schemas/Inside"}}
    asked = used_by(schemas, [{"schema": {"$ref": "#/components/schemas/Asked"}}])
    assert asked == {"Asked", "Inside"}
    open_answers(schemas, asked)
    assert [name for name, schema in schemas.items() if "additionalProperties" not in schema] == ["Answer"]


def test_headers_that_clients_set_themselves_are_no_parameters() -> None:
    parameters = [
        {"in": "header", "name": "accept", "schema": dict(TEXT_OR_NULL)},
        {"in": "header", "name": "last-event-id", "schema": dict(TEXT_OR_NULL)},
        {"in": "query", "name": "after", "schema": {"type": "integer"}},
    ]
    kept = sent_parameters(parameters)
    assert [(p["name"], p["schema"]) for p in kept] == [
        ("Last-Event-ID", {"type": "string"}),
        ("after", {"type": "integer", "format": "int64"}),
    ]
