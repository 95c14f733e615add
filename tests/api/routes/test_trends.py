"""Trends over REST: typed, filtered, thinned, refused if the span is wrong."""

from __future__ import annotations

from typing import Any


def test_trends_are_filtered_by_type_span_and_figure(client: Any, station: Any) -> None:
    station.kept.trends.fill(20)
    all_boards = client.get("/api/v1/trends").json()
    assert all_boards["boards"] == len(all_boards["times"]) == len(all_boards["runs"]) == 20
    assert [m["kind"] for m in all_boards["marks"]] == ["calibration"]
    middle = all_boards["times"][10]
    some = client.get("/api/v1/trends", params={"since": middle, "figure": ["seam_px", "ready_ms"]}).json()
    assert some["boards"] == 10
    assert [(s["figure"], s["part"]) for s in some["series"]] == [
        ("seam_px", "0-1"),
        ("seam_px", "1-2"),
        ("ready_ms", ""),
    ]
    assert some["series"][0]["upper"] == 0.3
    assert client.get("/api/v1/trends", params={"board_type": "other"}).json()["boards"] == 0
    thinned = client.get("/api/v1/trends", params={"points": 10}).json()
    assert thinned["bin_s"] == 3 * 3600
    assert sum(thinned["counts"]) == 20
    assert len(thinned["times"]) <= 10
    assert "runs" not in thinned
