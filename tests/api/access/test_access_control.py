"""Who may do what: by key, by login, from loopback, through a proxy. Every command is in the audit log."""

from __future__ import annotations

from typing import Any

import pytest

from tests.api.conftest import Served
from vaoi_station.api.access.access_control import AccessControl
from vaoi_station.api.access.audit import AuditLog
from vaoi_station.files.access_keys import KeyFile

ARM = "/api/v1/station/arm?board_type=demo-board"
OUTSIDE, INSIDE = "192.0.2.7", "127.0.0.1"


def test_from_outside_nothing_works_without_a_key_but_page_and_health(call_from: Any, station: Any) -> None:
    client = call_from(OUTSIDE)
    assert client.get("/").status_code == client.get("/healthz").status_code == 200
    for answer in (client.get("/api/v1/station"), client.post(ARM), client.get("/metrics")):
        assert (answer.status_code, answer.json()["code"]) == (401, "no-key")
        assert answer.headers["www-authenticate"].startswith("Bearer")
    assert station.armed is None


def test_a_key_permits_its_scopes_only(call_from: Any, keys: KeyFile) -> None:
    operator = call_from(OUTSIDE, keys.create("operator", ["operate"]).secret)
    assert operator.get("/api/v1/station").status_code == 200
    assert operator.post(ARM).status_code == 200
    for refused in (operator.delete("/api/v1/board-types/demo-board"), operator.get("/api/v1/keys")):
        assert (refused.status_code, refused.json()["code"]) == (403, "missing-scope")


def test_the_refusal_of_a_wrong_address_does_not_ask_for_a_key_alone(call_from: Any, keys: KeyFile) -> None:
    # What a program sends whose id of the run is empty.
    operator = call_from(OUTSIDE, keys.create("operator", ["operate"]).secret)
    assert operator.put("/api/v1/runs//hold").json()["action"].startswith("Check the address, or use a key ")
    taught = operator.put("/api/v1/board-types/demo-board/method").json()
    assert (taught["code"], "address" in taught["action"]) == ("missing-scope", False)


def test_a_revoked_key_is_refused_at_once(call_from: Any, keys: KeyFile) -> None:
    client = call_from(OUTSIDE, keys.create("operator", ["operate"]).secret)
    assert client.post(ARM).status_code == 200
    keys.revoke("operator")
    assert client.post(ARM).status_code == 401


@pytest.mark.parametrize("address", [INSIDE, "::1", "::ffff:127.0.0.1"])
def test_loopback_is_open_for_all_but_keys(call_from: Any, address: str) -> None:
    client = call_from(address)
    assert client.post(ARM).status_code == 200
    assert client.get("/api/v1/keys").status_code == 403


def test_a_wrong_key_is_refused_from_loopback_too(call_from: Any) -> None:
    assert call_from(INSIDE, "vaoi_000000000000_wrong").get("/api/v1/station").status_code == 401


def test_loopback_can_be_closed(call_from: Any) -> None:
    assert call_from(INSIDE, open_loopback=False).get("/api/v1/station").status_code == 401


@pytest.mark.parametrize("header", ["X-Forwarded-For", "Forwarded", "Via", "X-Real-IP"])
def test_a_request_that_a_proxy_passed_on_is_not_from_loopback(call_from: Any, header: str) -> None:
    assert call_from(INSIDE).get("/api/v1/station", headers={header: "127.0.0.1"}).status_code == 401


def test_commands_and_refusals_are_in_the_audit_log_with_the_name_of_the_key(
    call_from: Any, keys: KeyFile, audit: AuditLog
) -> None:
    made = keys.create("operator", ["operate"])
    call_from(OUTSIDE, made.secret).post(ARM)
    call_from(OUTSIDE, made.secret).get("/api/v1/station")
    call_from(OUTSIDE).post(ARM)
    call_from(INSIDE).post("/api/v1/station/disarm")
    entries = [(e["key"], e["address"], e["path"], e["status"]) for e in audit.newest(10)]
    assert entries == [
        ("loopback", INSIDE, "/api/v1/station/disarm", 200),
        ("none", OUTSIDE, "/api/v1/station/arm", 401),
        ("operator", OUTSIDE, "/api/v1/station/arm", 200),
    ]
    assert made.secret not in audit.path.read_text()


def test_refusals_without_end_do_not_fill_the_audit_log(call_from: Any, audit: AuditLog) -> None:
    client = call_from(OUTSIDE)
    for _ in range(200):
        client.get("/api/v1/station")
    assert len(audit.newest(1000)) <= 120


def test_an_open_event_stream_ends_when_its_key_is_revoked(keys: KeyFile, audit: AuditLog, station: Any) -> None:
    access = AccessControl(keys, audit, open_loopback=False)
    served = Served(station, access=access)
    try:
        key = {"authorization": f"Bearer {keys.create('reader', ['read']).secret}"}
        with served.client.stream("GET", "/api/v1/events", headers=key) as events:
            lines = events.iter_lines()
            assert next(lines).startswith("event: heartbeat")
            keys.rotate("reader")
            station.publish("station", "something that the old key must not see")
            assert not [line for line in lines if "must not see" in line]
    finally:
        served.stop()
