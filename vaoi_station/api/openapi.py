"""The OpenAPI document: what FastAPI derives from the routes, made easy for generators of clients.

- A field that may be left out is of one type and not required; answers never hold null for it.
- Every operation names its refusals as `application/problem+json`.
"""

from __future__ import annotations

from typing import Any

from fastapi import FastAPI
from fastapi.openapi.utils import get_openapi

from vaoi_station.api.problems import MEDIA_TYPE, Fault, Problem

NULL = {"type": "null"}
DESCRIPTION = """\
The station films a board while it passes, and hands out one upright picture of a component per frame that shows it.

Fields that are unknown are left out. Lengths are mm, angles degrees counter-clockwise as seen on the board's top,
times RFC 3339 in UTC. Cameras, rows and views count from 0. Every refusal is a problem detail (RFC 9457) with a
stable `code` and an `action` for the operator."""


def install(app: FastAPI) -> None:
    """Let the app publish the tidied document."""

    def document() -> dict[str, Any]:
        if app.openapi_schema is None:
            app.openapi_schema = tidied(
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


def tidied(document: dict[str, Any]) -> dict[str, Any]:
    """Without nulls and the framework's own error shapes, with ours."""
    schemas = document.setdefault("components", {}).setdefault("schemas", {})
    for name in ("HTTPValidationError", "ValidationError"):
        schemas.pop(name, None)
    for shape in (Fault, Problem):
        schemas[shape.__name__] = shape.model_json_schema(ref_template="#/components/schemas/{model}")
        schemas[shape.__name__].pop("$defs", None)
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
    """Fields that may be null become fields that may be left out."""
    for name, field in schema.get("properties", {}).items():
        if (schema.get("title"), name) == ("Matrices", "cad_matrix"):
            continue  # in the format of the file this null means something
        plain = _not_null(field)
        if plain is not field:
            schema["properties"][name] = plain
            if name in schema.get("required", []):
                schema["required"].remove(name)


def _plain_lists(schema: Any) -> None:
    """Tuples of one kind become lists of that kind with a fixed length, which older generators understand too."""
    for part in schema.values() if isinstance(schema, dict) else schema if isinstance(schema, list) else ():
        _plain_lists(part)
    if isinstance(schema, dict) and (kinds := schema.get("prefixItems")) and all(k == kinds[0] for k in kinds):
        del schema["prefixItems"]
        schema["items"] = kinds[0]


def _not_null(schema: dict[str, Any]) -> dict[str, Any]:
    """`X or null` as X; anything else as it is."""
    choices = schema.get("anyOf", [])
    if NULL not in choices:
        return schema
    rest = [c for c in choices if c != NULL]
    kept = {k: v for k, v in schema.items() if k not in ("anyOf", "default") or (k == "default" and v is not None)}
    return {**kept, **(rest[0] if len(rest) == 1 else {"anyOf": rest})}
