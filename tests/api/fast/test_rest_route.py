"""Routes of REST match the same requests as FastAPI's own."""

from __future__ import annotations

from typing import Any

import pytest
from fastapi.routing import APIRoute
from starlette.routing import Match

from vaoi_station.api.fast.rest_route import RestRoute, RouteWithoutQuery

PATHS = [
    "/",
    "/healthz",
    "/api/v1/station",
    "/api/v1/station/",
    "/api/v1/runs/r1/components/P1/U1/images/0",
    "/api/v1/runs/r1/mosaics/board_files/9/0_0.jpg",
    "/api/v1/nowhere",
]


@pytest.mark.parametrize("root", ["", "/behind"])
@pytest.mark.parametrize("method", ["GET", "POST"])
@pytest.mark.parametrize("path", PATHS)
def test_a_route_matches_what_one_of_fastapi_matches(untouched_client: Any, path: str, method: str, root: str) -> None:
    scope = {"type": "http", "method": method, "path": root + path, "root_path": root, "query_string": b"x=1"}
    routes = [route for route in untouched_client.app.routes if isinstance(route, RestRoute)]
    assert len(routes) > 50
    for route in routes:
        without = isinstance(route, RouteWithoutQuery)  # it declines each request with a query
        expected = (Match.NONE, {}) if without else APIRoute.matches(route, dict(scope))
        assert route.matches(dict(scope)) == expected, route.path
