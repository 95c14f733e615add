"""The connection to an MQTT broker: publish events with QoS 1, and the state of the station as a retained topic.

A connection is made anew after each failure, with a client that knows nothing of the one before. So no message waits in
the library: what was not acknowledged is sent again by the publisher.
"""

from __future__ import annotations

import json
import ssl
import threading
import time
import uuid
from collections.abc import Callable
from contextlib import suppress
from typing import TYPE_CHECKING, Any

from vaoi_station.errors import VaoiError
from vaoi_station.files.documents import read_text
from vaoi_station.model.receivers import MqttConfig
from vaoi_station.push.broker import LIMIT_S, Broker, Outcome
from vaoi_station.runs.states.run_ids import utc
from vaoi_station.runs.states.schemas import EventRecord

if TYPE_CHECKING:
    from paho.mqtt.client import Client

KEEPALIVE_S = 15
"""Time of silence after which broker and station ask whether the other is there, s."""
COMPARE_S = 1.0
"""Shortest time between two comparisons of the state of the station with the published one, s."""
OFFLINE = "offline"
"""State that the broker publishes when the connection breaks."""
_MISSING = "The package paho-mqtt is absent. Install it: pip install 'vaoi-station[mqtt]'."


def type_of(record: EventRecord) -> str:
    """Return the type of an event: its kind, and its state if it has one, as in `run.ready`."""
    return ".".join(part.replace("-", "_") for part in (record.kind, record.state) if part)


def message_of(record: EventRecord, station: str) -> bytes:
    """Return the document of an event of the station with this name."""
    data: dict[str, Any] = {"station": station, **record.model_dump(mode="json", exclude_none=True)}
    body = {"type": type_of(record), "timestamp": record.time, "data": data}
    return json.dumps(body, separators=(",", ":")).encode()


class MqttBroker(Broker):
    """Publishes to one broker. One thread calls it; the library has a thread of its own for the connection."""

    what = "MQTT broker"
    code = "mqtt-lost"

    def __init__(self, broker: MqttConfig, station: str, state: Callable[[], str], limit_s: float = LIMIT_S) -> None:
        """Prepare the connection; `state` returns the state of the station."""
        self._broker, self._station, self._state, self._limit_s = broker, station, state, limit_s
        self.kinds = broker.events
        # A name may have characters that have a meaning in topics.
        name = "".join("_" if c in "+#/" else c for c in station)
        self._prefix = broker.prefix or f"vaoi/{name}"
        self._client: Client | None = None
        self._shown: str | None = None
        self._compared_s = 0.0

    def send(self, record: EventRecord) -> Outcome:
        """Publish one event; return when the broker has acknowledged it."""
        topic = f"runs/{record.run}" if record.run else f"events/{record.kind.replace('-', '_')}"
        try:
            client = self._connected()
            self._publish(client, topic, message_of(record, self._station), retain=False)
            self._show_state(client, at_once=record.kind == "station")
        except (OSError, ValueError, ImportError, VaoiError) as error:
            return self._failed(error)
        return Outcome(True, "acknowledged")

    def idle(self) -> Outcome | None:
        """Connect again if the connection was lost, and publish a new state, so that the retained state is right."""
        was_connected = self._client is not None and self._client.is_connected()
        try:
            self._show_state(self._connected())
        except (OSError, ValueError, ImportError, VaoiError) as error:
            return self._failed(error)
        return None if was_connected else Outcome(True, "connected")

    def close(self) -> None:
        """Publish that the station is off, and disconnect."""
        if self._client is not None and self._client.is_connected():
            with suppress(OSError, ValueError):
                self._publish(self._client, "station/state", self._state_body(OFFLINE), retain=True)
        self._drop()

    def _connected(self) -> Client:
        """Return a client that is connected; connect if there is none."""
        if self._client is not None and self._client.is_connected():
            return self._client
        self._drop()
        self._client = client = self._new_client()
        replied, refusal = threading.Event(), []

        def on_connect(_client: object, _data: object, _flags: object, reason: Any, _properties: object) -> None:
            if reason.is_failure:
                refusal.append(str(reason))
            replied.set()

        client.on_connect = on_connect
        broker = self._broker
        client.connect(*broker.place, KEEPALIVE_S)
        client.loop_start()
        if not replied.wait(self._limit_s):
            raise TimeoutError(f"no reply within {self._limit_s:.0f} s")
        if refusal:
            raise ConnectionRefusedError(f"the broker refuses the connection ({refusal[0]})")
        self._show_state(client, at_once=True)
        return client

    def _show_state(self, client: Client, *, at_once: bool = False) -> None:
        """Publish the present state if it differs from the retained one; without `at_once`, compare once a second.

        An event may be old when it is sent, and may be of a type that is not published, so its state is of no use here.
        """
        if not at_once and time.monotonic() - self._compared_s < COMPARE_S:
            return
        self._compared_s = time.monotonic()
        try:
            state = self._state()
        except VaoiError:
            return  # the station is busy or stopping; it is asked again
        if state != self._shown:
            self._publish(client, "station/state", self._state_body(state), retain=True)
            self._shown = state

    def _new_client(self) -> Client:
        try:
            from paho.mqtt.client import Client
            from paho.mqtt.enums import CallbackAPIVersion
        except ImportError as error:
            raise ImportError(_MISSING) from error
        broker = self._broker
        client = Client(
            CallbackAPIVersion.VERSION2, client_id=f"vaoi-{uuid.uuid4().hex[:12]}", reconnect_on_failure=False
        )
        client.connect_timeout = self._limit_s / 2
        client.will_set(f"{self._prefix}/station/state", self._state_body(OFFLINE), qos=1, retain=True)
        if broker.user is not None:
            password = None if broker.password_file is None else read_text(broker.password_file).strip()
            client.username_pw_set(broker.user, password)
        if broker.tls:
            context = ssl.create_default_context(cafile=broker.ca)
            if broker.certificate is not None and broker.private_key is not None:
                # Without a password here, an encrypted key would be asked for at the terminal.
                context.load_cert_chain(broker.certificate, broker.private_key, lambda: "")
            client.tls_set_context(context)
        return client

    def _publish(self, client: Client, topic: str, body: bytes, *, retain: bool) -> None:
        info = client.publish(f"{self._prefix}/{topic}", body, qos=1, retain=retain)
        try:
            info.wait_for_publish(self._limit_s)
        except RuntimeError as error:  # the library's word for a message that it could not send
            raise ConnectionError(str(error)) from error
        if not info.is_published():
            raise TimeoutError(f"the broker has not acknowledged a message within {self._limit_s:.0f} s")

    def _state_body(self, state: str) -> bytes:
        # The will is given before it takes effect, so its time would mean nothing.
        stamp = {} if state == OFFLINE else {"time": utc()}
        return json.dumps({"station": self._station, "state": state, **stamp}).encode()

    def _failed(self, error: Exception) -> Outcome:
        self._drop()
        text = getattr(error, "strerror", None) or str(error) or type(error).__name__
        return Outcome(False, f"{self._broker.host}: {text}.".replace("..", "."))

    def _drop(self) -> None:
        client, self._client, self._shown = self._client, None, None
        if client is not None:
            with suppress(OSError, ValueError):
                client.disconnect()
            client.loop_stop()
            if (connection := client.socket()) is not None:
                connection.close()
