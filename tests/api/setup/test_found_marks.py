"""Marks of a calibration board in one frame, over REST."""

from __future__ import annotations

from typing import Any

import pytest

from tests.api.held.setup_files import film_board
from tests.api.held_station import HeldStation
from vaoi_station.files.layouts import Layout

MARKS = "/api/v1/calibration/marks"


@pytest.fixture
def wanted(client: Any, station: HeldStation) -> dict[str, Any]:
    layout = client.get("/api/v1/calibration/layout", params={"tolerance_mm": 1.5}).json()
    return {"run": film_board(station, Layout.model_validate(layout)), "row": 0, "camera": 1, "layout": layout}


def test_marks_are_found_where_they_are(client: Any, wanted: dict[str, Any]) -> None:
    found = client.post(MARKS, json=wanted).json()
    assert (found["width"], found["height"]) == (320, 240)
    assert len(found["found"]) == 20
    assert found["expected"] == 12, "those that are 2 mm further inside"
    elsewhere = client.post(MARKS, json={**wanted, "row": 1}).json()
    assert (elsewhere["expected"], elsewhere["found"]) == (12, [])


@pytest.mark.parametrize(
    ("change", "status", "detail"),
    [
        ({"camera": 3}, 422, "camera"),
        ({"row": 99}, 404, "never arrived"),
        ({"run": "r9"}, 404, "r9"),
        ({"px_per_mm": -1}, 422, "px_per_mm"),
    ],
)
def test_what_cannot_be_searched_is_refused(
    client: Any, wanted: dict[str, Any], change: dict[str, Any], status: int, detail: str
) -> None:
    refusal = client.post(MARKS, json={**wanted, **change})
    assert refusal.status_code == status
    assert detail in refusal.text


def test_marks_are_found_in_the_newest_frame_of_a_trial(
    client: Any, station: HeldStation, wanted: dict[str, Any]
) -> None:
    """While the board is being laid, before it has passed."""
    run = wanted.pop("run")
    del wanted["row"]
    missing = client.post(MARKS, json={**wanted, "trial": 1})
    assert (missing.status_code, missing.json()["code"]) == (404, "no-trial-frame")
    held: Any = station.lighting
    held.below = lambda camera: station.pixels[run, camera, 0]
    for number in (1, 2):
        assert client.post("/api/v1/cameras/1/trial", json={}).json()["number"] == number
        assert len(client.post(MARKS, json={**wanted, "trial": number}).json()["found"]) == 20
    assert client.post(MARKS, json={**wanted, "trial": 1}).status_code == 404, "a later pulse was fired"
    assert client.post(MARKS, json={**wanted, "camera": 0, "trial": 2}).status_code == 404


@pytest.mark.parametrize("place", [{}, {"run": "r000001"}, {"row": 0}, {"run": "r000001", "row": 0, "trial": 1}])
def test_a_frame_is_named_in_one_way(client: Any, wanted: dict[str, Any], place: dict[str, Any]) -> None:
    unplaced = {"camera": wanted["camera"], "layout": wanted["layout"]}
    refusal = client.post(MARKS, json={**unplaced, **place})
    assert refusal.status_code == 422
    assert "either run and row, or trial" in refusal.text


@pytest.mark.parametrize("size", [0.1, 100.0])
def test_marks_too_small_or_too_large_for_the_frame_are_refused(
    client: Any, wanted: dict[str, Any], size: float
) -> None:
    mark = {**wanted["layout"]["mark"], "size": size, "width": size / 4}
    refusal = client.post(MARKS, json={**wanted, "layout": {**wanted["layout"], "mark": mark}})
    assert refusal.status_code == 422
    assert "mark" in refusal.json()["detail"]
