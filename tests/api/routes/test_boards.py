"""A board by its id, over REST and in Python, of one station and of two."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import pytest

import vaoi_station as vaoi
from tests.api.conftest import Served
from tests.api.held.setup_files import setup_files
from tests.api.held_station import HeldStation
from tests.hermes.station import free_port

BOARDS = "/api/v1/boards"


def turned_over() -> HeldStation:
    """Return a station that films the bottom."""
    station = HeldStation()
    station.types["demo-board"] = station.types["demo-board"].model_copy(update={"side": "bottom"})
    return station


def test_one_side_is_not_the_whole_board(client: Any, station: Any) -> None:
    run = station.film(board_id="SN/1")
    found = client.get(f"{BOARDS}/SN%2F1").json()
    assert (found["status"], [r["code"] for r in found["reasons"]]) == ("degraded", ["side-missing"])
    assert client.get(found["top"]["address"]).json()["id"] == run
    assert found["top"]["components"] == 3
    refused = client.get(f"{BOARDS}/SN-2")
    assert (refused.status_code, refused.json()["code"]) == (404, "unknown-board")
    assert client.get(f"{BOARDS}/SN-1?within=0").status_code == 422


def test_a_side_that_is_being_stitched_or_ordered_is_said_to_come(client: Any, station: Any) -> None:
    station.types["lower"] = station.types["demo-board"].model_copy(update={"name": "lower", "side": "bottom"})
    order = {"board_type": "lower", "board_id": "SN-1", "flip": "x"}
    assert client.post("/api/v1/orders", json=order).json()["flip"] == "x"
    found = client.get(f"{BOARDS}/SN-1").json()
    assert ([r["code"] for r in found["reasons"]], found["coming"]) == (["side-missing", "side-coming"], ["bottom"])
    station.film(board_id="SN-1", finish=False)
    assert client.get(f"{BOARDS}/SN-1").json()["coming"] == ["top", "bottom"]


def test_an_older_side_is_found_behind_many_runs_and_a_search_that_ends_early_says_so(
    client: Any, station: Any
) -> None:
    station.types["lower"] = station.types["demo-board"].model_copy(update={"name": "lower", "side": "bottom"})
    bottom = station.film(board_id="SN-1", board_type="lower")
    for _ in range(21):
        station.film(board_id="SN-1")
    found = client.get(f"{BOARDS}/SN-1").json()
    assert found["bottom"]["run"] == bottom
    assert len(found["others"]) == 9
    station.film(board_id="SN-2")
    for _ in range(8):
        station.film()
    station.kept.history.most_scanned = 4
    assert client.get(f"{BOARDS}/SN-2").json()["top"]
    station.kept.history.most_scanned = 1
    assert "among the newest" in client.get(f"{BOARDS}/SN-2").json()["detail"]


def test_parts_of_a_side_are_listed_if_asked_for(client: Any, station: Any) -> None:
    station.film(board_id="SN-1")
    assert client.get(f"{BOARDS}/SN-1").json()["top"].get("parts") is None
    parts = client.get(f"{BOARDS}/SN-1?parts=true").json()["top"]["parts"]
    assert (parts["address"], parts["x_mm"]) == (["U1", "R1", "2/R1"], [20.0, 30.0, 50.0])


def test_two_stations_show_one_board() -> None:
    upper, lower = HeldStation(), turned_over()
    for station in (upper, lower):
        station.film(board_id="SN-1")
    first, second = Served(upper), Served(lower)
    try:
        found = vaoi.connect(first.url).board("SN-1", vaoi.connect(second.url))
        with pytest.raises(vaoi.NotFoundError):
            vaoi.connect(first.url).board("SN-9", vaoi.connect(second.url))
    finally:
        first.stop()
        second.stop()
    assert found.top is not None
    assert found.bottom is not None
    assert found.bottom.address.startswith(second.url)
    assert found.bottom.parts is not None
    # The held stations share their parts, which no real board does.
    assert "sides-differ" in (codes := [reason.code for reason in found.reasons])
    assert not {"side-missing", "side-coming", "side-seen-twice"} & set(codes)


def test_two_stations_that_film_the_same_side_are_told_so() -> None:
    first, second = Served(HeldStation()), Served(HeldStation())
    try:
        for served in (first, second):
            served.station.film(board_id="SN-1")
        found = vaoi.connect(first.url).board("SN-1", vaoi.connect(second.url))
    finally:
        first.stop()
        second.stop()
    assert [reason.code for reason in found.reasons] == ["sides-same"]


def beside(other: str, folder: Path, station: HeldStation, port: int = 0) -> Served:
    """Serve a station whose station.toml names the one of the other side."""
    folder.mkdir(exist_ok=True)
    files = setup_files(folder)
    api = files.config.api.model_copy(update={"other_station": other})
    files.config = files.config.model_copy(update={"api": api})
    return Served(station, port, files=files)


def test_a_station_tells_the_side_that_another_one_films_and_says_if_that_is_silent(tmp_path: Path) -> None:
    second = Served(turned_over())
    first = beside(second.url, tmp_path, HeldStation())
    try:
        for served in (first, second):
            served.station.film(board_id="SN-1")
        found = first.client.get(f"{BOARDS}/SN-1?parts=true").json()
        assert found["bottom"]["address"] == f"{second.url}/api/v1/runs/r000001"
        assert found["bottom"]["parts"]["address"] == found["top"]["parts"]["address"]
        assert first.client.get(f"{BOARDS}/SN-1?alone=true").json()["reasons"][0]["code"] == "side-missing"
        second.station.film(board_id="SN-2")
        assert first.client.get(f"{BOARDS}/SN-2").json()["reasons"][0]["code"] == "side-missing"
        assert first.client.get(f"{BOARDS}/SN-9").json()["code"] == "unknown-board"
        second.stop()
        silent = first.client.get(f"{BOARDS}/SN-1").json()
        assert [reason["code"] for reason in silent["reasons"]] == ["side-missing", "other-station-silent"]
        assert second.url in silent["reasons"][1]["message"]
        assert vaoi.connect(first.url).board("SN-1").reasons[1].code == "other-station-silent"
    finally:
        first.stop()


def test_stations_that_name_each_other_do_not_wait_for_each_other(tmp_path: Path) -> None:
    port = free_port()
    first = beside(f"http://127.0.0.1:{port}", tmp_path / "first", HeldStation())
    second = beside(first.url, tmp_path / "second", turned_over(), port)
    try:
        for served in (first, second):
            served.station.film(board_id="SN-1")
        with ThreadPoolExecutor(8) as pool:
            asked = [pool.submit(served.client.get, f"{BOARDS}/SN-1") for served in (first, second) for _ in range(4)]
            replies = [one.result().json() for one in asked]
    finally:
        first.stop()
        second.stop()
    assert all({"top", "bottom"} <= set(reply) for reply in replies)
    assert "other-station-silent" not in str(replies)
