"""Random requests over the whole document of the REST interface, and what is wrong with an answer."""

from __future__ import annotations

import json
import random
import re
import sys
from collections.abc import Collection, Mapping
from types import MappingProxyType
from typing import Any, NamedTuple
from urllib.parse import quote

import httpx2

GOOD: dict[str, tuple[Any, ...]] = {
    "run": ("r000001", "r000002"), "name": ("demo-board", "new"), "camera": (0, 1), "row": (0, 1, 2), "k": (0, 1),
    "ref": ("U1", "R1", "2/R1"), "picture": ("board", "board,hdr"), "level": (8, 9), "column": (0,),
    "size": ("240,160",), "suffix": ("jpg", "png"), "region": ("full", "0,0,64,64"),
    "revision": ("20260101T120000000Z-00000000",),
    "file": ("x",), "board_type": ("demo-board",), "after": ("r000001", 0), "before": ("r000002",), "holder": ("h",),
    "component": ("U1",), "format": ("raw", "png", "jpeg"), "px_per_mm": (5, 20), "limit": (1, 10), "runs": (1,),
    "light": ("left",), "seen_from": ("left", 90), "order": ("best", "sharpest"), "x0": (0,), "x1": (9,), "y0": (0,),
    "since": ("2026-01-01T00:00:00Z", "0001-01-01T00:00:00+23:00"), "until": ("9999-12-31T23:59:59-23:00",),
}  # fmt: skip
"""Values that often mean something, by the name of the parameter."""
BAD = (
    "",
    "-1",
    "0",
    "1e9",
    "nan",
    "inf",
    "true",
    "null",
    "..",
    "%",
    "é",
    "\x00",
    "'",
    '"',
    "a" * 300,
    10**20,
    "[",
    "*",
    "r9",
)
HEADERS: dict[str, tuple[str, ...]] = {
    "Accept": ("*/*", "image/png", "application/json", "application/problem+json", "text/html", "x", "image/jpeg;q=z"),
    "If-None-Match": ("*", '"x"', "x,y"),
    "If-Match": ("*", '"x"', "W/x"),
    "Idempotency-Key": ('"a"', '"b"', "c", "", "two words"),
    "Origin": ("http://elsewhere", "null"),
    "Last-Event-ID": ("0", "3", "-1", "x"),
    "Range": ("bytes=0-10", "bytes=9-1", "x"),
    "Sec-Fetch-Site": ("same-origin", "cross-site"),
}
JSON_PARTS: tuple[Any, ...] = (
    None,
    True,
    0,
    -1,
    1e308,
    "",
    "x",
    "demo-board",
    [],
    {},
    [[]],
    {"a": {}},
    "r000001",
    ["read"],
    ["admin"],
)


class Asked(NamedTuple):
    """A request that was made up."""

    method: str
    path: str
    query: list[tuple[str, str]]
    headers: dict[str, str]
    body: bytes
    exact: bool
    """Whether the request goes to the operation for which it was made: no part of its path changes the address."""


class Requests:
    """Makes requests for the operations of a document."""

    def __init__(
        self,
        document: dict[str, Any],
        seed: int,
        known: Mapping[str, tuple[Any, ...]] = MappingProxyType({}),
        without: Collection[str] = (),
    ) -> None:
        """Choose by `seed`. `known` are values that mean something beside `GOOD`, `without` the ids of operations."""
        self._random, self._good = random.Random(seed), {**GOOD, **known}
        self._operations = [
            (path, method, operation)
            for path, methods in document["paths"].items()
            for method, operation in methods.items()
            if operation["operationId"] not in without
        ]

    def next(self) -> tuple[dict[str, Any], Asked]:
        """Return an operation and a request for it."""
        path, method, operation = self._random.choice(self._operations)
        exact = True
        for name in re.findall(r"{(\w+)}", path):
            piece = str(self._value(name, 0.8))
            exact &= bool(piece) and not set(piece) & set("/.?#%_,") and piece.isprintable()
            path = path.replace(f"{{{name}}}", quote(piece, safe=""))
        query = []
        for parameter in operation.get("parameters", ()):
            if parameter["in"] == "query" and (parameter["required"] or self._random.random() < 0.2):
                value = "0" if parameter["name"] == "timeout" else str(self._value(parameter["name"], 0.6))
                query.append((parameter["name"], value))
        if path.endswith("/next"):
            query = [(name, value) for name, value in query if name != "timeout"] + [("timeout", "0")]
        if self._random.random() < 0.03:
            query.append(("nonsense", "1"))
        headers = {n: self._random.choice(v) for n, v in HEADERS.items() if self._random.random() < 0.08}
        body = self._body(operation) if method != "get" else b""
        return operation, Asked(method.upper(), path, query, headers, body, exact)

    def _value(self, name: str, good: float) -> Any:
        known = self._good.get(name, ())
        return self._random.choice(known if known and self._random.random() < good else BAD)

    def _body(self, operation: dict[str, Any]) -> bytes:
        if "requestBody" not in operation or self._random.random() < 0.1:
            return self._random.choice((b"", b"", b"{", b"[]", b"\xff", b"{}", b'{"a":1,"a":2}'))
        [content] = operation["requestBody"]["content"].values()
        if "example" not in content:
            return self._random.randbytes(20)
        document = json.loads(json.dumps(content["example"]))
        while self._random.random() < 0.5:
            document[self._random.choice([*document, "more"])] = self._random.choice(JSON_PARTS)
        return json.dumps(document).encode()


