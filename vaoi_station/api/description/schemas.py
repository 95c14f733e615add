"""Schemas that client generators of many languages understand, made from those of FastAPI and pydantic."""

from __future__ import annotations

from typing import Any

NULL = {"type": "null"}
_LARGE = ("number", "last_event", "after", "generation", "frame_id")
"""Names of whole numbers that may exceed 32 bits; so may those that end with `_bytes`."""
_SIGNS = {"≤": "AtMost", "≥": "AtLeast"}
"""Names of values of an enumeration that have no letter of which a generator could make a name."""
_NOT_SENT = ("Accept", "Authorization", "Content-Type")
"""Headers that OpenAPI describes by other means; clients would otherwise set them twice."""


def simplify(schema: Any, name: str = "") -> None:
    """Change a schema in place: numbers state their size, signs their names, and some rarer kinds become common ones.

    Args:
        schema: schema, or a part of one.
        name: name of the field that it describes.
    """
    if isinstance(schema, list):
        for part in schema:
            simplify(part, name)
    if not isinstance(schema, dict):
        return
    for key, part in schema.items():
        if key == "properties":
            for field, inner in part.items():
                simplify(inner, field)
        elif key not in ("example", "examples", "default", "enum", "const"):
            simplify(part, name)
    # Without a format, some generators make 32-bit integers and decimals, which overflow.
    if schema.get("type") == "integer" and (name in _LARGE or name.endswith("_bytes") or name == "counters"):
        schema.setdefault("format", "int64")
    if schema.get("type") == "number":
        schema.setdefault("format", "double")
    if isinstance(schema.get("const"), int) and schema.get("type") == "integer":
        # Generators make an enumeration of one text of it, which the C++ of openapi-generator cannot compile.
        schema["minimum"] = schema["maximum"] = schema.pop("const")
    if any(value in _SIGNS for value in schema.get("enum", ())):
        # The first is read by openapi-generator, the second by NSwag, which otherwise names every sign `_`.
        names = [_SIGNS.get(value, value) for value in schema["enum"]]
        schema |= {"x-enum-varnames": names, "x-enumNames": list(names)}
    _plain_list(schema)


def _plain_list(schema: dict[str, Any]) -> None:
    # `prefixItems` is JSON Schema 2020-12; generators for older OpenAPI versions ignore it.
    kinds = schema.get("prefixItems")
    if not kinds:
        return
    whole = all(kind.get("type") in ("integer", "number") for kind in kinds)
    if all(kind == kinds[0] for kind in kinds):
        schema["items"] = schema.pop("prefixItems")[0]
    elif whole:
        del schema["prefixItems"]
        schema["items"] = {"type": "number", "format": "double"}


def not_null(schema: dict[str, Any]) -> dict[str, Any]:
    """Return the schema of X for a schema of "X or null". Return any other schema unchanged."""
    choices = schema.get("anyOf", [])
    if NULL not in choices:
        return schema
    rest = [c for c in choices if c != NULL]
    kept = {k: v for k, v in schema.items() if k not in ("anyOf", "default") or (k == "default" and v is not None)}
    return {**kept, **(rest[0] if len(rest) == 1 else {"anyOf": rest})}


def optional_not_null(schema: dict[str, Any]) -> None:
    """Change the fields of an object schema that may be null to optional fields that are never null."""
    for name, field in schema.get("properties", {}).items():
        if (schema.get("title"), name) == ("Matrices", "cad_matrix"):
            # The result file uses null here for "no CAD matrix", so clients must expect it.
            continue
        plain = not_null(field)
        if plain is not field:
            schema["properties"][name] = plain
            if name in schema.get("required", []):
                schema["required"].remove(name)


def open_answers(schemas: dict[str, Any], asked: set[str]) -> None:
    """Let answers have further fields: later versions may add some. `asked` are the names of schemas of requests."""
    for name, schema in schemas.items():
        if name not in asked and schema.get("additionalProperties") is False:
            del schema["additionalProperties"]


def sent_parameters(parameters: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """Return the parameters of an operation without the headers that OpenAPI describes by other means."""
    kept = [p for p in parameters if not (p["in"] == "header" and p["name"].title() in _NOT_SENT)]
    for parameter in kept:
        parameter["schema"] = not_null(parameter["schema"])
        simplify(parameter["schema"], parameter["name"])
        if parameter["in"] == "header":
            parameter["name"] = {"last-event-id": "Last-Event-ID"}.get(parameter["name"], parameter["name"].title())
    return kept


def used_by(schemas: dict[str, Any], roots: Any) -> set[str]:
    """Return the names of all schemas to which a part of the document refers, directly or through others."""
    found: set[str] = set()
    waiting = [roots]
    while waiting:
        part = waiting.pop()
        if isinstance(part, dict):
            name = str(part.get("$ref", "")).rpartition("/")[2]
            if name in schemas and name not in found:
                found.add(name)
                waiting.append(schemas[name])
            waiting += part.values()
        elif isinstance(part, list):
            waiting += part
    return found
