"""Limits of path and query parameters."""

from __future__ import annotations

import re
from typing import Any

import pytest
from fastapi import FastAPI
from fastapi.testclient import TestClient
from pydantic import TypeAdapter, ValidationError

from vaoi_station.api import parameters as p
from vaoi_station.api import problems
from vaoi_station.errors import InputError


def accepts(parameter: Any, value: Any) -> bool:
    try:
        TypeAdapter(parameter).validate_python(value)
    except ValidationError:
        return False
    return True


@pytest.mark.parametrize(
    ("value", "expected"),
    [
        ("r000001", True),
        ("01m7-x", True),
        ("a" * 64, True),
        ("a" * 65, False),
        ("", False),
        (".x", False),
        ("a/b", False),
    ],
)
def test_run_ids(value: str, expected: bool) -> None:
    assert accepts(p.RunId, value) is expected


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
    ("parameter", "lowest", "highest", "refused"),
    [
        (p.Camera, 0, 9999, [-1, 10_000]),
        (p.Row, 0, 99_999, [-1, 100_000]),
        (p.PxPerMm, 0.5, 500.0, [0.4, 501.0, float("nan"), float("inf")]),
        (p.MinCoverage, 1e-9, 1.0, [0.0, 1.1, float("nan")]),
        (p.TimeoutS, 0.0, 60.0, [-0.1, 60.1, float("inf")]),
    ],
)
def test_numbers_are_limited(parameter: Any, lowest: float, highest: float, refused: list[float]) -> None:
    assert accepts(parameter, lowest)
    assert accepts(parameter, highest)
    assert not any(accepts(parameter, value) for value in refused)


@pytest.mark.parametrize(
    ("method", "address", "offer"),
    [
        ("GET", "/api/v1/runs?verdicts=degraded", "it has before, board_id, board_type, figures, limit"),
        ("GET", "/api/v1/runs?limit=2&Limit=3", "it has before, board_id, board_type, figures, limit"),
        ("GET", "/api/v1/station?nonsense=", "it has none"),
        (
            "POST",
            "/api/v1/station/arm?type=demo-board",
            "it has allow_lost_cameras, board_id, board_type, job_id, passing, runs",
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


@pytest.mark.parametrize(
    ("method", "address", "name"),
    [
        ("POST", "/api/v1/station/arm?board_type=nope&board_type=demo-board", "board_type"),
        ("GET", "/api/v1/runs?verdict=ok&verdict=failed", "verdict"),
        ("GET", "/api/v1/runs?limit=2&limit=2&_=1", "limit"),
        ("GET", "/api/v1/runs/1/components/U1?px_per_mm=10&light=left&px_per_mm=20", "px_per_mm"),
    ],
)
def test_a_parameter_that_is_given_twice_is_refused(
    untouched_client: TestClient, method: str, address: str, name: str
) -> None:
    """Only the last one would count, and the caller would not learn which."""
    refused = untouched_client.request(method, address)
    assert (refused.status_code, refused.json()["code"]) == (422, "repeated-parameter")
    assert f"{name!r} is given 2 times" in refused.json()["detail"]
    assert untouched_client.get("/api/v1/station").json()["state"] == "idle"


def test_parameters_of_several_values_may_be_repeated(untouched_client: TestClient) -> None:
    assert untouched_client.get("/api/v1/runs?limit=2&_=1&_=2").status_code == 200
    assert untouched_client.get("/api/v1/trends?figure=seam_px&figure=sigma_px").status_code == 200


def test_each_operation_offers_the_query_parameters_of_the_document(untouched_client: TestClient) -> None:
    for path, operations in untouched_client.get("/api/v1/openapi.json").json()["paths"].items():
        for method, operation in operations.items():
            names = sorted(p["name"] for p in operation.get("parameters", ()) if p["in"] == "query")
            address = re.sub(r"\{\w+\}", "1", path)
            refused = untouched_client.request(method, f"{address}?no_such_parameter=1").json()
            assert refused["code"] == "unknown-parameter", (method, path)
            assert refused["detail"].endswith(f"it has {', '.join(names)}." if names else "it has none."), path


@pytest.mark.parametrize("text", ["1,2,3", "1,2,3,4,5", "1,2,x,3", ""])
def test_a_box_is_four_numbers(text: str) -> None:
    assert p.parse_box("within", "1,2.5,-3,4") == (1.0, 2.5, -3.0, 4.0)
    assert p.parse_box("within", None) is None
    with pytest.raises(InputError, match=r"within is .*must be four numbers x0,y0,x1,y1"):
        p.parse_box("within", text)


def test_routes_have_their_address_their_checks_and_a_stable_name() -> None:
    routes = p.rest_router("/boards", ["boards"])

    @routes.get("/{board}")
    async def get_board(board: str) -> str:
        return board

    app = FastAPI()
    problems.install(app)
    app.router.routes.extend(routes.routes)
    client = TestClient(app)
    assert client.get("/api/v1/boards/b-1").json() == "b-1"
    assert client.get("/api/v1/boards/b-1?colour=red").status_code == 422
    operation = app.openapi()["paths"]["/api/v1/boards/{board}"]["get"]
    assert (operation["operationId"], operation["tags"]) == ("get_board", ["boards"])
