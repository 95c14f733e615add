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

TRY_AGAIN_S = 0.1
TRIES = 10
BEAT_S = 0.25


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
class Happened:
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


News = Replied | Refused | Unanswered | Happened | EventsLost | Restarted


@dataclass
class _Asked:
    request: Request
    own: bool
    """Asked by the link itself, whose answer is nobody else's."""
    sequence: int = 0
    first_s: float = 0.0
    last_s: float = 0.0
    tries: int = 0


class Link:
    """Give it the bytes that come and the time; send the bytes it gives, and hear the news."""

    def __init__(self, *, beating: bool = False, first_sequence: int = 0) -> None:
        self.beating = beating
        """Whether BEAT is sent; to be true while armed."""
        self.retries = 0
        self.strays = 0
        """Messages that answer nothing."""
        self.messages = 0
        """Messages of any kind: signs of life."""
        self.boots: int | None = None
        self.status: Status | None = None
        """The newest one."""
        self._reader = FrameReader()
        self._sequences = (k % 256 for k in itertools.count(first_sequence))
        self._queue: deque[_Asked] = deque()
        self._asked: _Asked | None = None
        self._order = EventOrder()
        self._acknowledged = 0
        self._next_beat_s = 0.0
        self._doubtful = False
        """Something does not fit the boot that is known."""

    @property
    def bad_frames(self) -> int:
        """Frames from the controller that were thrown away."""
        return self._reader.bad

    @property
    def up_to_date(self) -> bool:
        """Whether every event that is known to have happened has been told."""
        return not self._doubtful and self._order.missing() is None

    @property
    def status_is_old(self) -> bool:
        """Whether an event has been told that happened after the newest status."""
        return self.status is not None and self._order.wanted > self.status.events_next

    def ask(self, request: Request) -> None:
        """Queue a request; its outcome will be among the news."""
        self._queue.append(_Asked(request, own=False))

    def abandon(self) -> None:
        """The line is gone: what was asked is not asked again, and nobody will hear of it."""
        self._queue.clear()
        self._asked = None

    def skip_history(self) -> None:
        """The events up to the newest status were somebody else's; they are not told."""
        if self.status is not None:
            self._order.skip_to(self.status.events_next)

    def send(self, now_s: float) -> bytes:
        """What is to be sent now: the next request, the one under way once more, or nothing."""
        if self._asked is None:
            self._asked = self._next(now_s)
            if self._asked is None:
                return b""
            self._asked.sequence, self._asked.first_s = next(self._sequences), now_s
        elif now_s - self._asked.last_s < TRY_AGAIN_S or self._asked.tries >= TRIES:
            return b""
        else:
            self.retries += 1
        self._asked.last_s = now_s
        self._asked.tries += 1
        return encode(Message(self._asked.request.type, self._asked.sequence, self._asked.request.payload))

    def receive(self, data: bytes, now_s: float) -> list[News]:
        """What these bytes tell; call it with none to notice that a reply is overdue."""
        news = [item for message in self._reader.feed(data) for item in self._take(message, now_s)]
        asked = self._asked
        if asked is not None and asked.tries >= TRIES and now_s - asked.last_s >= TRY_AGAIN_S:
            self._asked = None
            news += [] if asked.own else [Unanswered(asked.request)]
        return news

    def _next(self, now_s: float) -> _Asked | None:
        """Own needs come first: the heartbeat, then events that were lost on the way."""
        if self.beating and now_s >= self._next_beat_s:
            self._next_beat_s = now_s + BEAT_S
            return _Asked(Request(Type.BEAT), own=True)
        if self._doubtful:
            return _Asked(Request(Type.STATUS), own=True)
        if (missing := self._order.missing()) is not None:
            return _Asked(number_request(Type.READ_EVENT, missing), own=True)
        if self._queue:
            return self._queue.popleft()
        if self._acknowledged < self._order.wanted:
            return _Asked(number_request(Type.ACK_EVENTS, self._order.wanted), own=True)
        return None

    def _take(self, message: Message, now_s: float) -> list[News]:
        self.messages += 1
        if message.type == Type.EVENT:
            return self._take_event(message)
        asked = self._asked
        refused = message.type == Type.NAK
        if (
            asked is None
            or message.sequence != asked.sequence
            or not (refused or message.type == asked.request.type | REPLY)
        ):
            self.strays += 1
            return []
        try:
            news = (
                self._refused(asked, Nak.unpack(message.payload)) if refused else self._replied(asked, message, now_s)
            )
        except ValueError:  # a checksum that fits by chance, or another protocol: the request is tried again
            self.strays += 1
            return []
        if self._asked is asked:
            self._asked = None
        return news

    def _take_event(self, message: Message) -> list[News]:
        """Its sequence number is the low byte of the boot counter: so it is not taken for one of another boot."""
        try:
            event = Event.unpack(message.payload)
        except ValueError:
            self.strays += 1
            return []
        if self.boots is None or message.sequence != self.boots % 256:
            self._doubtful = True  # until STATUS has told the whole counter; the event will be read again
            return []
        return [Happened(e) for e in self._order.take(event)]

    def _replied(self, asked: _Asked, message: Message, now_s: float) -> list[News]:
        news: list[News] = []
        payload = message.payload
        if asked.request.type in (Type.STATUS, Type.BEAT):
            self.status = Status.unpack(payload)
            self._doubtful = False
            news += self._boot(self.status.boots)
            self._order.announce(self.status.events_next)
        elif asked.request.type == Type.IDENT and payload[:1] == bytes([VERSION[0]]):
            news += self._boot(Ident.unpack(payload).boots)
        elif asked.request.type == Type.READ_EVENT and asked.own:
            news += [Happened(e) for e in self._order.take(Event.unpack(payload))]
        elif asked.request.type == Type.ACK_EVENTS and asked.own:
            self._acknowledged = int.from_bytes(asked.request.payload, "little")
        if not asked.own:
            news.append(Replied(asked.request, payload, asked.first_s, now_s))
        return news

    def _refused(self, asked: _Asked, nak: Nak) -> list[News]:
        if not asked.own:
            return [Refused(asked.request, nak)]
        if asked.request.type == Type.READ_EVENT and nak.reason == Reason.GONE and nak.limit > self._order.wanted:
            lost, events = self._order.skip_to(nak.limit)
            return [EventsLost(lost), *(Happened(e) for e in events)]
        self._doubtful = True
        return []

    def _boot(self, boots: int) -> list[News]:
        """Compare the boot counter; the request that told it is answered, all others were asked of the past."""
        if self.boots == boots:
            return []
        first, self.boots = self.boots is None, boots
        self._order, self._acknowledged = EventOrder(), 0
        if first:
            return []
        dropped = [a.request for a in self._queue if not a.own]
        self._queue.clear()
        return [Restarted(boots), *(Unanswered(request) for request in dropped)]
