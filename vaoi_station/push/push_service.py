"""All receivers of a station: starts their deliveries, and changes them for administrators while the station runs."""

from __future__ import annotations

import secrets
import threading
import time
from collections.abc import Callable, Iterator
from concurrent.futures import Future
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from pathlib import Path

from vaoi_station.errors import NotFoundError, StateError
from vaoi_station.model.receivers import MOST_WEBHOOKS, MqttConfig, PushConfig, WebhookSettings
from vaoi_station.push.delivery import Delivery, Events, Rules, Words
from vaoi_station.push.delivery_state import delete_state
from vaoi_station.push.messages import message_of
from vaoi_station.push.mqtt_transport import MqttTransport
from vaoi_station.push.signing import new_secret, read_secrets
from vaoi_station.push.transport import Outcome
from vaoi_station.push.webhook_file import Secret, StoredWebhook, WebhookFile
from vaoi_station.push.webhook_transport import WebhookTransport
from vaoi_station.runs.states.run_ids import utc
from vaoi_station.runs.states.schemas import EventRecord, Reason
from vaoi_station.supervised_thread import SupervisedThread

FOLDER, WEBHOOKS, RECEIVERS = "push", "webhooks.json", "receivers"
STOP_S = 3.0
"""Longest wait for the attempts that are under way when the station stops, s."""
WEBHOOK_WORDS = Words(
    "Webhook",
    failing=Reason(
        code="webhook-failing", message="", action="Check the receiver; the station tries it again by itself."
    ),
    disabled=Reason(
        code="webhook-disabled", message="", action="Check the receiver, then POST webhooks/{name}/enable."
    ),
    skipped=Reason(code="events-not-pushed", message="", action="Read them with GET events?after=."),
)


_LOST = Reason(
    code="mqtt-lost", message="", action="Check broker, address, user and certificate; it is tried again by itself."
)
MQTT_WORDS = Words("MQTT broker", failing=_LOST, disabled=_LOST, skipped=WEBHOOK_WORDS.skipped)
MQTT_PAUSES_S = (1.0, 2.0, 5.0, 10.0, 30.0, 60.0)
MQTT_MOST_WAITING = 10_000
"""Number of events that wait for a broker that is away."""


@dataclass(frozen=True)
class Webhook:
    """One webhook: what it is, and how its delivery does."""

    name: str
    settings: WebhookSettings
    from_file: bool
    """Whether it is one of station.toml, which REST does not change."""
    secrets: int
    """Number of secrets that sign at present."""
    delivery: Delivery


