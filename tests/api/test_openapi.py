"""The OpenAPI document equals the golden file, and replies match it."""

from __future__ import annotations

import json
import os
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any
from urllib.parse import quote

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.api.board_data.test_previews import import_here
from tests.board_data.readers import samples
from vaoi_station.api import create_app
from vaoi_station.api.access.access_control import AccessControl
from vaoi_station.api.access.audit import AuditLog
from vaoi_station.api.board_data import previews
from vaoi_station.files.access_keys import KeyFile

GOLDEN = Path(__file__).parent / "openapi.json"


@pytest.fixture
def document(station: Any, tmp_path: Path) -> Iterator[dict[str, Any]]:
    audit = AuditLog(tmp_path / "audit.jsonl")
    yield json.loads(json.dumps(create_app(station, access=AccessControl(KeyFile(tmp_path / "k"), audit)).openapi()))
    audit.close()


def operations(document: dict[str, Any]) -> Iterator[tuple[str, str, dict[str, Any]]]:
    for path, methods in document["paths"].items():
        for method, operation in methods.items():
            yield path, method, operation


def parts(node: Any) -> Iterator[dict[str, Any]]:
    if isinstance(node, dict):
        yield node
    for inner in node.values() if isinstance(node, dict) else node if isinstance(node, list) else ():
        yield from parts(inner)


def test_the_interface_changes_only_on_purpose(document: dict[str, Any]) -> None:
    """After an intended change: run with VAOI_WRITE_GOLDEN=1, and review the difference."""
    document["info"].pop("version")
    if os.environ.get("VAOI_WRITE_GOLDEN"):
        GOLDEN.write_text(json.dumps(document, indent=1, sort_keys=True) + "\n")
    assert document == json.loads(GOLDEN.read_text())


def test_every_operation_has_a_stable_name_a_description_and_its_refusals(document: dict[str, Any]) -> None:
    names = [operation["operationId"] for _, _, operation in operations(document)]
    assert len(set(names)) == len(names)
    for _, _, operation in operations(document):
        assert re.fullmatch(r"[a-z]+(_[a-z]+)+", operation["operationId"])
        assert operation["description"]
        assert list(operation["responses"]["default"]["content"]) == ["application/problem+json"]


def test_fields_have_one_type_except_where_the_file_format_has_null(document: dict[str, Any]) -> None:
    found = {
        schema["title"]
        for schema in document["components"]["schemas"].values()
        if any("anyOf" in p or "oneOf" in p for p in parts(schema))
    }
    assert found <= {"Component", "Matrices"}


def test_every_reference_exists(document: dict[str, Any]) -> None:
    known = {f"#/components/schemas/{name}" for name in document["components"]["schemas"]}
    used = {p["$ref"] for p in parts(document) if "$ref" in p}
    assert used <= known


def fits(value: Any, schema: dict[str, Any], document: dict[str, Any]) -> bool:
    """Return whether a JSON value matches a schema; covers the JSON Schema that the document uses in replies."""
    if "$ref" in schema:
        return fits(value, document["components"]["schemas"][schema["$ref"].rsplit("/", 1)[1]], document)
    if "anyOf" in schema:
        return any(fits(value, s, document) for s in schema["anyOf"])
    if "enum" in schema or "const" in schema:
        return value in schema.get("enum", [schema.get("const")])
    kind = schema.get("type")
    if kind == "object":
        known = schema.get("properties", {})
        return (
            isinstance(value, dict)
            and set(schema.get("required", [])) <= value.keys()
            and (schema.get("additionalProperties", True) is not False or value.keys() <= known.keys())
            and all(fits(v, known[k], document) for k, v in value.items() if k in known)
        )
    if kind == "array":
        return isinstance(value, list) and all(fits(v, schema.get("items", {}), document) for v in value)
    python: dict[str, Any] = {
        "string": str,
        "integer": int,
        "number": (int, float),
        "boolean": bool,
        "null": type(None),
    }
    return kind is None or isinstance(value, python[kind])


def test_replies_match_their_schemas(
    client: Any, station: Any, document: dict[str, Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(previews, "import_limited", import_here)
    uploaded = client.post("/api/v1/board-data/previews?filename=b.kicad_pcb", content=samples.KICAD.encode())
    client.post("/api/v1/station/arm?board_type=demo-board&board_id=B1")
    values = {"run": station.film(board_id="B1"), "camera": 0, "row": 0, "ref": "U1", "k": 0, "name": "demo-board"}
    values |= {"picture": "board", "level": 9, "column": 0, "suffix": "jpg", "region": "full", "size": "240,160"}
    station.teach_reference("demo-board", values["run"])
    station.put_board_type(station.board_type("demo-board"))
    values["revision"] = station.board_type_history.list("demo-board")[0].id
    values["preview"] = uploaded.json()["id"]
    looked_at = 0
    for path, method, operation in operations(document):
        offered = operation["responses"].get("200", {}).get("content", {})
        # The client is one of a service without keys; tests/api/routes/test_keys.py has theirs.
        if method != "get" or "text/event-stream" in offered or operation["tags"] == ["access"]:
            continue
        query = {"after": "r000000"} if path.endswith("/next") else {}
        if "/merged" in path:
            query = {"component": "U1"}
        elif query:
            station.filmed["r000000"] = station.filmed[values["run"]].model_copy(update={"id": "r000000"})
        answer = client.get(path.format(**values), params=query)
        assert answer.status_code == 200, path
        kind = answer.headers["content-type"]
        assert kind.partition(";")[0] in offered, path
        if kind == "application/json":
            assert fits(answer.json(), offered[kind]["schema"], document), path
            looked_at += 1
    assert looked_at >= 10


PIECES = st.one_of(
    st.sampled_from(
        ["r000001", "U1", "2/R1", "demo-board", "0", "1", "-1", "latest", "next", "..", "%2e%2e", "nan", "", "1e9"]
    ),
    st.text(max_size=12),
    st.integers(-5, 10**20).map(str),
)


@settings(deadline=None)
@given(data=st.data())
def test_every_reply_has_a_declared_status(shared_client: Any, data: st.DataObject) -> None:
    """Any path and query parameters: the reply is declared or a problem of the caller, never an internal error."""
    document = shared_client.get("/api/v1/openapi.json").json()
    readable = [(p, o) for p, m, o in operations(document) if m == "get" and "events" not in p]
    path, operation = data.draw(st.sampled_from(readable))
    for name in re.findall(r"{(\w+)}", path):
        piece = data.draw(PIECES).replace("?", "").replace("#", "")
        path = path.replace(f"{{{name}}}", quote(piece))
    names = [p["name"] for p in operation.get("parameters", []) if p["in"] == "query" and p["name"] != "timeout"]
    query = {name: data.draw(PIECES) for name in names if data.draw(st.booleans())}
    if "timeout" in str(operation.get("parameters")):
        query["timeout"] = "0"
    answer = shared_client.get(path, params=query)
    assert answer.status_code < 500
    if answer.status_code >= 400:
        assert answer.headers["content-type"] == "application/problem+json"
