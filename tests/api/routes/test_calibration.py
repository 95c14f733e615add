"""GET calibration, and the warning of the station."""

from __future__ import annotations

from typing import Any


def test_a_drift_is_reported_per_camera(client: Any) -> None:
    answer = client.get("/api/v1/calibration")
    assert answer.status_code == 200
    assert answer.headers["Cache-Control"] == "no-store"
    found = answer.json()
    assert (found["digest"], found["runs"]) == ("c0ffee", 2)
    assert [c["state"] for c in found["cameras"]] == ["steady", "drifted", "steady"]
    assert "drift" not in found["cameras"][0]
    drift = found["cameras"][1]["drift"]
    assert (drift["y_px"], drift["since_run"], drift["runs"]) == (9.4, "r000001", 2)
    assert found["cameras"][1]["history"][0]["links"] == 80


def test_a_drift_is_a_warning_and_not_a_fault(client: Any, station: Any) -> None:
    assert client.get("/api/v1/station").json()["warnings"] == []
    station.drift()
    found = client.get("/api/v1/station").json()
    assert [w["code"] for w in found["warnings"]] == ["calibration-drift"]
    assert found["reasons"] == []
    assert client.get("/healthz").status_code == 200
