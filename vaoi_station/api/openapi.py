"""The OpenAPI document that FastAPI generates, simplified for client generators.

- An optional field has one type and is not required; replies never hold null for it.
- Every operation declares its refusals as `application/problem+json`.
"""

from __future__ import annotations

from typing import Any

from fastapi import FastAPI
from fastapi.openapi.utils import get_openapi

from vaoi_station.api.problems import MEDIA_TYPE, Fault, Problem

NULL = {"type": "null"}
DESCRIPTION = """\
The station films a board while it passes. For each frame that shows a component it delivers one upright image.

Unknown fields are left out. Lengths are in mm, angles in degrees counter-clockwise as seen on the board's top, times
are RFC 3339 in UTC. Cameras, rows and views count from 0. Every refusal is a problem detail (RFC 9457) with a stable
`code` and an `action` for the operator."""


def install(app: FastAPI) -> None:
    """Make the application publish the simplified OpenAPI document."""

    def document() -> dict[str, Any]:
        if app.openapi_schema is None:
            app.openapi_schema = simplified(
                get_openapi(
                    title=app.title,
                    version=app.version,
                    description=DESCRIPTION,
                    routes=app.routes,
                    separate_input_output_schemas=False,
                )
            )
        return app.openapi_schema

    app.openapi = document  # type: ignore[method-assign]  # FastAPI's own way to extend the document


def simplified(document: dict[str, Any]) -> dict[str, Any]:
    """Simplify an OpenAPI document in place and return it: no null types, and `Problem` instead of FastAPI's errors."""
    schemas = document.setdefault("components", {}).setdefault("schemas", {})
    for name in ("HTTPValidationError", "ValidationError"):
        schemas.pop(name, None)
    for model in (Fault, Problem):
        schemas[model.__name__] = model.model_json_schema(ref_template="#/components/schemas/{model}")
        schemas[model.__name__].pop("$defs", None)
    for schema in schemas.values():
        _optional_not_null(schema)
        _plain_lists(schema)
    refusal = {"description": "Refused.", "content": {MEDIA_TYPE: {"schema": {"$ref": "#/components/schemas/Problem"}}}}
    for operations in document["paths"].values():
        for operation in operations.values():
            operation["responses"].pop("422", None)
            operation["responses"]["default"] = refusal
            for parameter in operation.get("parameters", []):
                parameter["schema"] = _not_null(parameter["schema"])
    document["components"]["schemas"] = dict(sorted(schemas.items()))
    return document


def _optional_not_null(schema: dict[str, Any]) -> None:
    """Change the fields of an object schema that may be null to optional fields that are never null."""
    for name, field in schema.get("properties", {}).items():
        if (schema.get("title"), name) == ("Matrices", "cad_matrix"):
            # The result file uses null here for "no CAD matrix", so clients must expect it.
            continue
        plain = _not_null(field)
        if plain is not field:
            schema["properties"][name] = plain
            if name in schema.get("required", []):
                schema["required"].remove(name)


def _plain_lists(schema: Any) -> None:
    """Describe tuples whose items all have one type as lists of fixed length, in the whole schema."""
    # `prefixItems` is JSON Schema 2020-12; generators for older OpenAPI versions ignore it.
    for part in schema.values() if isinstance(schema, dict) else schema if isinstance(schema, list) else ():
        _plain_lists(part)
    if isinstance(schema, dict) and (kinds := schema.get("prefixItems")) and all(k == kinds[0] for k in kinds):
        del schema["prefixItems"]
        schema["items"] = kinds[0]


def _not_null(schema: dict[str, Any]) -> dict[str, Any]:
    """Return the schema of X for a schema of "X or null". Return any other schema unchanged."""
    choices = schema.get("anyOf", [])
    if NULL not in choices:
        return schema
    rest = [c for c in choices if c != NULL]
    kept = {k: v for k, v in schema.items() if k not in ("anyOf", "default") or (k == "default" and v is not None)}
    return {**kept, **(rest[0] if len(rest) == 1 else {"anyOf": rest})}
