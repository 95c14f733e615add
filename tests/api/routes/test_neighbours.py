"""REST shows the neighbours in the line, and takes that a board is out."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest
from fastapi.testclient import TestClient

from tests.api.held_station import HeldStation
from tests.hermes.station import PlayedStation, free_port, wait_for
from vaoi_station.api.access import scope_needed
from vaoi_station.api.app import create_app


@pytest.fixture
def played(tmp_path: Path) -> Iterator[PlayedStation]:
    with PlayedStation(tmp_path, listen=f"127.0.0.1:{free_port()}").running() as running:
        yield running


def test_a_station_without_neighbours_says_so() -> None:
    with TestClient(create_app(HeldStation(), ["testserver"])) as client:
        assert client.get("/api/v1/neighbours").json()["role"] == "none"
        assert client.delete("/api/v1/neighbours/boards/x").status_code == 409
        assert client.delete("/api/v1/neighbours/boards/lot%2Fx").status_code == 409
    assert scope_needed("DELETE", "/api/v1/neighbours/boards/lot/x") == "operate"


def test_a_board_that_was_taken_out_is_not_offered_any_more(played: PlayedStation) -> None:
    with TestClient(create_app(HeldStation(), ["testserver"], line=played.service)) as client:
        played.film()
        wait_for(lambda: len(played.service.status().boards) == 1)
        shown = client.get("/api/v1/neighbours").json()
        assert [neighbour["connected"] for neighbour in shown["neighbours"]] == [False]
        (board,) = shown["boards"]
        address = f"/api/v1/neighbours/boards/{board['board_id']}"
        assert client.delete(address).json()["boards"] == []
        assert client.delete(address).status_code == 409