def answer_to(client: httpx2.Client, asked: Asked) -> httpx2.Response:
    """Send a request and read its answer: of a stream of events, which does not end, the first line."""
    query = httpx2.QueryParams(tuple(asked.query))
    with client.stream(asked.method, asked.path, params=query, headers=asked.headers, content=asked.body) as answer:
        if answer.headers.get("content-type", "").startswith("text/event-stream"):
            assert next(answer.iter_lines())
        else:
            answer.read()
    return answer


def wrong_with(answer: Any, operation: dict[str, Any], document: dict[str, Any], *, exact: bool) -> str:
    """Return what is wrong with an answer; empty if it is one that the document states."""
    kind, status = answer.headers.get("content-type", ""), str(answer.status_code)
    if status == "500":
        return "internal error"
    if not exact:
        return "" if status < "400" or kind == "application/problem+json" else "no problem document"
    stated = operation["responses"].get(status)
    if stated is None:
        return "undocumented status"
    if "$ref" in stated:
        stated = document["components"]["responses"][stated["$ref"].rpartition("/")[2]]
    return content_fault(answer, kind.partition(";")[0], stated, document)


def content_fault(answer: Any, kind: str, stated: dict[str, Any], document: dict[str, Any]) -> str:
    """Return what is wrong with headers or content of an answer; empty if they are as stated."""
    missing = {"X-Vaoi-Version", "Cache-Control"} - {h.title() for h in answer.headers}
    if missing:
        return f"without {missing}"
    contents = stated.get("content", {})
    if kind not in contents and (contents or answer.content):
        return f"undocumented content type {kind!r}"
    fine = not kind.endswith("json") or fits(answer.json(), contents[kind]["schema"], document)
    return "" if fine else "outside of the schema"


def fits(value: Any, schema: dict[str, Any], document: dict[str, Any]) -> bool:
    """Return whether a JSON value matches a schema; covers the JSON Schema that the document uses in replies."""
    if "$ref" in schema:
        schema = document["components"]["schemas"][schema["$ref"].rsplit("/", 1)[1]]
    if "anyOf" in schema:
        return any(fits(value, s, document) for s in schema["anyOf"])
    if "enum" in schema or "const" in schema:
        return value in schema.get("enum", [schema.get("const")])
    kind = schema.get("type")
    if kind == "object":
        known, more = schema.get("properties", {}), schema.get("additionalProperties", True)
        return (
            isinstance(value, dict)
            and set(schema.get("required", [])) <= value.keys()
            and (more is not False or value.keys() <= known.keys())
            and all(
                fits(v, known.get(k, more), document)
                for k, v in value.items()
                if k in known or more not in (True, False)
            )
        )
    if kind == "array":
        fewest, most = schema.get("minItems", 0), schema.get("maxItems", sys.maxsize)
        listed = isinstance(value, list) and fewest <= len(value) <= most
        return listed and all(fits(v, schema.get("items", {}), document) for v in value)
    python: dict[str, Any] = {
        "string": str,
        "integer": int,
        "number": (int, float),
        "boolean": bool,
        "null": type(None),
    }
    # In Python a truth value is a number as well.
    return kind is None or (isinstance(value, python[kind]) and (kind == "boolean" or not isinstance(value, bool)))
