"""The OpenAPI document in version 3.0, for generators that do not read 3.1 yet."""

from __future__ import annotations

import copy
from typing import Any

VERSION = "3.0.3"
_KEPT_BESIDE_REF = ("description", "default", "example", "title")


def downgraded(document: dict[str, Any]) -> dict[str, Any]:
    """Return a copy of a document of OpenAPI 3.1 as one of 3.0: the same addresses, parameters and fields."""
    older: dict[str, Any] = _converted(copy.deepcopy(document))
    older["openapi"] = VERSION
    return older


def _converted(part: Any, *, is_schema: bool = False) -> Any:
    """Convert a part of the document; `is_schema`: it is a schema, not one of the objects around it."""
    if isinstance(part, list):
        return [_converted(inner, is_schema=is_schema) for inner in part]
    if not isinstance(part, dict):
        return part
    if is_schema:
        return _schema(part)
    done = {}
    for key, inner in part.items():
        if key in ("example", "examples", "value"):
            done[key] = inner
        elif key == "schema":
            done[key] = _schema(inner)
        elif key == "schemas":
            done[key] = {name: _schema(schema) for name, schema in inner.items()}
        else:
            done[key] = _converted(inner)
    return done


def _schema(schema: dict[str, Any]) -> dict[str, Any]:
    """Convert one schema of JSON Schema 2020-12 to the dialect of OpenAPI 3.0."""
    done: dict[str, Any] = {}
    for key, value in schema.items():
        if key == "properties":
            done[key] = {name: _schema(field) for name, field in value.items()}
        elif key in ("items", "additionalProperties", "not") and isinstance(value, dict):
            done[key] = _schema(value)
        elif key in ("anyOf", "oneOf", "allOf"):
            done[key] = [_schema(choice) for choice in value if choice != {"type": "null"}]
            if len(done[key]) < len(value):
                done["nullable"] = True
        elif key == "const":
            done["enum"] = [value]
        elif key == "examples":
            done["example"] = value[0]
        elif key in ("exclusiveMinimum", "exclusiveMaximum"):
            done[key.replace("exclusiveM", "m")], done[key] = value, True
        elif key == "prefixItems":
            done["items"] = {"anyOf": [_schema(item) for item in value]}
        elif key not in ("propertyNames", "patternProperties", "contentMediaType", "$comment"):
            done[key] = value
    return _without_single_choice(_with_reference(done))


def _without_single_choice(schema: dict[str, Any]) -> dict[str, Any]:
    """Replace "one of a single schema", which remains of "X or null", by that schema."""
    choices = schema.get("anyOf", [])
    if len(choices) != 1:
        return schema
    rest = {key: value for key, value in schema.items() if key != "anyOf"}
    return {**rest, "allOf": choices} if "$ref" in choices[0] else {**choices[0], **rest}


def _with_reference(schema: dict[str, Any]) -> dict[str, Any]:
    """Put a reference that has other keys beside it into `allOf`: version 3.0 ignores keys beside a reference."""
    if "$ref" not in schema or len(schema) == 1:
        return schema
    beside = {key: schema[key] for key in _KEPT_BESIDE_REF if key in schema}
    return {**beside, "allOf": [{"$ref": schema["$ref"]}]}
