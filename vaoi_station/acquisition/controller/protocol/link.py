"""The host's end of the line as a state machine: one request at a time, repeated until answered; events in order.

Every request may safely be repeated (`hw/protocol.md`), so a lost reply costs time and nothing else. A reset of the
controller is normal: it is noticed by the boot counter, requests under way are given back, events count from 0 again.
"""

from __future__ import annotations

import itertools
from collections import deque
from dataclasses import dataclass

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
)

RETRY_S = 0.1
MAX_TRIES = 10
HEARTBEAT_S = 0.25


@dataclass(frozen=True)
class Replied:
    """A request was carried out; the times of its first sending and of the reply bound when."""

    request: Request
    payload: bytes
    sent_s: float
    received_s: float


@dataclass(frozen=True)
class Refused:
    """A request was not carried out."""

    request: Request
    nak: Nak


@dataclass(frozen=True)
class Unanswered:
    """A request may or may not have been carried out: no reply came to any try, or the controller was reset."""

    request: Request


@dataclass(frozen=True)
class EventReceived:
    """The next event."""

    event: Event


@dataclass(frozen=True)
class EventsLost:
    """So many events were overwritten before they could be read."""

    count: int


@dataclass(frozen=True)
class Restarted:
    """The controller was reset since it was last heard; nothing is configured any more."""

    boots: int


Notification = Replied | Refused | Unanswered | EventReceived | EventsLost | Restarted


@dataclass
class _Pending:
    request: Request
    internal: bool
    """Asked by the link itself, whose answer is nobody else's."""
    sequence: int = 0
    first_s: float = 0.0
    last_s: float = 0.0
    tries: int = 0


class Link:
    """Give it the bytes that come and the time; send the bytes it gives, and hear the news."""

    def __init__(self, *, heartbeat: bool = False, first_sequence: int = 0) -> None:
        self.heartbeat = heartbeat
        """Whether BEAT is sent; to be true while armed."""
        self.retries = 0
        self.unmatched = 0
        """Messages that answer nothing."""
        self.messages = 0
        """Messages of any kind: signs of life."""
        self.boots: int | None = None
        self.status: Status | None = None
        """The newest one."""
        self._reader = FrameReader()
        self._sequences = (k % 256 for k in itertools.count(first_sequence))
        self._queue: deque[_Pending] = deque()
        self._pending: _Pending | None = None
        self._order = EventOrder()
        self._acknowledged = 0
        self._next_heartbeat_s = 0.0
        self._out_of_sync = False
        """Something does not fit the boot that is known."""

    @property
    def bad_frames(self) -> int:
        """Frames from the controller that were thrown away."""
        return self._reader.bad

    @property
    def up_to_date(self) -> bool:
        """Whether every event that is known to have happened has been told."""
        return not self._out_of_sync and self._order.missing() is None

    @property
    def status_is_outdated(self) -> bool:
        """Whether an event has been told that happened after the newest status."""
        return self.status is not None and self._order.next_number > self.status.events_next

    def request(self, request: Request) -> None:
        """Queue a request; its outcome will be among the news."""
        self._queue.append(_Pending(request, internal=False))

    def drop_requests(self) -> None:
        """The line is gone: what was pending is not pending again, and nobody will hear of it."""
        self._queue.clear()
        self._pending = None

    def skip_history(self) -> None:
        """The events up to the newest status were somebody else's; they are not told."""
        if self.status is not None:
            self._order.skip_to(self.status.events_next)

    def outgoing(self, now_s: float) -> bytes:
        """What is to be sent now: the next request, the one under way once more, or nothing."""
        if self._pending is None:
            self._pending = self._next_request(now_s)
            if self._pending is None:
                return b""
            self._pending.sequence, self._pending.first_s = next(self._sequences), now_s
        elif now_s - self._pending.last_s < RETRY_S or self._pending.tries >= MAX_TRIES:
            return b""
        else:
            self.retries += 1
        self._pending.last_s = now_s
        self._pending.tries += 1
        return encode(Message(self._pending.request.type, self._pending.sequence, self._pending.request.payload))

    def receive(self, data: bytes, now_s: float) -> list[Notification]:
        """What these bytes tell; call it with none to notice that a reply is overdue."""
        news = [item for message in self._reader.feed(data) for item in self._on_message(message, now_s)]
        pending = self._pending
        if pending is not None and pending.tries >= MAX_TRIES and now_s - pending.last_s >= RETRY_S:
            self._pending = None
            news += [] if pending.internal else [Unanswered(pending.request)]
        return news

    def _next_request(self, now_s: float) -> _Pending | None:
        """Own needs come first: the heartbeat, then events that were lost on the way."""
        if self.heartbeat and now_s >= self._next_heartbeat_s:
            self._next_heartbeat_s = now_s + HEARTBEAT_S
            return _Pending(Request(Type.BEAT), internal=True)
        if self._out_of_sync:
            return _Pending(Request(Type.STATUS), internal=True)
        if (missing := self._order.missing()) is not None:
            return _Pending(number_request(Type.READ_EVENT, missing), internal=True)
        if self._queue:
            return self._queue.popleft()
        if self._acknowledged < self._order.next_number:
            return _Pending(number_request(Type.ACK_EVENTS, self._order.next_number), internal=True)
        return None

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
        except ValueError:  # a checksum that fits by chance, or another protocol: the request is tried again
            self.unmatched += 1
            return []
        if self._pending is pending:
            self._pending = None
        return news

    def _on_event(self, message: Message) -> list[Notification]:
        """Its sequence number is the low byte of the boot counter: so it is not taken for one of another boot."""
        try:
            event = Event.unpack(message.payload)
        except ValueError:
            self.unmatched += 1
            return []
        if self.boots is None or message.sequence != self.boots % 256:
            self._out_of_sync = True  # until STATUS has told the whole counter; the event will be read again
            return []
        return [EventReceived(e) for e in self._order.add(event)]

    def _on_reply(self, pending: _Pending, message: Message, now_s: float) -> list[Notification]:
        news: list[Notification] = []
        payload = message.payload
        if pending.request.type in (Type.STATUS, Type.BEAT):
            self.status = Status.unpack(payload)
            self._out_of_sync = False
            news += self._on_boot_count(self.status.boots)
            self._order.announce(self.status.events_next)
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
        if (
            pending.request.type == Type.READ_EVENT
            and nak.reason == Reason.GONE
            and nak.limit > self._order.next_number
        ):
            lost, events = self._order.skip_to(nak.limit)
            return [EventsLost(lost), *(EventReceived(e) for e in events)]
        self._out_of_sync = True
        return []

    def _on_boot_count(self, boots: int) -> list[Notification]:
        """Compare the boot counter; the request that told it is answered, all others were pending of the past."""
        if self.boots == boots:
            return []
        first, self.boots = self.boots is None, boots
        self._order, self._acknowledged = EventOrder(), 0
        if first:
            return []
        dropped = [a.request for a in self._queue if not a.internal]
        self._queue.clear()
        return [Restarted(boots), *(Unanswered(request) for request in dropped)]
