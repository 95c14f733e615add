"""Every refusal is a problem detail with an action."""

from __future__ import annotations

import logging
import re
from typing import Any

import pytest

from vaoi_station.api.problems import KINDS
from vaoi_station.errors import (
    BusyError,
    DeviceError,
    GoneError,
    InputError,
    InternalError,
    NotFoundError,
    StateError,
    VaoiError,
)

API = "/api/v1"


def problem(answer: Any, status: int, code: str) -> dict[str, Any]:
    """Return the reply's problem after checking the common fields."""
    assert answer.headers["content-type"] == "application/problem+json"
    assert answer.headers["cache-control"] == "no-store"
    content: dict[str, Any] = answer.json()
    assert (answer.status_code, content["status"], content["code"]) == (status, status, code)
    assert content["type"].removeprefix("/problems/") in KINDS
    assert content["type"] == f"/problems/{code}" or code not in KINDS
    assert {"title", "detail", "action", "instance"} <= content.keys()
    assert content["action"].endswith(".")
    return content


PLACES = {"run": "r000001", "camera": 0, "row": 0, "ref": "U1", "k": 0, "name": "demo-board", "picture": "board"}
PLACES |= {"level": 9, "column": 0, "suffix": "jpg", "region": "full", "size": "9,9", "file": "x", "revision": "x"}


def test_allow_names_every_method_of_every_address(untouched_client: Any) -> None:
    """Each method of an address has a route of its own; Starlette would name the methods of the first one."""
    for path, operations in untouched_client.get(f"{API}/openapi.json").json()["paths"].items():
        takes = {method.upper() for method in operations}
        takes |= {"HEAD"} if "GET" in takes and not path.endswith("/events") else set()
        for method in ("GET", "POST", "PUT", "DELETE", "PATCH", "OPTIONS"):
            if method not in takes:
                answer = untouched_client.request(
                    method, re.sub(r"{(\w+)}", lambda m: str(PLACES.get(m[1], "0")), path)
                )
                detail = problem(answer, 405, "wrong-method")["detail"]
                assert answer.headers["allow"] == ", ".join(sorted(takes)), (method, path)
                assert detail.endswith(f"does not take {method}, only {answer.headers['allow']}.")


@pytest.mark.parametrize(
    ("error", "status"),
    [
        (InputError("wrong"), 422),
        (NotFoundError("absent"), 404),
        (GoneError("too late"), 410),
        (StateError("not now"), 409),
        (BusyError("full"), 503),
        (DeviceError("dead"), 503),
        (InternalError("ours"), 500),
        (VaoiError("something", code="internal"), 500),
        (StateError("not now", action="Wait for the board to leave.", code="board-passing"), 409),
    ],
)
def test_every_class_of_error(
    client: Any, station: Any, monkeypatch: pytest.MonkeyPatch, error: VaoiError, status: int
) -> None:
    def refuse() -> None:
        raise error

    monkeypatch.setattr(station, "disarm", refuse)
    content = problem(answer := client.post(f"{API}/station/disarm"), status, error.code)
    assert content["detail"] == error.message
    assert content["action"] == (error.action or KINDS[error.code][2])
    assert ("retry-after" in answer.headers) == (status == 503)


def test_an_unexpected_error_does_not_reveal_details(
    client: Any, station: Any, caplog: pytest.LogCaptureFixture
) -> None:
    station.broken = True
    with caplog.at_level(logging.ERROR):
        content = problem(client.get(f"{API}/station"), 500, "internal")
    assert "secret" not in str(content)
    incident = content["detail"].split()[7]
    assert incident in caplog.text


def test_every_invalid_field_is_named(untouched_client: Any) -> None:
    body = {"name": "x", "components": [{"ref": "U1", "center": [0], "width": -1, "height": 1}], "nonsense": 1}
    content = problem(untouched_client.put(f"{API}/board-types/x", json=body), 422, "invalid-input")
    where = {fault["where"] for fault in content["errors"]}
    assert {"body.components.0.center.1", "body.components.0.width"} <= where
    assert "(given: -1)" in str(content["errors"])
