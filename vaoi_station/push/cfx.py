"""The connection to a broker of AMQP 1.0: IPC-CFX messages of the events, heartbeats, and answers to requests.

One thread uses it: Qpid Proton works while this thread calls it, at least every half second. No message waits in the
library: what the broker has not accepted is sent again by the publisher, with the same id.
"""

from __future__ import annotations

import json
import logging
import ssl
import time
from collections import deque
from collections.abc import Sequence
from contextlib import suppress
from datetime import datetime
from typing import TYPE_CHECKING, Any

from vaoi_station.errors import VaoiError
from vaoi_station.files.documents import read_text
from vaoi_station.model.receivers import CfxConfig
from vaoi_station.push import proton_library
from vaoi_station.push.broker import LIMIT_S, OWN_KIND, Broker, Outcome
from vaoi_station.push.cfx_messages import (
    FAULT,
    KINDS,
    Endpoint,
    Facts,
    FaultWatch,
    History,
    Message,
    Translator,
    fault_of,
    live,
    span,
)
from vaoi_station.runs.archive.event_log import EventLog
from vaoi_station.runs.states.schemas import EventRecord

if TYPE_CHECKING:
    from proton.utils import BlockingConnection, BlockingReceiver, BlockingSender

_log = logging.getLogger(__name__)

SILENCE_S = 15.0
"""Time of silence after which broker and station ask whether the other is there, s."""
LOOK_S = 1.0
"""Shortest time between two comparisons of the station's conditions, s."""
LOOK_BACK = 2_000
"""Number of events before the first one in which the state before it is looked for."""
MOST_ANSWERS, LONGEST_REQUEST = 20, 65_536
"""Requests that are answered in one go, and the longest one that is read, bytes."""
READ_S = 0.05
"""Time in which the library reads what the broker says while there are no events, s."""
END_S = 1.0
"""Longest wait for the broker's farewell, s."""
CONTENT_TYPE = 'application/json; charset="utf-8"'


