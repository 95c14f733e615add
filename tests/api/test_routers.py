"""Routes that an application takes over as they are."""

from __future__ import annotations

from fastapi import FastAPI
from fastapi.testclient import TestClient

from vaoi_station.api import problems
from vaoi_station.api.routers import rest_router


def test_routes_have_their_address_their_checks_and_a_stable_name() -> None:
    routes = rest_router("/boards", ["boards"])

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
