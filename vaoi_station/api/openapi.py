"""The OpenAPI document that FastAPI generates, made exact for people and simple for client generators.

- An optional field has one type and is not required; replies never hold null for it. Replies may get further fields.
- Every operation declares its refusals as `application/problem+json`, each with its status code.
- Parameters, bodies and answers have examples, and every operation the scope that its key needs.
"""

from __future__ import annotations

import json
from functools import cache
from pathlib import Path
from typing import Any

from fastapi import FastAPI, Request, Response
from fastapi.openapi.utils import get_openapi

from vaoi_station.api.access import scope_needed
from vaoi_station.api.addresses import root_of
from vaoi_station.api.http_caching import REVALIDATE, conditional_response
from vaoi_station.api.limits import ThreadLimit
from vaoi_station.api.problems import KINDS, MEDIA_TYPE, Fault, Problem
from vaoi_station.api.repeated_requests import HEADER
from vaoi_station.api.rest_models import Heartbeat
from vaoi_station.model import BoardType
from vaoi_station.runs.states.schemas import EventRecord
from vaoi_station.settings.keys import documentation, models_of

STREAM = "text/event-stream"
API = "/api/"
DESCRIPTION = """\
The station films a board while it passes. For each frame that shows a component it delivers one upright image.

Unknown fields are left out. Lengths are in mm, angles in degrees counter-clockwise as seen on the board's top, times
are RFC 3339 in UTC. Cameras, rows and views count from 0. Every refusal is a problem detail (RFC 9457) with a stable
`code` and an `action` for the operator. Later versions may add fields to answers: ignore those that you do not know."""
IDEMPOTENCY_KEY = {
    "name": HEADER,
    "in": "header",
    "required": False,
    "description": "A new text for each command, in quotes, and the same to repeat it: a command acts once, and its "
    "reply is given again for an hour. 422: the key was sent with another command; 409: it is still under way.",
    "schema": {"type": "string", "maxLength": 202},
    "example": '"8e03978e-40d5-43e8-bc93-6894a57f9324"',
}
"""Parameter of every command."""
EVENTS = {
    "type": "string",
    "title": "EventStream",
    "description": "Server-sent events. `data` of a message is an EventRecord as JSON and its `id` the event's number; "
    "`data` of an `event: heartbeat` is a Heartbeat.",
    "example": "id: 30\ndata: {…}\n\n",
}
"""Schema of the event stream; its messages have the schemas EventRecord and Heartbeat."""
URL = "/api/v1/openapi.json"
"""Address of the document."""
_SERVER = b'"servers": [{"url": "/"'
"""Begin of the address of the station, in the text of the document."""
_EXAMPLES = Path(__file__).with_name("openapi_examples.json")
"""Examples from a station on the twin: values of parameters by name or `operation.name`, bodies and answers."""
NULL = {"type": "null"}
_LARGE = ("number", "last_event", "after", "generation", "frame_id")
"""Names of whole numbers that may exceed 32 bits; so may those that end with `_bytes`."""
_SIGNS = {"≤": "AtMost", "≥": "AtLeast"}
"""Names of values of an enumeration that have no letter of which a generator could make a name."""
_NOT_SENT = ("Accept", "Authorization", "Content-Type")
"""Headers that OpenAPI describes by other means; clients would otherwise set them twice."""
UNCHANGED = {"description": "The caller has the same content already (If-None-Match)."}
REFUSALS = {
    400: "Malformed",
    401: "KeyRequired",
    403: "NotPermitted",
    404: "NotFound",
    406: "NotAcceptable",
    408: "TooSlow",
    409: "WrongState",
    410: "Gone",
    412: "Changed",
    413: "TooLarge",
    416: "RangeOutside",
    421: "UnknownHost",
    422: "InvalidInput",
    500: "Internal",
    503: "Busy",
}
"""Names of the refusals in the document, by status. Generated clients may use them as names of types."""
_ALWAYS = frozenset({400, 421, 422, 500})
_OF_THE_API = _ALWAYS | {401, 403, 503}
_OF_A_COMMAND = frozenset({408, 409, 413})
_OF_A_RUN = frozenset({404, 409, 410})
_ABSENT = (
    "/station/arm",
    "/orders",
    "/runs",
    "/runs/latest",
    "/runs/next",
    "/doctor",
    "/calibration/trial",
    "/trial/calibration",
)
"""Ends of paths without parameters that may name something that does not exist, or ask for it."""