class CfxBroker(Broker):
    """Publishes to one broker, as one CFX endpoint."""

    what, kinds = "CFX broker", KINDS
    code = "cfx-lost"

    def __init__(
        self,
        config: CfxConfig,
        name: str,
        events: EventLog,
        facts: Facts,
        hermes: bool = False,
        limit_s: float = LIMIT_S,
    ) -> None:
        """Prepare the connection of the station `name`; DeviceError if Qpid Proton cannot be used."""
        proton_library.load()
        self._config, self._events, self._limit_s = config, events, limit_s
        handle = config.handle or f"vaoi_station.VideoAOI.{'_'.join(name.replace('.', ' ').split())}"
        host, port = config.place
        host = f"[{host}]" if ":" in host else host
        self._url = f"{'amqps' if config.tls else 'amqp'}://{host}:{port}"
        self.endpoint = Endpoint(handle, name, self._url, config.requests, hermes)
        self._translator = Translator(handle, facts, hermes)
        self._first = events.last + 1
        self._history, self._seen = History(self._first), -LOOK_BACK - 1
        """What the events up to the number `_seen` tell."""
        self._begun: tuple[int, deque[Message]] = (0, deque())
        """Number of the event that is being sent, and what is left of its messages."""
        standing = self._before(self._first)
        self._watch, self._looked_s = FaultWatch(events.add, facts.snapshot, standing.faults), 0.0
        self._connection: BlockingConnection | None = None
        self._sender: BlockingSender | None = None
        self._receiver: BlockingReceiver | None = None
        self._ways: dict[str, BlockingSender] = {}
        """The ways to those who have asked, by their addresses."""
        self._breaking = deque[str](maxlen=MOST_ANSWERS)
        """Addresses for answers at which the connection broke."""
        self._beaten_s = 0.0

    def tend(self) -> None:
        """Note which conditions of the station have begun or are over, whether or not the broker is there."""
        if time.monotonic() - self._looked_s >= LOOK_S:
            self._looked_s = time.monotonic()
            with suppress(VaoiError):  # the station is busy or stopping; it is asked again
                self._watch.look()

    def send(self, record: EventRecord) -> Outcome:
        """Send the messages of an event; return when the broker has accepted all of them."""
        try:
            sender = self._connected()
            if record.number - self._seen > LOOK_BACK:  # at the start, and after events that were skipped
                earlier, self._history, self._seen = self._history, self._before(record.number), record.number - 1
                if self._history.station is None:
                    self._history.station, self._history.since = earlier.station, earlier.since
            if self._begun[0] != record.number:
                self._begun = (record.number, deque(self._messages(record)))
            left = self._begun[1]
            while left:
                self._send(sender, left[0], record.number)
                left.popleft()
            self._history.add([record])
            self._seen = record.number
            self._answer_and_beat(sender)
        except self._faults() as error:
            return self._failed(error)
        return Outcome(True, "accepted")

    def idle(self) -> Outcome | None:
        """Connect again if the connection was lost; answer requests, and send the heartbeat that is due."""
        was_connected = self._connection is not None
        try:
            self._answer_and_beat(self._connected(), READ_S)
        except self._faults() as error:
            return self._failed(error)
        return None if was_connected else Outcome(True, "connected")

    def close(self) -> None:
        """Say that the station ends, and disconnect."""
        if self._sender is not None:
            try:
                body = {"CFXHandle": self.endpoint.handle}
                self._send(self._sender, live("CFX.EndpointShuttingDown", body), limit_s=END_S)
            except self._faults():
                return self._drop()
        return self._drop(broken=False)

    @staticmethod
    def _faults() -> tuple[type[Exception], ...]:
        from proton import ProtonException

        return (ProtonException, OSError, ValueError, VaoiError)

    def _before(self, number: int) -> History:
        """Return what the events before one tell."""
        history, after = History(self._first), max(0, number - 1 - LOOK_BACK)
        if number > 1:
            history.add(self._events.latest(FAULT, number))
            history.add(record for record in self._events.read(after, 0.0, LOOK_BACK) if record.number < number)
        return history

    def _connected(self) -> BlockingSender:
        """Return the way to the broker; connect if there is none."""
        if self._connection is not None and self._sender is not None and not self._connection.disconnected:
            return self._sender
        self._drop()
        from proton.utils import BlockingConnection

        config = self._config
        self._connection = connection = BlockingConnection(
            self._url, timeout=self._limit_s, heartbeat=SILENCE_S, **self._login()
        )
        self._sender = sender = connection.create_sender(config.address)
        if config.requests is not None:
            self._receiver = connection.create_receiver(config.requests, credit=MOST_ANSWERS)
        self._send(sender, live("CFX.EndpointConnected", self.endpoint.place()))
        self._beaten_s = 0.0
        return sender

    def _login(self) -> dict[str, Any]:
        """Return the options by which the broker knows the station, and the station the broker."""
        from proton import SSLDomain

        config, options = self._config, dict[str, Any]()
        if config.tls:
            domain = SSLDomain(SSLDomain.MODE_CLIENT)
            system = ssl.get_default_verify_paths()
            # A file or a directory. The library needs the authorities before it can ask for the broker's name.
            domain.set_trusted_ca_db(str(config.ca or system.cafile or system.capath))
            domain.set_peer_authentication(SSLDomain.VERIFY_PEER_NAME)
            if config.certificate is not None and config.private_key is not None:
                # Without a password here, an encrypted key would be asked for at the terminal.
                domain.set_credentials(str(config.certificate), str(config.private_key), "")
            options["ssl_domain"] = domain
        if config.user is not None:
            password = "" if config.password_file is None else read_text(config.password_file).strip()
            options |= {"user": config.user, "password": password, "allowed_mechs": "PLAIN"}
            options["allow_insecure_mechs"] = not config.tls
        else:
            options["allowed_mechs"] = "ANONYMOUS" if config.certificate is None else "EXTERNAL"
        return options

    def _send(self, sender: BlockingSender, message: Message, event: int = 0, limit_s: float | None = None) -> None:
        """Send a message, and wait until the broker has accepted it."""
        from proton import ConnectionException, Delivery

        wrapped = self._wrapped(message)
        size, limit = len(wrapped.encode()), sender.link.remote_max_message_size
        if limit and size > limit:
            # It would be refused again and again, and hold up all that follow.
            self._leave_out(f"{message.name} of event {event}: {size} bytes, it takes {limit}")
            return
        delivery = sender.send(wrapped, timeout=limit_s or self._limit_s, error_states=[])
        if delivery.remote_state == Delivery.RELEASED:
            raise ConnectionException(f"no process receives what is sent to {self._config.address} (released)")
        if delivery.remote_state != Delivery.ACCEPTED:
            raise ConnectionException(f"the broker does not accept {message.name} ({delivery.remote_state})")

    def _messages(self, record: EventRecord) -> Sequence[Message]:
        """Return the messages of an event; none, and a report, if a fault of this program prevents them for ever."""
        try:
            return self._translator.messages(record, self._history)
        except VaoiError:
            raise  # the station is busy or stopping
        except Exception as error:  # noqa: BLE001  all later events would wait for this one
            _log.exception("CFX: event %d has no messages", record.number)
            self._leave_out(f"event {record.number}: {type(error).__name__}: {error}")
            return ()

    def _leave_out(self, what: str) -> None:
        text = f"{self.what} does not get {what}."
        self._events.add(OWN_KIND, text, code="events-not-pushed", action="Read it with GET events?after=.")

    def _wrapped(self, message: Message) -> Any:
        """Return the message of AMQP, with the properties of CFX/Transport/AmqpUtilities.cs."""
        from proton import Message as AmqpMessage

        handle, created = self.endpoint.handle, datetime.fromisoformat(message.time).timestamp()
        body = json.dumps(message.envelope(handle), separators=(",", ":")).encode()
        return AmqpMessage(
            body,
            inferred=True,  # bytes as they are
            durable=True,
            id=message.id,
            subject=f"{handle}.{message.name}",
            reply_to=self._config.requests,
            correlation_id=message.request,
            content_type=CONTENT_TYPE,
            creation_time=created,
            properties={
                "cfx-topic": message.name.rpartition(".")[0],
                "cfx-message": message.name,
                "cfx-handle": handle,
                "cfx-target": message.target,
            },
        )

    def _answer_and_beat(self, sender: BlockingSender, wait_s: float = 0.0) -> None:
        """Answer the requests that come within a time, and send the heartbeat that is due."""
        from proton import Timeout

        assert self._connection is not None, "it was just connected"
        receiver = self._receiver
        for _ in range(MOST_ANSWERS):
            try:
                # Also without requests: this is when the library reads what the broker says.
                self._connection.wait(lambda: receiver is not None and receiver.fetcher.has_message, timeout=wait_s)
            except Timeout:
                break
            if receiver is None:
                break
            request = receiver.receive()
            # First: one whose answer breaks the connection must not come again and again. The library would open the
            # way for the answer before it writes this.
            receiver.accept()
            self._connection.wait(self._is_written)
            receiver.link.flow(1)
            self._answer(sender, request)
        if time.monotonic() - self._beaten_s >= self._config.heartbeat_s:
            self._beaten_s = time.monotonic()
            body = {
                "CFXHandle": self.endpoint.handle,
                "HeartbeatFrequency": span(self._config.heartbeat_s),
                "ActiveFaults": [fault_of(self.endpoint.handle, record) for record in self._watch.standing.values()],
            }
            self._send(sender, live("CFX.Heartbeat", body))

    def _is_written(self) -> bool:
        """Return whether the socket has taken all that the library has to say."""
        assert self._connection is not None, "the request has come by it"
        transport = self._connection.conn.transport
        return transport is None or transport.pending() <= 0

    def _answer(self, sender: BlockingSender, request: Any) -> None:
        """Answer one request where it asks for it, else where all messages go."""
        from proton import ProtonException

        content = request.body.encode() if isinstance(request.body, str) else request.body
        if not isinstance(content, bytes | memoryview) or len(content) > LONGEST_REQUEST:
            return
        try:
            document = json.loads(bytes(content))
        except (ValueError, RecursionError):
            return
        answer = self.endpoint.answer(document) if isinstance(document, dict) else None
        if answer is None:
            return
        to = None if request.reply_to in self._breaking else request.reply_to
        try:
            self._send((self._way(to, answer.id) if to else None) or sender, answer)
        except ProtonException:
            if to:
                self._breaking.append(to)
            raise

    def _way(self, address: str, name: str) -> BlockingSender | None:
        """Return the way to one who has asked; None if the broker has no such address."""
        from proton import LinkException

        assert self._connection is not None, "the request has come by it"
        if (way := self._ways.get(address)) is None:
            try:
                way = self._connection.create_sender(address, name=name)
            except LinkException as error:
                # The official library writes a handle there, which is no address of a broker.
                _log.info("CFX: no way to %s for an answer: %s", address, error)
                return None
            # They stay open: RabbitMQ does not confirm that one is closed.
            self._ways[address] = way
            if len(self._ways) > MOST_ANSWERS:
                self._ways.pop(next(iter(self._ways))).link.close()
        return way

    def _failed(self, error: Exception) -> Outcome:
        self._drop()
        text = getattr(error, "strerror", None) or str(error) or type(error).__name__
        return Outcome(False, f"{self._config.host}: {text}.".replace("..", "."))

    def _drop(self, *, broken: bool = True) -> None:
        """End the connection; if it is `broken`, without a farewell, for which the library would wait."""
        connection, self._connection, self._sender, self._receiver = self._connection, None, None, None
        self._ways.clear()
        if connection is not None:
            connection.timeout = END_S
            with suppress(Exception):
                if broken and (transport := connection.conn.transport) is not None:
                    transport.close_tail()
                    transport.close_head()
            with suppress(Exception):
                connection.close()
