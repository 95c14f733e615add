"""All receivers of a station: those of station.toml and of REST, over restarts, while the line is not delayed."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from tests.push.event_list import EventList
from tests.push.receiving import Receiver
from tests.push.test_delivery import WAIT_S, until
from vaoi_station.errors import NotFoundError, StateError
from vaoi_station.model.receivers import MOST_WEBHOOKS, PushConfig, WebhookConfig, WebhookSettings
from vaoi_station.push.delivery_state import read_state
from vaoi_station.push.push_service import PushService
from vaoi_station.push.signing import new_secret, signatures
from vaoi_station.supervised_thread import SupervisedThread


class Fixture:
    """A data directory, and the services that run over it."""

    def __init__(self, data: Path, events: EventList) -> None:
        self.data, self.events = data, events
        self.watched: list[SupervisedThread] = []
        self._running: list[PushService] = []

    def start(self, **tables: Any) -> PushService:
        made = PushService(self.data, PushConfig(**tables), "line-3", self.events)
        made.start(self.watched.append)
        self._running.append(made)
        return made

    def stop(self) -> None:
        while self._running:
            self._running.pop().stop()


@pytest.fixture
def station(tmp_path: Path, events: EventList) -> Iterator[Fixture]:
    made = Fixture(tmp_path, events)
    yield made
    made.stop()


def settings(url: str, **more: Any) -> WebhookSettings:
    return WebhookSettings(url=url, **more)


def test_a_webhook_that_is_made_while_the_station_runs_gets_its_events_also_after_a_restart(
    station: Fixture, target: Receiver
) -> None:
    push = station.start()
    station.events.add("run", "too early")
    secret = push.put("mes", settings(target.url, events=("run",)))
    assert secret is not None
    station.events.add("run", "a", state="ready")
    headers, body = target.next()
    assert headers["webhook-signature"] == signatures(
        [secret], headers["webhook-id"], int(headers["webhook-timestamp"]), body
    )
    assert [thread.name for thread in station.watched] == ["push mes"]
    station.stop()
    station.events.add("run", "b")
    again = station.start()
    assert target.next().document["data"]["message"] == "b"
    assert again.webhook("mes").secrets == 1
    assert again.put("mes", settings(target.url)) is None, "a change makes no secret"


def test_a_webhook_of_the_file_signs_with_each_secret_of_its_file(
    station: Fixture, target: Receiver, tmp_path: Path
) -> None:
    path, keys = tmp_path / "mes.secret", [new_secret(), new_secret()]
    path.write_text("\n".join(keys))
    push = station.start(webhooks=(WebhookConfig(name="mes", url=target.url, secret_file=path),))
    station.events.add("run", "a")
    assert len(target.next().headers["webhook-signature"].split(" ")) == 2
    path.write_text(keys[1])  # the old one is taken out while the station runs
    station.events.add("run", "b")
    assert len(target.next().headers["webhook-signature"].split(" ")) == 1
    assert [(w.name, w.from_file, w.settings.url) for w in push.webhooks()] == [("mes", True, target.url)]
    fixed = r"is one of station\.toml"
    with pytest.raises(StateError, match=fixed):
        push.put("mes", settings(target.url))
    with pytest.raises(StateError, match=fixed):
        push.rotate("mes", 0.0)
    with pytest.raises(StateError, match=fixed):
        push.delete("mes")


def test_a_secret_rotates_without_a_gap(station: Fixture, target: Receiver) -> None:
    push = station.start()
    first = push.put("mes", settings(target.url))
    second = push.rotate("mes", 3600.0)
    assert first is not None
    assert push.webhook("mes").secrets == 2
    assert push.test("mes").result(WAIT_S).delivered
    headers, body = target.next()
    wanted = signatures([second, first], headers["webhook-id"], int(headers["webhook-timestamp"]), body)
    assert headers["webhook-signature"] == wanted


def test_a_test_has_an_id_of_its_own_and_changes_nothing(station: Fixture, target: Receiver) -> None:
    push = station.start()
    push.put("mes", settings(target.url, events=("run",)))
    ids = set()
    for _ in range(2):
        assert push.test("mes").result(WAIT_S).detail == "status 204"
        request = target.next()
        ids.add(request.headers["webhook-id"])
        assert request.document["type"] == "test"
        assert request.document["data"]["station"] == "line-3"
    assert len(ids) == 2
    target.status = 500
    assert "status 500" in push.test("mes").result(WAIT_S).detail
    assert push.webhook("mes").delivery.state.failures == 0


def test_a_dead_receiver_delays_no_other_and_is_a_warning(station: Fixture, target: Receiver) -> None:
    push = station.start()
    push.put("dead", settings("http://127.0.0.1:9/", retry_after_s=(1.0,)))
    push.put("mes", settings(target.url))
    station.events.add("run", "a")
    assert target.next().document["data"]["message"] == "a"
    until(push.reasons)
    [warning] = push.reasons()
    assert warning.code == "webhook-failing"
    assert "Webhook 'dead' does not accept messages: 127.0.0.1 port 9: Connection refused" in warning.message
    push.delete("dead")
    assert push.reasons() == ()
    with pytest.raises(NotFoundError, match="There is no webhook 'dead'; known webhooks: 'mes'"):
        push.webhook("dead")


def test_a_changed_address_is_used_at_once(station: Fixture, target: Receiver) -> None:
    push = station.start()
    push.put("mes", settings("http://127.0.0.1:9/", retry_after_s=(3600.0,)))
    station.events.add("run", "a")
    until(lambda: push.webhook("mes").delivery.state.failures)
    push.put("mes", settings(target.url))
    assert target.next().document["data"]["message"] == "a"


def test_a_webhook_that_is_made_again_begins_anew_while_the_old_one_ends(station: Fixture, target: Receiver) -> None:
    push, file = station.start(), station.data / "push" / "receivers" / "mes.json"
    push.put("mes", settings("http://127.0.0.1:9/", retry_after_s=(3600.0,)))
    old = push.webhook("mes").delivery
    station.events.add("run", "for the old one")
    until(lambda: old.state.failures)
    push.delete("mes")
    assert not file.exists(), "at once, not when the thread ends"
    file.write_text("left by a disk that deletes nothing")
    push.put("mes", settings(target.url))
    old.join(WAIT_S)
    station.events.add("run", "for the new one")
    assert target.next().document["data"]["message"] == "for the new one"
    until(lambda: push.webhook("mes").delivery.state.delivered == 1)
    station.stop()
    assert read_state(file, lambda: 99).delivered == 1


def test_states_without_a_receiver_are_deleted_unless_the_webhooks_are_unknown(station: Fixture) -> None:
    folder = station.data / "push" / "receivers"
    folder.mkdir(parents=True)
    (folder / "gone.json").write_text("{}")
    (damaged := station.data / "push" / "webhooks.json").write_text("{")
    station.start()
    assert (folder / "gone.json").exists()
    station.stop()
    damaged.unlink()
    station.start()
    assert not (folder / "gone.json").exists()


def test_webhooks_are_limited(station: Fixture) -> None:
    push = station.start()
    for number in range(MOST_WEBHOOKS):
        push.put(f"m{number}", settings("http://127.0.0.1:9/"))
    with pytest.raises(StateError, match=f"There are {MOST_WEBHOOKS} webhooks, which is the limit"):
        push.put("one-more", settings("http://127.0.0.1:9/"))


def test_a_damaged_file_is_a_warning_and_the_station_starts(station: Fixture) -> None:
    (station.data / "push").mkdir()
    (station.data / "push" / "webhooks.json").write_text("{")
    push = station.start()
    assert [reason.code for reason in push.reasons()] == ["webhooks-damaged"]