def install(app: FastAPI) -> None:
    """Make the application publish the document."""

    def document() -> dict[str, Any]:
        if app.openapi_schema is None:
            app.openapi_schema = completed(
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

    @cache
    def text() -> bytes:
        return json.dumps(document(), ensure_ascii=False).encode()

    # Made once, in one thread beside the event loop: it takes longer than a second, and callers need no key.
    making = ThreadLimit(1)

    @app.get(URL, include_in_schema=False)
    async def get_document(request: Request) -> Response:
        content = await making.ask(text)
        if root := root_of(request.scope):
            content = content.replace(_SERVER, _SERVER.replace(b'"/"', f'"{root}"'.encode()), 1)
        return conditional_response(request, content, "application/json", cache=REVALIDATE)


def completed(document: dict[str, Any]) -> dict[str, Any]:
    """Complete and simplify the document that FastAPI generates, in place, and return it."""
    known = document.setdefault("components", {}).setdefault("schemas", {})
    for name in ("HTTPValidationError", "ValidationError"):
        known.pop(name, None)
    for model in (Fault, Problem, EventRecord, Heartbeat):
        schema = model.model_json_schema(ref_template="#/components/schemas/{model}")
        known[model.__name__] = {key: part for key, part in schema.items() if key != "$defs"}
    known["EventStream"] = EVENTS
    for schema in known.values():
        _simplify(schema)
    # Board types are files, too: their models have texts below the attributes, which FastAPI does not read.
    for name, held in models_of(BoardType).items():
        for field, text in documentation(held).items():
            known.get(name, {}).get("properties", {}).get(field, {}).setdefault("description", text)
    examples = json.loads(_EXAMPLES.read_text(encoding="utf-8"))
    operations = [
        (method, path, operation) for path, all_of in document["paths"].items() for method, operation in all_of.items()
    ]
    for method, path, operation in operations:
        _complete(method, path, operation, examples)
    asked = _used_by(known, [operation["requestBody"] for _, _, operation in operations if "requestBody" in operation])
    for name, schema in known.items():
        # Answers may get further fields in later versions.
        if name not in asked and schema.get("additionalProperties") is False:
            del schema["additionalProperties"]
    document["components"] |= {
        "schemas": dict(sorted(known.items())),
        "responses": {name: _refusal(status) for status, name in sorted(REFUSALS.items())},
        "securitySchemes": {"key": {"type": "http", "scheme": "bearer", "description": "A key of `vaoi keys create`."}},
    }
    document["servers"] = [{"url": "/", "description": "The station that serves this document."}]
    # The empty entry: on the station's own machine no key is needed, unless `api.open_loopback` is false.
    document["security"] = [{}, {"key": []}]
    return document


def _complete(method: str, path: str, operation: dict[str, Any], examples: dict[str, Any]) -> None:
    """Complete one operation: its parameters, answers, refusals, examples and scope."""
    answers = operation["responses"]
    answers.pop("422", None)
    for answer in answers.values():
        if STREAM in answer.get("content", {}):
            answer["content"] = {STREAM: {"schema": {"$ref": "#/components/schemas/EventStream"}}}
        for content in answer.get("content", {}).values():
            _simplify(content.get("schema", {}))
    operation["parameters"] = parameters = _sent_parameters(method, operation)
    if not parameters:
        del operation["parameters"]
    if method == "get" and path.startswith(API):
        answers["304"] = UNCHANGED
    if not path.startswith(API):
        # The health addresses give the same document with 503; refusals of their requests come as everywhere.
        answers["503"] = {**answers["200"], "description": "Not able, and why."}
    _add_examples(operation, examples)
    for status in _statuses(method, path, operation):
        answers.setdefault(str(status), {"$ref": f"#/components/responses/{REFUSALS[status]}"})
    operation["responses"] = dict(sorted(answers.items()))
    scope = scope_needed(method.upper(), path)
    if scope is None:
        operation["security"] = []
    else:
        operation["x-scope"] = scope


def _sent_parameters(method: str, operation: dict[str, Any]) -> list[dict[str, Any]]:
    """Return the parameters of an operation without the headers that OpenAPI describes by other means."""
    kept = [p for p in operation.get("parameters", ()) if p["in"] != "header" or p["name"].title() not in _NOT_SENT]
    for parameter in kept:
        parameter["schema"] = _not_null(parameter["schema"])
        _simplify(parameter["schema"], parameter["name"])
        if parameter["in"] == "header":
            parameter["name"] = {"last-event-id": "Last-Event-ID"}.get(parameter["name"], parameter["name"].title())
    streamed = "application/octet-stream" in operation.get("requestBody", {}).get("content", {})
    return kept if method == "get" or streamed else [*kept, dict(IDEMPOTENCY_KEY)]


def _add_examples(operation: dict[str, Any], known: dict[str, Any]) -> None:
    name = operation["operationId"]
    for parameter in operation.get("parameters", ()):
        for key in (parameter["name"], f"{name}.{parameter['name']}"):
            value = known["parameters"].get(key)
            # A general example does not fit a parameter of the same name with other values.
            if value is not None and value in parameter.get("schema", {}).get("enum", [value]):
                parameter["example"] = value
    for kind in operation.get("requestBody", {}).get("content", {}).values():
        if name in known["bodies"]:
            kind["example"] = known["bodies"][name]
    for status, answer in operation["responses"].items():
        content = answer.get("content", {}).get("application/json")
        if content is not None and status in ("200", "201", "202") and name in known["answers"]:
            content["example"] = known["answers"][name]


def _statuses(method: str, path: str, operation: dict[str, Any]) -> set[int]:
    """Return the status codes with which an operation may be refused; parameters of the path are in braces."""
    found = set(_OF_THE_API if path.startswith(API) else _ALWAYS)
    if method != "get":
        found |= _OF_A_COMMAND
    if "{" in path or path.endswith(_ABSENT):
        found.add(404)
    of_a_run = ("/runs/{run}", "/cameras/{camera}/picture", "reference")
    if any(part in path for part in of_a_run) or path.endswith(("/next", "/calibration/marks")):
        found |= _OF_A_RUN
    if any("application/x-npy" in answer.get("content", {}) for answer in operation["responses"].values()):
        found |= {406, 416} if "206" in operation["responses"] else {406}
    if any(parameter["name"] == "If-Match" for parameter in operation.get("parameters", ())):
        found.add(412)
    return found


def _refusal(status: int) -> dict[str, Any]:
    kinds = {kind: entry for kind, entry in KINDS.items() if entry[0] == status}
    examples = {
        kind: {
            "summary": title,
            "value": {
                "type": f"/problems/{kind}",
                "title": title,
                "status": status,
                "detail": f"{title}: the field, its value and the limit.",
                "code": kind,
                "action": action,
                "instance": "/api/v1/station",
            },
        }
        for kind, (_, title, action) in kinds.items()
    }
    words = "; ".join(title for _, title, _ in kinds.values())
    content = {"schema": {"$ref": "#/components/schemas/Problem"}, "examples": examples}
    return {"description": f"{words}.", "content": {MEDIA_TYPE: content}}


def _simplify(schema: Any, name: str = "") -> None:
    """Change a schema in place: numbers state their size, signs their names, and some rarer kinds become common ones.

    `name` is that of the field that it describes. Fields that may be null become optional fields that are never null.
    """
    if isinstance(schema, list):
        for part in schema:
            _simplify(part, name)
    if not isinstance(schema, dict):
        return
    for field, part in schema.get("properties", {}).items():
        # The result file uses null for "no CAD matrix", so clients must expect it.
        plain = part if (schema.get("title"), field) == ("Matrices", "cad_matrix") else _not_null(part)
        if plain is not part:
            schema["properties"][field] = plain
            if field in schema.get("required", []):
                schema["required"].remove(field)
        _simplify(plain, field)
    for key, part in schema.items():
        if key not in ("properties", "example", "examples", "default", "enum", "const"):
            _simplify(part, name)
    _plain_kind(schema, name)


def _plain_kind(schema: dict[str, Any], name: str) -> None:
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
    # `prefixItems` is JSON Schema 2020-12; generators for older OpenAPI versions ignore it.
    kinds = schema.get("prefixItems", [])
    if kinds and all(kind == kinds[0] for kind in kinds):
        schema["items"] = schema.pop("prefixItems")[0]
    elif kinds and all(kind.get("type") in ("integer", "number") for kind in kinds):
        del schema["prefixItems"]
        schema["items"] = {"type": "number", "format": "double"}


def _not_null(schema: dict[str, Any]) -> dict[str, Any]:
    """Return the schema of X for a schema of "X or null". Return any other schema unchanged."""
    choices = schema.get("anyOf", [])
    if NULL not in choices:
        return schema
    rest = [c for c in choices if c != NULL]
    kept = {k: v for k, v in schema.items() if k not in ("anyOf", "default") or (k == "default" and v is not None)}
    return {**kept, **(rest[0] if len(rest) == 1 else {"anyOf": rest})}


def _used_by(schemas: dict[str, Any], roots: Any) -> set[str]:
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
