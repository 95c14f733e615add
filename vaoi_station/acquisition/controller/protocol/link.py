"""The host's end of the protocol as a state machine without I/O: one request at a time, repeated until its reply.

Every request may be repeated safely (`hw/protocol.md`), so a lost reply only costs time. A reset of the controller is a
normal event: the boot counter shows it, pending requests are reported as unanswered, and events count from 0 again.
"""

from __future__ import annotations

import itertools
from collections import deque
from dataclasses import dataclass

from vaoi_station.acquisition.controller.interface import Permit
from vaoi_station.acquisition.controller.protocol.event_order import EventOrder
from vaoi_station.acquisition.controller.protocol.framing import FrameReader, Message, encode
from vaoi_station.acquisition.controller.protocol.messages import (
    REPLY,
    VERSION,
    Event,
    Ident,
    Nak,
    Reason,
    Request,
    Status,
    Type,
    number_request,
    ready,
)

RETRY_S = 0.1
"""Time without a reply after which a request is sent again."""
MAX_TRIES = 10
"""Largest count of transmissions of one request."""
HEARTBEAT_S = 0.25
"""Interval of BEAT and of READY; the firmware makes itself safe after 3 s without BEAT."""


@dataclass(frozen=True)
class Replied:
    """A request that the controller carried out, at a time between its first transmission and the reply."""

    request: Request
    payload: bytes
    sent_s: float
    received_s: float


@dataclass(frozen=True)
class Refused:
    """A request that the controller refused, with the message (NAK) that says why."""

    request: Request
    nak: Nak


@dataclass(frozen=True)
class Unanswered:
    """A request without a known outcome: no transmission had a reply, or the controller was reset.

    It may also be a request that the link made by itself, such as BEAT; then too, the controller does not reply.
    """

    request: Request


@dataclass(frozen=True)
class EventReceived:
    """The next event of the controller. Events are passed on in the order of their numbers."""

    event: Event


@dataclass(frozen=True)
class EventsLost:
    """A number (`count`) of events that the controller overwrote in its memory before they could be read."""

    count: int


@dataclass(frozen=True)
class Restarted:
    """A reset of the controller since its last message. The controller has lost its configuration."""

    boots: int


Notification = Replied | Refused | Unanswered | EventReceived | EventsLost | Restarted
"""All results that `Link.receive` can return."""


@dataclass
class _Pending:
    """A request that waits to be sent, or that waits for its reply."""

    request: Request
    internal: bool
    """Whether the link made the request for itself; its reply is then not passed on."""
    sequence: int = 0
    first_s: float = 0.0
    last_s: float = 0.0
    tries: int = 0


