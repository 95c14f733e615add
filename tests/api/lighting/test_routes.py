"""The check of a light program over REST."""

from __future__ import annotations

from typing import Any

PATH = "/api/v1/board-types/demo-board/program/check"


def test_a_program_is_checked_and_nothing_is_changed(client: Any, station: Any) -> None:
    before = station.types["demo-board"]
    answer = client.post(PATH, json={"program": [{"light": "left", "on_us": 900.0}]})
    assert answer.status_code == 200
    assert answer.headers["Cache-Control"] == "no-store"
    content = answer.json()
    assert (content["usable"], content["origin"]) == (False, "request")
    assert content["faults"][0]["message"].endswith(
        "must be 50 … 500 (the longest pulse of channel 2 in its firmware)."
    )
    assert station.types["demo-board"] is before
    assert client.post(PATH, json={}).json()["origin"] == "cameras"


def test_what_is_no_program_is_refused(client: Any) -> None:
    assert client.post(PATH, json={"program": [{"light": "left", "on_us": -1.0}]}).status_code == 422
    assert client.post(PATH, json={"program": [{"light": "left"}] * 65}).status_code == 422
    assert client.post(PATH.replace("demo-board", "other"), json={}).status_code == 404
