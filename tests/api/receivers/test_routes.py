"""Webhooks over REST, from making one to dead letters; keys, audit and secrets."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from fastapi.testclient import TestClient

from tests.push.event_list import EventList
from tests.push.receiving import Receiver, receiver
from tests.push.test_delivery import until
from vaoi_station.api import create_app
from vaoi_station.api.access.access_control import AccessControl
from vaoi_station.api.access.audit import AuditLog
from vaoi_station.files.access_keys import KeyFile
from vaoi_station.model.receivers import PushConfig
from vaoi_station.push import delivery
from vaoi_station.push.push_service import PushService
from vaoi_station.push.signing import signatures

HOOKS = "/api/v1/webhooks"


class Service:
    """A service with keys and running receivers."""

    def __init__(self, client: TestClient, push: PushService, events: EventList, keys: KeyFile) -> None:
        self.client, self.push, self.events = client, push, events
        self.admin = {"authorization": f"Bearer {keys.create('chief', ['admin']).secret}"}
        self.tester = {"authorization": f"Bearer {keys.create('tester', ['operate', 'teach']).secret}"}

    def ask(self, method: str, path: str, status: int = 200, **more: Any) -> Any:
        answer = self.client.request(method, f"{HOOKS}{path}", headers=self.admin, **more)
        assert answer.status_code == status, answer.text
        return answer.json() if answer.content else None


@pytest.fixture
def service(station: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Service]:
    monkeypatch.setattr(delivery, "READ_S", 0.02)
    audit, keys, events = AuditLog(tmp_path / "audit.jsonl"), KeyFile(tmp_path / "keys.json"), EventList()
    push = PushService(tmp_path, PushConfig(), "line-3", events)
    push.start(lambda _: None)
    app = create_app(station, ["testserver"], AccessControl(keys, audit), push)
    with TestClient(app, client=("192.0.2.7", 5000)) as client:
        yield Service(client, push, events, keys)
    push.stop()
    audit.close()


@pytest.fixture
def target() -> Iterator[Receiver]:
    with receiver() as made:
        yield made


def test_a_webhook_from_its_making_to_its_end(service: Service, target: Receiver) -> None:
    made = service.ask("PUT", "/mes", json={"url": target.url, "events": ["run"]})
    secret = made.pop("secret")
    assert secret.startswith("whsec_")
    assert made == service.ask("GET", "/mes") == service.ask("GET", "")["webhooks"][0]
    assert "secret" not in service.ask("PUT", "/mes", json={"url": target.url, "events": ["run"]})
    service.events.add("run", "a", state="ready", run="r1")
    headers, body = target.next()
    stamp = int(headers["webhook-timestamp"])
    assert headers["webhook-signature"] == signatures([secret], headers["webhook-id"], stamp, body)
    assert service.ask("POST", "/mes/test") == {"delivered": True, "detail": "status 204"}
    assert target.next().document["type"] == "test"
    rotated = service.ask("POST", "/mes/rotate?overlap_s=60")
    assert rotated["secret"] != secret
    assert service.ask("GET", "/mes")["secrets"] == 2
    service.ask("DELETE", "/mes", 204)
    assert service.ask("GET", "/mes", 404)["code"] == "unknown-webhook"
    audited = [
        (entry["key"], entry["method"], entry["path"])
        for entry in service.client.get("/api/v1/audit", headers=service.admin).json()["entries"]
    ]
    assert ("chief", "DELETE", f"{HOOKS}/mes") in audited
    assert ("chief", "POST", f"{HOOKS}/mes/rotate") in audited


def test_of_two_who_change_a_webhook_the_second_learns_that_it_has_changed(service: Service, target: Receiver) -> None:
    def put(tag: str | None, events: list[str]) -> Any:
        headers = service.admin | ({} if tag is None else {"If-Match": tag})
        return service.client.put(f"{HOOKS}/mes", json={"url": target.url, "events": events}, headers=headers)

    read = put(None, ["run"]).headers["etag"]
    service.ask("POST", "/mes/test")  # deliveries change the document, but not what people edit
    assert service.client.get(f"{HOOKS}/mes", headers=service.admin).headers["etag"] == read
    changed = put(read, ["run.ready"]).headers["etag"]
    late = service.client.delete(f"{HOOKS}/mes", headers=service.admin | {"If-Match": read})
    for answer in (put(read, []), late):
        assert (answer.status_code, answer.json()["code"]) == (412, "changed")
    assert service.ask("GET", "/mes")["events"] == ["run.ready"]
    service.client.delete(f"{HOOKS}/mes", headers=service.admin | {"If-Match": changed})
    assert put(changed, []).status_code == 412


def test_dead_letters_are_listed_sent_again_and_dropped(service: Service, target: Receiver) -> None:
    target.status = 500
    service.ask("PUT", "/mes", json={"url": target.url, "retry_after_s": [1]})
    hook = service.push.webhook("mes").delivery
    for text in "ab":
        service.events.add("run", text, state="ready")
    until(lambda: len(hook.state.letters) == 2)
    listed = service.ask("GET", "/mes/dead-letters")
    assert [(e["number"], e["type"], e["fault"]) for e in listed["dead_letters"]] == [
        (number, "run.ready", "The receiver answers with status 500.") for number in (1, 2)
    ]
    assert service.ask("POST", "/mes/dead-letters/1/retry")["delivered"] is False
    target.status = 200
    assert service.ask("POST", "/mes/dead-letters/1/retry") == {"delivered": True, "detail": "status 200"}
    service.ask("DELETE", "/mes/dead-letters/2", 204)
    assert service.ask("GET", "/mes/dead-letters") == {"dead_letters": [], "dropped": 0}
    assert service.ask("POST", "/mes/dead-letters/2/retry", 404)["code"] == "unknown-dead-letter"


def test_a_receiver_that_is_gone_is_enabled_again(service: Service, target: Receiver) -> None:
    target.status = 410
    service.ask("PUT", "/mes", json={"url": target.url})
    service.events.add("run", "a")
    until(lambda: service.ask("GET", "/mes")["state"] == "disabled")
    metrics = service.client.get("/metrics", headers=service.admin).text
    assert 'vaoi_push_up{receiver="mes"} 0' in metrics
    assert 'vaoi_push_failures_total{receiver="mes"} 1' in metrics
    target.status = 204
    assert service.ask("POST", "/mes/enable")["state"] == "delivering"
    until(lambda: service.ask("GET", "/mes")["delivered"] == 1)


def test_only_an_administrator_sees_or_changes_webhooks(service: Service) -> None:
    for method, path in (("GET", ""), ("PUT", "/mes"), ("POST", "/mes/test"), ("GET", "/mes/dead-letters")):
        answer = service.client.request(method, f"{HOOKS}{path}", headers=service.tester, json={"url": "http://mes/"})
        assert (answer.status_code, answer.json()["code"]) == (403, "missing-scope")


@pytest.mark.parametrize(
    "body", [{"url": "file:///etc/passwd"}, {"url": "http://a@b/"}, {"url": 1}, {}, {"url": "http://a/", "secret": "x"}]
)
def test_what_is_no_webhook_is_refused(service: Service, body: Any) -> None:
    assert service.ask("PUT", "/mes", 422, json=body)["errors"]


def test_a_webhook_has_no_rights_of_the_station_s_own_machine(station: Any, tmp_path: Path) -> None:
    """A receiver may be an address of the station itself, where callers on loopback need no key."""
    audit = AuditLog(tmp_path / "audit.jsonl")
    app = create_app(station, ["testserver"], AccessControl(KeyFile(tmp_path / "k"), audit))
    with TestClient(app, client=("127.0.0.1", 5000)) as client:
        assert client.post("/api/v1/station/disarm").status_code == 200
        assert client.post("/api/v1/station/disarm", headers={"webhook-id": "evt_1"}).status_code == 401
    audit.close()