class Link:
    """The state machine of a serial link: it takes received bytes and the time, and returns bytes and notifications."""

    def __init__(self, *, heartbeat: bool = False, first_sequence: int = 0) -> None:
        self.heartbeat = heartbeat
        """Whether BEAT is sent; true while the controller is armed."""
        self.permit: Permit | None = None
        """Permission for the next board, renewed while it is valid; None: boards are held back."""
        self.ready_longest_ms = 0
        """Longest time, ms, for which one READY is valid. 0 without an output "line ready": READY is not sent."""
        self.retries = 0
        self.unmatched = 0
        """Count of messages that match no pending request."""
        self.messages = 0
        """Count of all valid messages; its growth shows that the controller is alive."""
        self.boots: int | None = None
        """Value of the controller's boot counter; None until it is known."""
        self.status: Status | None = None
        """The newest status that the controller has sent; None before the first."""
        self._reader = FrameReader()
        self._sequences = (k % 256 for k in itertools.count(first_sequence))
        self._queue: deque[_Pending] = deque()
        self._pending: _Pending | None = None
        self._order = EventOrder()
        self._acknowledged = 0
        self._next_heartbeat_s = 0.0
        self._next_ready_s = 0.0
        self._permit_number = 0
        """Number of the latest permit."""
        self._stated: int | None = None
        """Number of the permit that the controller has; None if it has no permit."""
        self._yielding = False
        """Whether the link's last own request was given up. A queued request is then sent before the link's next own
        one."""
        self._out_of_sync = False
        """Whether a message did not fit the known boot of the controller. The next request is then STATUS."""

    @property
    def bad_frames(self) -> int:
        """Count of damaged frames from the controller."""
        return self._reader.bad

    @property
    def up_to_date(self) -> bool:
        """Whether all events that the controller has numbered, as far as known, were passed on."""
        return not self._out_of_sync and self._order.missing() is None

    @property
    def status_is_outdated(self) -> bool:
        """Whether an event was passed on that is newer than the newest status."""
        return self.status is not None and self._order.next_number > self.status.events_next

    def request(self, request: Request) -> None:
        """Queue a request. A later call of `receive` returns its outcome."""
        self._queue.append(_Pending(request, internal=False))

    def drop_requests(self) -> None:
        """Forget all requests without reporting an outcome, because the port has disappeared."""
        self._queue.clear()
        self._pending, self._yielding = None, False

    def skip_history(self) -> None:
        """Discard the events before the newest status. They belong to a process that used the controller earlier."""
        if self.status is not None:
            self._order.skip_to(self.status.events_next)

    def outgoing(self, now_s: float) -> bytes:
        """Return the bytes to send now: the next request, a repetition of the pending one, or no bytes."""
        if self._pending is None:
            self._pending = self._next_request(now_s)
            if self._pending is None:
                return b""
            self._pending.sequence, self._pending.first_s = next(self._sequences), now_s
        elif now_s - self._pending.last_s < RETRY_S or self._pending.tries >= MAX_TRIES:
            return b""
        else:
            self.retries += 1
            if self._pending.request.type == Type.READY:
                # A repetition must not last longer than the permit. With another number, a late reply to the
                # transmission before does not count as one to this.
                self._pending.request, self._pending.sequence = self._ready_request(now_s), next(self._sequences)
        self._pending.last_s = now_s
        self._pending.tries += 1
        return encode(Message(self._pending.request.type, self._pending.sequence, self._pending.request.payload))

    def receive(self, data: bytes, now_s: float, begun_s: float | None = None) -> list[Notification]:
        """Process received bytes. It is also called without bytes, so that missing replies are noticed.

        Args:
            data: the bytes.
            now_s: monotonic time after the bytes were read, s.
            begun_s: monotonic time before they were read, s; `now_s` if not given. All that had arrived by then is in
                `data` or was received before, so only this time can show that a reply is missing.
        """
        news = [item for message in self._reader.feed(data) for item in self._on_message(message, now_s)]
        pending, listened_s = self._pending, now_s if begun_s is None else begun_s
        if pending is not None and pending.tries >= MAX_TRIES and listened_s - pending.last_s >= RETRY_S:
            self._pending = None
            self._yielding = pending.internal
            news.append(Unanswered(pending.request))
        return news

    def _next_request(self, now_s: float) -> _Pending | None:
        """Choose the next request. The link's internal requests come first, except after one that had no reply."""
        # Giving up takes longer than the interval of the heartbeat, so the next heartbeat is always due. Without this
        # rule, only BEAT would be sent to a silent controller, and no caller would ever get an outcome.
        own = None if self._yielding and self._queue else self._own_request(now_s)
        if own is not None:
            return own
        if self._queue:
            self._yielding = False
            return self._queue.popleft()
        # Acknowledgements go last: the firmware overwrites its oldest event in any case, and uses them only to count
        # losses.
        if self._acknowledged < self._order.next_number:
            return _Pending(number_request(Type.ACK_EVENTS, self._order.next_number), internal=True)
        return None

    def _own_request(self, now_s: float) -> _Pending | None:
        """Make the most urgent internal request: a heartbeat (BEAT), STATUS, or READ_EVENT for a lost event."""
        # First of all the permit: a board that must not come is held back at once.
        if self._ready_is_due(now_s):
            self._next_ready_s = now_s + HEARTBEAT_S
            return _Pending(self._ready_request(now_s), internal=True)
        # Then the heartbeat, because the controller switches everything off without it.
        if self.heartbeat and now_s >= self._next_heartbeat_s:
            self._next_heartbeat_s = now_s + HEARTBEAT_S
            return _Pending(Request(Type.BEAT), internal=True)
        if self._out_of_sync:
            return _Pending(Request(Type.STATUS), internal=True)
        if (missing := self._order.missing()) is not None:
            return _Pending(number_request(Type.READ_EVENT, missing), internal=True)
        return None

    def _hold_ms(self, now_s: float) -> int:
        """Return for how long the permit is still valid, ms; 0 without one."""
        left_s = 0.0 if self.permit is None else self.permit.until_s - now_s
        return min(max(int(left_s * 1e3), 0), self.ready_longest_ms)

    def _ready_request(self, now_s: float) -> Request:
        """Make the request READY that states the present permit."""
        if self.permit is not None:
            self._permit_number = self.permit.number
        return ready(self._permit_number, self._hold_ms(now_s))

    def _ready_is_due(self, now_s: float) -> bool:
        if not self.ready_longest_ms:
            return False
        valid = self.permit is not None and self._hold_ms(now_s) > 0
        if (self.permit.number if self.permit is not None and valid else None) != self._stated:
            return True
        return valid and now_s >= self._next_ready_s

    def _on_message(self, message: Message, now_s: float) -> list[Notification]:
        self.messages += 1
        if message.type == Type.EVENT:
            return self._on_event(message)
        pending = self._pending
        refused = message.type == Type.NAK
        if (
            pending is None
            or message.sequence != pending.sequence
            or not (refused or message.type == pending.request.type | REPLY)
        ):
            self.unmatched += 1
            return []
        try:
            news = (
                self._on_refusal(pending, Nak.unpack(message.payload))
                if refused
                else self._on_reply(pending, message, now_s)
            )
        # The checksum was right by chance, or the device has another protocol. The request stays pending and is
        # repeated.
        except ValueError:
            self.unmatched += 1
            return []
        self._yielding = False
        # A reset that this reply has shown may have replaced the pending request already.
        if self._pending is pending:
            self._pending = None
        return news

    def _on_event(self, message: Message) -> list[Notification]:
        """Add an event to the order of events. Its sequence number is the low byte of the controller's boot counter."""
        try:
            event = Event.unpack(message.payload)
        except ValueError:
            self.unmatched += 1
            return []
        if self.boots is None or message.sequence != self.boots % 256:
            # The event may be of another boot, whose numbers begin at 0 again. STATUS has the whole boot counter; then
            # the event is read again by its number.
            self._out_of_sync = True
            return []
        return [EventReceived(e) for e in self._order.add(event)]

    def _on_reply(self, pending: _Pending, message: Message, now_s: float) -> list[Notification]:
        news: list[Notification] = []
        payload = message.payload
        if pending.request.type in (Type.STATUS, Type.BEAT, Type.READY):
            self.status = Status.unpack(payload)
            self._out_of_sync = False
            news += self._on_boot_count(self.status.boots)
            self._order.announce(self.status.events_next)
            self._note_stated(pending.request)
        elif pending.request.type == Type.IDENT and payload[:1] == bytes([VERSION[0]]):
            news += self._on_boot_count(Ident.unpack(payload).boots)
        elif pending.request.type == Type.READ_EVENT and pending.internal:
            news += [EventReceived(e) for e in self._order.add(Event.unpack(payload))]
        elif pending.request.type == Type.ACK_EVENTS and pending.internal:
            self._acknowledged = int.from_bytes(pending.request.payload, "little")
        if not pending.internal:
            news.append(Replied(pending.request, payload, pending.first_s, now_s))
        return news

    def _on_refusal(self, pending: _Pending, nak: Nak) -> list[Notification]:
        if not pending.internal:
            return [Refused(pending.request, nak)]
        self._note_stated(pending.request)
        if (
            pending.request.type == Type.READ_EVENT
            and nak.reason == Reason.GONE
            and nak.limit > self._order.next_number
        ):
            lost, events = self._order.skip_to(nak.limit)
            return [EventsLost(lost), *(EventReceived(e) for e in events)]
        self._out_of_sync = True
        return []

    def _note_stated(self, request: Request) -> None:
        """Record the permit that READY has stated, even if READY was refused: it is then repeated only at renewals."""
        if request.type == Type.READY:
            number, hold_ms = request.payload[:2], request.payload[2:]
            self._stated = int.from_bytes(number, "little") if any(hold_ms) else None

    def _on_boot_count(self, boots: int) -> list[Notification]:
        """Compare the boot counter with the last one. After a reset, return all queued requests as unanswered."""
        if self.boots == boots:
            return []
        # Queued requests were meant for the configuration before the reset. Their callers decide what to do.
        first, self.boots = self.boots is None, boots
        self._order, self._acknowledged, self._stated = EventOrder(), 0, None
        if first:
            return []
        dropped = [a.request for a in self._queue if not a.internal]
        self._queue.clear()
        return [Restarted(boots), *(Unanswered(request) for request in dropped)]
