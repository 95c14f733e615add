"""The document in version 3.0 says the same in its own words."""

from __future__ import annotations

from vaoi_station.api.description.older import downgraded


def test_schemas_are_those_of_version_3_0() -> None:
    schemas = {
        "A": {"properties": {"k": {"const": 1}, "x": {"exclusiveMinimum": 0, "type": "number", "examples": [2.5]}}},
        "B": {"anyOf": [{"type": "string"}, {"type": "null"}], "title": "B"},
        "C": {"anyOf": [{"$ref": "#/components/schemas/A"}, {"type": "null"}]},
        "D": {"$ref": "#/components/schemas/A", "description": "Beside a reference."},
        "E": {"prefixItems": [{"type": "string"}, {"type": "integer"}], "propertyNames": {"pattern": "x"}},
        "F": {"additionalProperties": {"const": "y"}, "items": {"const": "z"}},
    }
    content = {"schema": {"const": "v"}, "example": {"const": "kept"}, "examples": {"one": {"value": {"const": 3}}}}
    document = {"openapi": "3.1.0", "components": {"schemas": schemas}, "paths": {"/p": {"get": {"content": content}}}}
    older = downgraded(document)
    assert older["openapi"] == "3.0.3"
    assert older["components"]["schemas"] == {
        "A": {
            "properties": {
                "k": {"enum": [1]},
                "x": {"minimum": 0, "exclusiveMinimum": True, "type": "number", "example": 2.5},
            }
        },
        "B": {"type": "string", "nullable": True, "title": "B"},
        "C": {"nullable": True, "allOf": [{"$ref": "#/components/schemas/A"}]},
        "D": {"description": "Beside a reference.", "allOf": [{"$ref": "#/components/schemas/A"}]},
        "E": {"items": {"anyOf": [{"type": "string"}, {"type": "integer"}]}},
        "F": {"additionalProperties": {"enum": ["y"]}, "items": {"enum": ["z"]}},
    }
    found = older["paths"]["/p"]["get"]["content"]
    assert found == {"schema": {"enum": ["v"]}, "example": {"const": "kept"}, "examples": content["examples"]}
    assert document["components"]["schemas"]["A"]["properties"]["k"] == {"const": 1}  # type: ignore[index]
