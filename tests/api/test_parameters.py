"""Limits of path and query parameters."""

from __future__ import annotations

import re
from typing import Any

import pytest
from fastapi.testclient import TestClient
from pydantic import TypeAdapter, ValidationError

from vaoi_station.api import parameters as p


def accepts(parameter: Any, value: Any) -> bool:
    try:
        TypeAdapter(parameter).validate_python(value)
    except ValidationError:
        return False
    return True


@pytest.mark.parametrize(
    ("value", "expected"),
    [
        ("demo board", True),
        ("größer & <b>", True),
        ("a" * 80, True),
        ("a" * 81, False),
        (".hidden", False),
        ("a/b", False),
        ("a\\b", False),
        ("a\nb", False),
        ("", False),
    ],
)
def test_names_of_board_types_cannot_leave_their_directory(value: str, expected: bool) -> None:
    assert accepts(p.BoardTypeName, value) is expected


@pytest.mark.parametrize(
    ("method", "address", "offer"),
    [
        ("GET", "/api/v1/runs?verdicts=degraded", "it has before, board_id, board_type, figures, limit"),
        ("GET", "/api/v1/runs?limit=2&Limit=3", "it has before, board_id, board_type, figures, limit"),
        ("GET", "/api/v1/station?nonsense=", "it has none"),
        (
            "POST",
            "/api/v1/station/arm?type=demo-board",
            "it has allow_lost_cameras, board_id, board_type, job_id, orders, passing, runs",
        ),
        ("GET", "/healthz?full=1", "it has none"),
    ],
)
def test_unknown_query_parameters_are_refused(
    untouched_client: TestClient, method: str, address: str, offer: str
) -> None:
    refused = untouched_client.request(method, address)
    assert (refused.status_code, refused.json()["code"]) == (422, "unknown-parameter")
    assert offer in refused.json()["detail"]
    assert untouched_client.get("/api/v1/runs?limit=2&_=1").status_code == 200


def test_each_operation_offers_the_query_parameters_of_the_document(untouched_client: TestClient) -> None:
    for path, operations in untouched_client.get("/api/v1/openapi.json").json()["paths"].items():
        for method, operation in operations.items():
            names = sorted(p["name"] for p in operation.get("parameters", ()) if p["in"] == "query")
            address = re.sub(r"\{\w+\}", "1", path)
            refused = untouched_client.request(method, f"{address}?no_such_parameter=1").json()
            assert refused["code"] == "unknown-parameter", (method, path)
            assert refused["detail"].endswith(f"it has {', '.join(names)}." if names else "it has none."), path