class PushService:
    """The receivers of one station. Its methods may be called from any thread."""

    def __init__(self, data: Path, config: PushConfig, station: str, events: Events) -> None:
        """Prepare the receivers; their threads begin with `start`.

        Args:
            data: the data directory of the station.
            config: the receivers of station.toml, and what holds for all.
            station: name of the station, which each message has.
            events: the event log.
        """
        self._folder, self._config, self._station, self._events = data / FOLDER, config, station, events
        self._file = WebhookFile(self._folder / WEBHOOKS)
        self._watch: Callable[[SupervisedThread], object] | None = None
        self._lock = threading.Lock()
        self._fixed = {webhook.name: webhook for webhook in config.webhooks}
        self._deliveries: dict[str, Delivery] = {}
        for webhook in config.webhooks:
            self._set(webhook.name, webhook, partial(read_secrets, webhook.secret_file))
        for stored in self._file.all():
            if stored.name not in self._fixed:
                self._set_stored(stored)
        self._sweep()
        self._state: Callable[[], str] = str
        self._broker = None if config.mqtt is None else self._publisher(config.mqtt)

    def start(self, watch: Callable[[SupervisedThread], object], state: Callable[[], str] = str) -> None:
        """Start the threads.

        Args:
            watch: supervises the threads, and those of later webhooks.
            state: returns the state of the station.
        """
        with self._lock:
            self._watch, self._state = watch, state
            for delivery in self.deliveries():
                self._begin(delivery)

    def stop(self) -> None:
        """End the threads; an attempt that is under way is awaited for `STOP_S`."""
        with self._lock:
            for delivery in self.deliveries():
                delivery.stop()
            until = time.monotonic() + STOP_S
            for delivery in self.deliveries():
                delivery.join(max(0.0, until - time.monotonic()))

    @contextmanager
    def running(self, watch: Callable[[SupervisedThread], object], state: Callable[[], str] = str) -> Iterator[None]:
        """Run the threads during a `with` block."""
        try:
            self.start(watch, state)
            yield
        finally:
            self.stop()

    def deliveries(self) -> tuple[Delivery, ...]:
        """Return the deliveries of all receivers."""
        webhooks = tuple(self._deliveries.values())
        return webhooks if self._broker is None else (*webhooks, self._broker)

    def reasons(self) -> tuple[Reason, ...]:
        """Return a warning for each receiver that fails or is disabled."""
        found = tuple(reason for d in self.deliveries() if (reason := d.warning()) is not None)
        return found if self._file.fault is None else (*found, self._file.fault)

    # --- webhooks

    def webhooks(self) -> tuple[Webhook, ...]:
        """Return all webhooks, sorted by name."""
        return tuple(self.webhook(name) for name in sorted({*self._fixed, *(w.name for w in self._file.all())}))

    def webhook(self, name: str) -> Webhook:
        """Return one webhook. `NotFoundError`: there is none of this name."""
        delivery, fixed, stored = self._deliveries.get(name), self._fixed.get(name), self._file.get(name)
        if delivery is not None and fixed is not None:
            settings = WebhookSettings.model_validate(fixed.model_dump(exclude={"name", "secret_file"}))
            return Webhook(name, settings, True, 1, delivery)
        if delivery is not None and stored is not None:
            return Webhook(name, stored.settings, False, len(stored.valid_secrets()), delivery)
        known = ", ".join(map(repr, sorted(self._deliveries))) or "none"
        raise NotFoundError(f"There is no webhook {name!r:.80}; known webhooks: {known}.", code="unknown-webhook")

    def put(self, name: str, settings: WebhookSettings) -> str | None:
        """Make a webhook, or change one; return the secret of a new one. It begins with the next event.

        Raises:
            StateError: it is one of station.toml, or there are too many.
        """
        with self._lock:
            self._refuse_fixed(name)
            stored, secret = self._file.get(name), None
            is_new = stored is None
            if stored is None:
                count = len(self._fixed) + len(self._file.all())
                if count >= MOST_WEBHOOKS:
                    raise StateError(
                        f"There are {count} webhooks, which is the limit.",
                        action="Delete one that is not used.",
                        code="too-many-webhooks",
                    )
                secret = new_secret()
                stored = StoredWebhook(name=name, settings=settings, secrets=(Secret(secret=secret),))
            stored = stored.model_copy(update={"settings": settings})
            self._file.put(stored)
            self._set_stored(stored, is_new=is_new)
        return secret

    def rotate(self, name: str, overlap_s: float) -> str:
        """Give a webhook a new secret and return it; the one before signs for `overlap_s` more."""
        with self._lock:
            self._refuse_fixed(name)
            self.webhook(name)
            stored = self._file.get(name)
            assert stored is not None, "webhook() has found it"
            stored = stored.rotated(overlap_s)
            self._file.put(stored)
        return stored.secrets[0].secret

    def delete(self, name: str) -> None:
        """Delete a webhook, its state and its dead letters."""
        with self._lock:
            self._refuse_fixed(name)
            delivery = self.webhook(name).delivery
            self._file.delete(name)
            self._deliveries = {n: d for n, d in self._deliveries.items() if n != name}
            delivery.stop(forget=True)

    def test(self, name: str) -> Future[Outcome]:
        """Send a message of the type `test` to a webhook now, whatever its state."""
        webhook = self.webhook(name)
        record = EventRecord(number=0, time=utc(), kind="test", message=f"A test of the webhook {name!r}.")
        # Each test has an id of its own: receivers ignore an id that they know.
        message = message_of(record, self._station)._replace(id=f"test_{secrets.token_hex(8)}")
        return webhook.delivery.test(message)

    # --- inner

    def _refuse_fixed(self, name: str) -> None:
        if name in self._fixed:
            raise StateError(
                f"The webhook {name!r} is one of station.toml.",
                action="Change it there, and restart the station.",
                code="webhook-of-configuration",
            )

    def _sweep(self) -> None:
        """Delete the states of receivers that are no more: a later one of the same name begins with the next event."""
        if self._file.fault is not None:
            return  # some of them belong to webhooks that a repaired file names
        kept = {self._state_file(name) for name in self._deliveries}
        for path in (self._folder / RECEIVERS).glob("*.json"):
            if path not in kept:
                delete_state(path)

    def _set_stored(self, stored: StoredWebhook, *, is_new: bool = False) -> None:
        def secrets_now() -> tuple[str, ...]:
            found = self._file.get(stored.name)
            return () if found is None else found.valid_secrets()

        self._set(stored.name, stored.settings, secrets_now, is_new=is_new)

    def _set(
        self, name: str, settings: WebhookSettings, secrets_now: Callable[[], tuple[str, ...]], *, is_new: bool = False
    ) -> None:
        transport = WebhookTransport(settings.url, secrets_now, self._config.networks, self._config.ca)
        rules = Rules(settings.events, settings.retry_after_s)
        if (known := self._deliveries.get(name)) is not None:
            known.set(transport, rules)
            known.enable()
            return
        path = self._state_file(name)
        delivery = Delivery(name, path, self._events, self._station, WEBHOOK_WORDS, is_new=is_new)
        delivery.set(transport, rules)
        self._deliveries = {**self._deliveries, name: delivery}
        if self._watch is not None:
            self._begin(delivery)

    def _publisher(self, broker: MqttConfig) -> Delivery:
        # No webhook can have a name with a colon.
        delivery = Delivery(f"mqtt:{broker.host}", self._folder / "mqtt.json", self._events, self._station, MQTT_WORDS)
        transport = MqttTransport(broker, self._station, self._station_state)
        delivery.set(transport, Rules(broker.events, MQTT_PAUSES_S, gives_up=False, most_waiting=MQTT_MOST_WAITING))
        return delivery

    def _station_state(self) -> str:
        return self._state()

    def _begin(self, delivery: Delivery) -> None:
        assert self._watch is not None, "start() sets it"
        delivery.start()
        self._watch(delivery.thread)

    def _state_file(self, name: str) -> Path:
        # A webhook with the name of another file of the folder must not overwrite it.
        return self._folder / RECEIVERS / f"{name}.json"
