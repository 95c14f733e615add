"""The OpenAPI document that FastAPI generates, made exact for people and simple for client generators.

- An optional field has one type and is not required; replies never hold null for it. Replies may get further fields.
- Every operation declares its refusals as `application/problem+json`, each with its status code.
- Answers have their headers, parameters and bodies examples, and every operation the scope that its key needs.
"""

from __future__ import annotations

import json
from functools import cache
from typing import Any

from fastapi import FastAPI, Request, Response
from fastapi.openapi.utils import get_openapi
from pydantic import BaseModel

from vaoi_station.api.access.scopes import scope_needed
from vaoi_station.api.addressing.path_prefix import path_of, root_of
from vaoi_station.api.callers.repeated_requests import HEADER
from vaoi_station.api.callers.thread_limit import ThreadLimit
from vaoi_station.api.description import headers, refusals, schemas
from vaoi_station.api.description.examples import add_examples
from vaoi_station.api.description.for_c import for_c
from vaoi_station.api.description.older import downgraded
from vaoi_station.api.http_caching import REVALIDATE, conditional_response
from vaoi_station.api.problems import Fault, Problem
from vaoi_station.api.rest_models import Heartbeat
from vaoi_station.runs.states.schemas import EventRecord

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
OLDER_URL = "/api/v1/openapi-3.0.json"
"""Address of the document in version 3.0."""
C_URL = "/api/v1/openapi-c.json"
"""Address of the document of which a C client can be made."""
_SERVER = b'"servers": [{"url": "/"'
"""Begin of the address of the station, to which paths of the document are relative, in the document's text."""


def install(app: FastAPI) -> None:
    """Make the application publish the document, the same in version 3.0 for older generators, and one for C."""

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
    def text(url: str) -> bytes:
        shown = document()
        if url in (OLDER_URL, C_URL):
            shown = downgraded(shown)
        if url == C_URL:
            shown = for_c(shown)
        return json.dumps(shown, ensure_ascii=False).encode()

    # Made once, in one thread beside the event loop: it takes longer than a second, and callers need no key.
    making = ThreadLimit(1)

    @app.get(URL, include_in_schema=False)
    @app.get(OLDER_URL, include_in_schema=False)
    @app.get(C_URL, include_in_schema=False)
    async def get_document(request: Request) -> Response:
        content = await making.ask(text, path_of(request.scope))
        if root := root_of(request.scope):
            content = content.replace(_SERVER, _SERVER.replace(b'"/"', f'"{root}"'.encode()), 1)
        return conditional_response(request, content, "application/json", cache=REVALIDATE)


def completed(document: dict[str, Any]) -> dict[str, Any]:
    """Complete and simplify the document that FastAPI generates, in place, and return it."""
    known = document.setdefault("components", {}).setdefault("schemas", {})
    for name in ("HTTPValidationError", "ValidationError"):
        known.pop(name, None)
    for model in (Fault, Problem, EventRecord, Heartbeat):
        known[model.__name__] = _schema_of(model)
    known["EventStream"] = EVENTS
    for schema in known.values():
        schemas.optional_not_null(schema)
        schemas.simplify(schema)
    for path, operations in document["paths"].items():
        for method, operation in operations.items():
            _complete(method, path, operation)
    asked = [o["requestBody"] for operations in document["paths"].values() for o in operations.values() if _asks(o)]
    schemas.open_answers(known, schemas.used_by(known, asked))
    answers = refusals.answers()
    for status, name in refusals.NAMES.items():
        answers[name]["headers"] = headers.of_refusal(status)
    document["components"] |= {
        "schemas": dict(sorted(known.items())),
        "responses": answers,
        "headers": headers.HEADERS,
        "securitySchemes": {"key": {"type": "http", "scheme": "bearer", "description": "A key of `vaoi keys create`."}},
    }
    document["servers"] = [{"url": "/", "description": "The station that serves this document."}]
    # The empty entry: on the station's own machine no key is needed, unless `api.open_loopback` is false.
    document["security"] = [{}, {"key": []}]
    return document


def _complete(method: str, path: str, operation: dict[str, Any]) -> None:
    """Complete one operation: its refusals, headers, examples and scope."""
    answers = operation["responses"]
    answers.pop("422", None)
    for answer in answers.values():
        if STREAM in answer.get("content", {}):
            answer["content"] = {STREAM: {"schema": {"$ref": "#/components/schemas/EventStream"}}}
        for content in answer.get("content", {}).values():
            schemas.simplify(content.get("schema", {}))
    if "parameters" in operation:
        operation["parameters"] = schemas.sent_parameters(operation["parameters"])
    streamed = "application/octet-stream" in operation.get("requestBody", {}).get("content", {})
    if method != "get" and not streamed:
        operation.setdefault("parameters", []).append(IDEMPOTENCY_KEY)
    for status, answer in list(answers.items()):
        answer["headers"] = headers.of_answer(method, operation, status, answer)
    if method == "get" and operation["operationId"] in headers.CONDITIONAL:
        answers["304"] = {**headers.UNCHANGED, "headers": headers.of_answer(method, operation, "304", {})}
    if not path.startswith(API):
        # The health addresses give the same document with 503; refusals of their requests come as everywhere.
        answers["503"] = {**answers["200"], "description": "Not able, and why."}
    add_examples(operation)
    for status in refusals.statuses(method, path, operation):
        answers.setdefault(str(status), refusals.reference(status))
    operation["responses"] = dict(sorted(answers.items()))
    scope = scope_needed(method.upper(), path)
    if scope is None:
        operation["security"] = []
    else:
        operation["x-scope"] = scope


def _asks(operation: dict[str, Any]) -> bool:
    return "requestBody" in operation


def _schema_of(model: type[BaseModel]) -> dict[str, Any]:
    schema = model.model_json_schema(ref_template="#/components/schemas/{model}")
    schema.pop("$defs", None)
    return schema
