"""The OpenAPI document equals the golden file, and replies match it."""

from __future__ import annotations

import json
import os
from collections.abc import Iterator
from pathlib import Path
from typing import Any
from unittest.mock import AsyncMock

import pytest

from tests.api.generated_requests import fits
from tests.api.held.setup_files import setup_files
from tests.api.held_station import HeldStation
from tests.api.routes.test_previews import import_here
from tests.board_data.readers import samples
from vaoi_station.api import openapi
from vaoi_station.api.access import PUBLIC, AccessControl
from vaoi_station.api.app import create_app
from vaoi_station.api.audit import AuditLog
from vaoi_station.api.routes import board_data
from vaoi_station.api.routes.doctor import Examination, Examinations
from vaoi_station.files.access_keys import KeyFile

GOLDEN = Path(__file__).parent / "openapi.json"
UNATTENDED = (["access"], ["setup"])
"""Tags of operations that the client here does not have: tests/api/routes/test_keys.py and tests/api/setup do."""


@pytest.fixture(scope="module")
def text(tmp_path_factory: pytest.TempPathFactory) -> Iterator[str]:
    """The document as JSON: it is made once, which takes seconds."""
    folder = tmp_path_factory.mktemp("station")
    audit = AuditLog(folder / "audit.jsonl")
    app = create_app(HeldStation(), (), AccessControl(KeyFile(folder / "k"), audit), files=setup_files(folder))
    yield json.dumps(app.openapi())
    audit.close()


@pytest.fixture
def document(text: str) -> dict[str, Any]:
    document: dict[str, Any] = json.loads(text)
    return document


def operations(document: dict[str, Any]) -> Iterator[tuple[str, str, dict[str, Any]]]:
    for path, methods in document["paths"].items():
        for method, operation in methods.items():
            yield path, method, operation


def test_the_interface_changes_only_on_purpose(document: dict[str, Any]) -> None:
    """After an intended change: run with VAOI_WRITE_GOLDEN=1, and review the difference."""
    document["info"].pop("version")
    if os.environ.get("VAOI_WRITE_GOLDEN"):
        GOLDEN.write_text(json.dumps(document, indent=1, sort_keys=True) + "\n")
    assert document == json.loads(GOLDEN.read_text())


def test_every_address_says_what_it_is_for_what_it_takes_and_what_it_replies(document: dict[str, Any]) -> None:
    """docs/reference/addresses.md is made of it."""
    lacking = []
    for path, method, operation in operations(document):
        body = operation.get("requestBody", {}).get("content", {}).get("application/json", {})
        model = document["components"]["schemas"].get(body.get("schema", {}).get("$ref", "").rsplit("/", 1)[-1], {})
        fields = model.get("properties", {})
        stated = {name for name, field in fields.items() if field.get("description")}
        stated |= {p["name"] for p in operation.get("parameters", ()) if p.get("description")}
        needed = {*fields, *(p["name"] for p in operation.get("parameters", ())), "description"}
        lacking += [(method, path, name) for name in needed - stated - ({"description"} & set(operation))]
        replies = [r for status, r in operation["responses"].items() if status.startswith("2")]
        lacking += [
            (method, path, "example")
            for reply in (body, *(reply.get("content", {}).get("application/json", {}) for reply in replies))
            if reply and "example" not in reply and (reply is not body or model.get("required"))
        ]
    assert lacking == []


def test_answers_may_get_fields_and_requests_may_not(document: dict[str, Any]) -> None:
    closed = {n for n, s in document["components"]["schemas"].items() if s.get("additionalProperties") is False}
    assert closed == {
        "AddressRequest",
        "ArmRequest",
        "CadPoint",
        "CameraTrialRequest",
        "ClampedRequest",
        "CorrectionRequest",
        "DecisionRequest",
        "ExchangeRequest",
        "IdentityReport",
        "ImportOptions",
        "MarksRequest",
        "MethodRequest",
        "OrderChange",
        "OrderRequest",
        "ProgramRequest",
        "Reading",
        "SettingChange",
        "SettingsChange",
        "StateRequest",
        "TeachRequest",
        "TrialRequest",
    }


def test_the_document_is_served_without_a_key_and_made_once(client: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    """Anybody may ask for it, and it takes longer than a second to make."""
    made, completed = list[int](), openapi.completed

    def counted(shown: dict[str, Any]) -> dict[str, Any]:
        made.append(1)
        return completed(shown)

    monkeypatch.setattr(openapi, "completed", counted)
    assert PUBLIC.fullmatch(openapi.URL)
    first = client.get(openapi.URL)
    assert client.get(openapi.URL).content == first.content
    assert client.get(openapi.URL, headers={"If-None-Match": first.headers["ETag"]}).status_code == 304
    assert made == [1]


def test_replies_match_their_schemas(
    client: Any, station: Any, document: dict[str, Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(board_data, "import_limited", import_here)
    examined = Examination(created="now", worst="ok", findings=())
    monkeypatch.setattr(Examinations, "examine", AsyncMock(return_value=examined))
    uploaded = client.post("/api/v1/board-data/previews?filename=b.kicad_pcb", content=samples.KICAD.encode())
    client.post("/api/v1/cameras/0/trial", json={})
    client.post("/api/v1/station/arm?board_type=demo-board&board_id=B1")
    values = {"run": station.film(board_id="B1"), "camera": 0, "row": 0, "ref": "U1", "k": 0, "name": "demo-board"}
    values["board_id"] = "B1"
    values |= {"picture": "board", "level": 9, "column": 0, "suffix": "jpg", "region": "full", "size": "240,160"}
    values |= {"view": 0, "what": "part"}
    station.teach_reference("demo-board", values["run"])
    station.kept.mosaics.keep(values["run"])
    station.put_board_type(station.board_type("demo-board"))
    values["revision"] = station.board_type_history.list("demo-board")[0].id
    values["preview"] = uploaded.json()["id"]
    looked_at = 0
    for path, method, operation in operations(document):
        offered = operation["responses"].get("200", {}).get("content", {})
        if method != "get" or "text/event-stream" in offered or operation["tags"] in UNATTENDED:
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
