"""What programs use of the REST interface, taken from an OpenAPI document: to compare it with a released version."""

from __future__ import annotations

from typing import Any


def interface_of(document: dict[str, Any]) -> dict[str, dict[str, list[str]]]:
    """Return for each operation its parameters, those that are required, and the fields of bodies and answers."""
    found = {}
    for path, methods in document["paths"].items():
        for method, operation in methods.items():
            parameters = operation.get("parameters", [])
            answers = [answer for status, answer in operation["responses"].items() if status.startswith("2")]
            found[f"{method.upper()} {path.removeprefix('/api/v1/')}"] = {
                "parameters": sorted(f"{p['in']} {p['name']}" for p in parameters if p["in"] != "header"),
                "required": sorted(f"{p['in']} {p['name']}" for p in parameters if p.get("required")),
                "body": _fields(operation.get("requestBody", {}), document),
                "answer": sorted({field for answer in answers for field in _fields(answer, document)}),
            }
    return found


def _fields(part: dict[str, Any], document: dict[str, Any]) -> list[str]:
    """Return the names of the fields of a JSON body, those of its inner objects with a dot."""
    schema = part.get("content", {}).get("application/json", {}).get("schema", {})
    return sorted(_names(schema, document, "", ()))


def _names(schema: dict[str, Any], document: dict[str, Any], before: str, seen: tuple[str, ...]) -> set[str]:
    if (reference := schema.get("$ref", "")) in seen:
        return set()
    if reference:
        seen = (*seen, reference)
        schema = document["components"]["schemas"][reference.rpartition("/")[2]]
    found = set()
    for name, inner in schema.get("properties", {}).items():
        found |= {f"{before}{name}"} | _names(inner, document, f"{before}{name}.", seen)
    for inner in (schema.get("items"), *schema.get("anyOf", ()), *schema.get("allOf", ())):
        if isinstance(inner, dict):
            found |= _names(inner, document, before, seen)
    return found
