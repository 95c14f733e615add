"""The station over REST: its state, orders, and its calibration."""

from __future__ import annotations

from typing import Any

import pytest

from vaoi_station.model import Reason
from vaoi_station.runs.states.tables import StationState

STATION = "/api/v1/station"


@pytest.mark.parametrize("by", ["body", "query", "both"])
def test_arming_by_body_or_by_query(client: Any, by: str) -> None:
    order = {"board_type": "demo-board", "board_id": "B1", "job_id": "J1", "runs": 2}
    asked: dict[str, Any] = {"json": order} if by != "query" else {}
    if by != "body":
        asked["params"] = order
    content = client.post(f"{STATION}/arm", **asked).json()
    assert content["state"] == "armed"
    assert content["armed_with"] == {
        "board_type": "demo-board", "board_id": "B1", "job_id": "J1", "runs_left": 2, "method": "auto",
        "board_id_certain": True, "resumed": False,
    }  # fmt: skip


@pytest.mark.parametrize(
    ("wrong", "says"),
    [
        ({"board_id": ""}, "board_id: String should have at least 1 character"),
        ({"job_id": ""}, "job_id: String should have at least 1 character"),
        ({"board_id": "ab\0c"}, "must have no control characters but the separators of ISO/IEC 15434 (given: "),
        ({"job_id": "\n"}, "job_id: must have no control characters (given: "),
    ],
)
def test_empty_ids_and_control_characters_are_refused(
    client: Any, station: Any, wrong: dict[str, str], says: str
) -> None:
    order = {"board_type": "demo-board", **wrong}
    for refused in (client.post(f"{STATION}/arm", json=order), client.post(f"{STATION}/arm", params=order)):
        assert (refused.status_code, refused.json()["code"]) == (422, "invalid-input")
        assert says in refused.json()["detail"]
    assert station.armed is None


@pytest.mark.parametrize("by", ["body", "query"])
def test_arming_without_a_camera_needs_permission(client: Any, station: Any, by: str) -> None:
    station.lose(1)
    assert client.get(STATION).json()["all_cameras_ready"] is False
    refusal = client.post(f"{STATION}/arm?board_type=demo-board")
    assert (refusal.status_code, refusal.json()["code"]) == (503, "camera-lost")
    assert station.armed is None
    asked = {"json" if by == "body" else "params": {"board_type": "demo-board", "allow_lost_cameras": True}}
    assert client.post(f"{STATION}/arm", **asked).json()["state"] == "armed"


@pytest.mark.parametrize(
    ("state", "code", "status", "ready"),
    [
        ("idle", "", "ok", 200),
        ("idle", "no-calibration", "degraded", 503),
        ("armed", "calibration-drift", "ok", 200),
        ("armed", "storage-full", "degraded", 503),
        ("armed", "workers-starting", "degraded", 503),
        ("armed", "camera-lost", "degraded", 503),
        ("blocked", "", "degraded", 503),
        ("faulted", "", "degraded", 503),
    ],
)
def test_readiness_is_about_the_next_board(
    client: Any, station: Any, monkeypatch: pytest.MonkeyPatch, state: str, code: str, status: str, ready: int
) -> None:
    station.state = StationState(state)
    snapshot = station.snapshot()
    warnings = (Reason(code=code, message="x"),) if code else ()
    monkeypatch.setattr(station, "snapshot", lambda: snapshot.model_copy(update={"warnings": warnings, "reasons": ()}))
    answer = client.get("/readyz")
    assert (answer.status_code, answer.json()["status"]) == (ready, status)
    assert answer.json().get("codes", []) == [reason.code for reason in warnings]
    assert client.get("/healthz").status_code == (503 if state == "faulted" else 200)


def test_a_database_that_was_set_aside_is_acknowledged(client: Any, station: Any) -> None:
    name = "station.db.damaged-20260101T000000Z"
    station.storage.files[name] = False
    listed = {"file": name, "code": "database-damaged", "acknowledged": False}
    assert client.get(STATION).json()["set_aside"] == [listed]
    answer = client.post(f"{STATION}/set-aside/{name}/acknowledge")
    assert (answer.status_code, answer.json()["set_aside"]) == (200, [listed | {"acknowledged": True}])
    unknown = client.post(f"{STATION}/set-aside/station.db/acknowledge")
    assert (unknown.status_code, unknown.json()["code"]) == (404, "not-set-aside")


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
