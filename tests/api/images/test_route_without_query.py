"""The route of requests without a query answers as the one that it spares, and takes no other request."""

from __future__ import annotations

from typing import Any

import pytest
from fastapi import FastAPI
from fastapi.testclient import TestClient

from tests.api.held.pictures import RUNS
from vaoi_station.api.images.route_without_query import RouteWithoutQuery

SAME = "_=1"
"""A query that asks for nothing, so that the other route answers."""


@pytest.mark.parametrize(
    ("method", "path", "headers", "status"),
    [
        ("GET", "components/U1/images/0", {}, 200),
        ("HEAD", "components/2/R1/images/0", {}, 200),
        ("GET", "components/U1/images/0", {"Accept": "image/jpeg"}, 200),
        ("GET", "components/U1/images/0", {"Accept": "text/html"}, 406),
        ("GET", "components/U1/images/0", {"If-None-Match": "*"}, 304),
        ("GET", "components/U1/images/99", {}, 404),
        ("GET", "components/U9/images/0", {}, 404),
        ("GET", "components/U1/images/-1", {}, 422),
        ("GET", f"components/{'U' * 201}/images/0", {}, 422),
        ("DELETE", "components/U1/images/0", {}, 405),
    ],
)
def test_a_picture_without_a_query_is_that_of_the_defaults(
    client: Any, station: Any, method: str, path: str, headers: dict[str, str], status: int
) -> None:
    address = f"{RUNS}/{station.film()}/{path}"
    plain, asked = (client.request(method, f"{address}{query}", headers=headers) for query in ("", f"?{SAME}"))
    assert plain.status_code == status
    assert (plain.status_code, plain.content, dict(plain.headers)) == (
        asked.status_code,
        asked.content,
        dict(asked.headers),
    )


def test_only_requests_without_a_query_take_the_route() -> None:
    app = FastAPI()

    async def plain() -> str:
        return "without"

    async def full() -> str:
        return "with"

    app.router.add_api_route("/here", plain, route_class_override=RouteWithoutQuery)
    app.router.add_api_route("/here", full)
    client = TestClient(app)
    assert [client.get(f"/here{query}").json() for query in ("", "?", "?a=1", "?a")] == [
        *("without", "without"),
        *("with", "with"),
    ]
