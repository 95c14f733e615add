"""Events over a real MQTT broker: topics, retained state, last will, TLS, and a broker that goes and comes back."""

from __future__ import annotations

import json
import socket
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from tests.push.broker import PASSWORD, USER, Broker, Subscriber
from tests.push.event_list import EventList
from tests.push.test_publisher import until
from vaoi_station.errors import StateError
from vaoi_station.model.receivers import MqttConfig
from vaoi_station.push import mqtt, publisher
from vaoi_station.push.mqtt import MqttBroker, message_of
from vaoi_station.push.publisher import Publisher

STATE = "vaoi/line_3/station/state"


@pytest.fixture(scope="module")
def broker(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Broker]:
    made = Broker(tmp_path_factory.mktemp("broker"))
    made.start()
    yield made
    made.stop()


@pytest.fixture
def subscriber(broker: Broker) -> Iterator[Subscriber]:
    made = Subscriber(broker.port)
    yield made
    made.close()


def connection(broker: Broker, state: Callable[[], str] = lambda: "idle", **more: Any) -> MqttBroker:
    config = MqttConfig(**{"host": "127.0.0.1", "port": broker.port} | more)
    return MqttBroker(config, "line/3", state, limit_s=20.0)


def test_topics_retained_state_and_last_will(
    broker: Broker, subscriber: Subscriber, events: EventList, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(mqtt, "COMPARE_S", 0.0)
    states = iter(["idle", "idle", "idle", "armed"])
    made = connection(broker, lambda: next(states, "armed"))
    records = [
        events.add("run", "a", state="ready", run="r1"),
        events.add("board-missed", "b"),
        events.add("station", "c", state="armed"),
    ]
    assert all(made.send(record).delivered for record in records)
    topics = ["vaoi/line_3/runs/r1", "vaoi/line_3/events/board_missed", "vaoi/line_3/events/station"]
    found = [subscriber.next() for _ in range(5)]
    assert [m.topic for m in found] == [STATE, *topics, STATE]
    assert [json.loads(m.body)["state"] for m in found if m.topic == STATE] == ["idle", "armed"]
    assert json.loads(found[1].body) == json.loads(message_of(records[0], "line/3"))
    late = Subscriber(broker.port)
    assert (retained := late.next()).topic == STATE
    assert retained.retained
    assert json.loads(retained.body)["state"] == "armed"
    late.close()
    assert made.idle() is None
    # The connection breaks without a farewell: the broker publishes the will, and the station connects again.
    client: Any = made._client
    client.socket().shutdown(socket.SHUT_RDWR)
    assert json.loads(subscriber.next().body) == {"station": "line/3", "state": "offline"}
    until(lambda: not client.is_connected())
    outcome = made.idle()
    assert outcome is not None
    assert outcome.delivered
    assert json.loads(subscriber.next().body)["state"] == "armed"
    made.close()
    assert json.loads(subscriber.next().body)["state"] == "offline"


def test_the_retained_state_is_the_present_one_whatever_the_events_say(
    broker: Broker, subscriber: Subscriber, events: EventList, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(mqtt, "COMPARE_S", 0.0)
    state: list[str | Exception] = ["armed"]

    def present() -> str:
        if isinstance(state[0], Exception):
            raise state[0]
        return state[0]

    made = connection(broker, present)
    # An event that has waited while the broker was away, and whose state is over.
    assert made.send(events.add("station", "old", state="fault")).delivered
    # Another test may have left a retained state.
    first = next(message for message in iter(subscriber.next, None) if not message.retained)
    assert (first.topic, json.loads(first.body)["state"]) == (STATE, "armed")
    assert subscriber.next().topic == "vaoi/line_3/events/station"
    state[0] = "idle"  # its event is of a type that is not published
    assert made.idle() is None
    assert json.loads(subscriber.next().body)["state"] == "idle"
    state[0] = StateError("The station is stopping.")
    assert made.idle() is None
    made.close()
    assert json.loads(subscriber.next().body)["state"] == "offline"


# The library leaves the socket of a handshake that failed to the garbage collector, which warns of it.
@pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning")
def test_tls_and_password(broker: Broker, tmp_path: Path) -> None:
    password = tmp_path / "password"
    password.write_text(f"{PASSWORD}\n")
    secure: dict[str, Any] = {"port": broker.tls_port, "tls": True, "user": USER, "password_file": password}
    known = connection(broker, ca=broker.ca, **secure)
    assert known.idle() == (True, "connected")
    known.close()
    untrusted = connection(broker, **secure).idle()
    assert untrusted is not None
    assert "certificate verify failed" in untrusted.detail
    password.write_bytes(PASSWORD.encode("utf-16"))
    known = connection(broker, ca=broker.ca, **secure)
    assert known.idle() == (True, "connected")
    known.close()
    password.write_bytes(PASSWORD.encode("utf-16-le"))
    unread = connection(broker, ca=broker.ca, **secure).idle()
    assert unread is not None
    assert "not UTF-8 text" in unread.detail
    password.write_text("wrong")
    refused = connection(broker, ca=broker.ca, **secure).idle()
    assert refused is not None
    assert "the broker refuses the connection (Not authorized)" in refused.detail


def test_a_broker_that_goes_and_comes_back_gets_what_waited(
    tmp_path: Path, events: EventList, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(publisher, "PAUSES_S", (0.05,))
    broker = Broker(tmp_path)
    config = MqttConfig(host="127.0.0.1", port=broker.port, prefix="plant/line-3")
    log: Any = events
    made = Publisher("broker", tmp_path / "mqtt.json", log, MqttBroker(config, "line-3", lambda: "armed"))
    with made.running(lambda _: None):
        events.add("run", "while the broker is away", run="r1")
        until(made.reasons)
        broker.start()
        until(lambda: made.state.delivered == 1)
        assert made.reasons() == ()
        subscriber = Subscriber(broker.port)
        assert json.loads(subscriber.next().body)["state"] == "armed"
        events.add("run", "now", run="r2")
        assert subscriber.next().topic == "plant/line-3/runs/r2"
    assert json.loads(subscriber.next().body)["state"] == "offline"
    subscriber.close()
    broker.stop()
