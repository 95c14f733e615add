"""The host's `Link` against the firmware's own logic, over a line that loses, damages and repeats frames."""

from __future__ import annotations

import ctypes
import random
from collections.abc import Iterator

from hypothesis import given, settings
from hypothesis import strategies as st

from tests.hw.emulated.line import us
from vaoi_station.acquisition.controller.protocol import (
    Event,
    EventReceived,
    EventsLost,
    Kind,
    Link,
    Message,
    Notification,
    Refused,
    Replied,
    Request,
    Restarted,
    Step,
    Type,
    Unanswered,
    encode,
    fire_one,
)

TURN_S = 0.005
DARK = Step(0, 0)


class Wire:
    """5 ms per turn; each frame of either direction is lost or damaged independently."""

    def __init__(self, logic: ctypes.CDLL, seed: int, loss: float) -> None:
        self.logic, self.dice, self.loss = logic, random.Random(seed), loss
        self.boots = 1
        self.link = Link()
        self.news: list[Notification] = []
        self.turns = 0
        self._replies = ctypes.create_string_buffer(4096)
        self._event = ctypes.create_string_buffer(16)
        logic.bridge_boot(0, self.boots)

    @property
    def now_s(self) -> float:
        return self.turns * TURN_S

    @property
    def tick(self) -> ctypes.c_uint32:
        return ctypes.c_uint32(self.turns * us(5000))

    def turn(self) -> None:
        self.turns += 1
        self.logic.bridge_poll(self.tick)
        to_chip = b"".join(self._damage(self.link.outgoing(self.now_s)))
        size = self.logic.bridge_talk(to_chip, len(to_chip), self._replies, self.tick)
        self.logic.bridge_poll(self.tick)
        frames = [self._replies.raw[:size], *self._events()]
        self.news += self.link.receive(b"".join(f for frame in frames for f in self._damage(frame)), self.now_s)

    def run(self, turns: int) -> None:
        for _ in range(turns):
            self.turn()

    def reboot(self) -> None:
        self.boots += 1
        self.logic.bridge_boot(self.tick, self.boots)

    def _events(self) -> Iterator[bytes]:
        while self.logic.bridge_event(self._event) & 0xFF:
            yield encode(Message(Type.EVENT, self.boots % 256, self._event.raw))

    def _damage(self, frame: bytes) -> Iterator[bytes]:
        if not frame or self.dice.random() < self.loss:
            return
        if self.dice.random() < self.loss:
            damaged = bytearray(frame)
            damaged[self.dice.randrange(len(frame))] ^= 1 << self.dice.randrange(8)
            yield bytes(damaged)
            return
        yield frame
        if self.dice.random() < self.loss:
            yield frame

    def events(self) -> list[Event]:
        return [item.event for item in self.news if isinstance(item, EventReceived)]


@settings(max_examples=40)
@given(seed=st.integers(0, 2**32), loss=st.sampled_from([0.0, 0.05, 0.3]))
def test_every_request_is_carried_out_once_and_every_event_arrives_once_in_order(
    logic: ctypes.CDLL, seed: int, loss: float
) -> None:
    wire = Wire(logic, seed, loss)
    requests = [Request(Type.IDENT), *(fire_one(nonce, DARK, us(100)) for nonce in range(12)), Request(Type.STATUS)]
    for request in requests:
        wire.link.request(request)
        wire.run(8)
    wire.loss = 0.0
    wire.run(400)
    wire.link.request(Request(Type.STATUS))
    wire.run(60)
    outcomes = [item.request for item in wire.news if isinstance(item, Replied | Refused | Unanswered)]
    assert outcomes == [*requests, Request(Type.STATUS)]
    assert all(isinstance(item, Replied) for item in wire.news if not isinstance(item, EventReceived))
    events = wire.events()
    assert [e.number for e in events] == list(range(len(events)))
    assert [e.kind for e in events] == [Kind.BOOT] + [Kind.PULSE] * 12
    assert wire.link.status is not None
    assert wire.link.status.events_next == 13


def test_events_overwritten_during_a_long_silence_are_counted(logic: ctypes.CDLL) -> None:
    wire = Wire(logic, 1, 0.0)
    wire.link.request(Request(Type.IDENT))
    wire.run(5)
    wire.loss = 1.0
    for nonce in range(50):  # requests of the host arrive, but no reply does
        frame = encode(Message(Type.FIRE_ONE, nonce, fire_one(nonce, DARK, us(100)).payload))
        logic.bridge_talk(frame, len(frame), ctypes.create_string_buffer(100), wire.tick)
        wire.run(3)
    wire.loss = 0.0
    wire.link.request(Request(Type.STATUS))
    wire.run(200)
    lost = [item.count for item in wire.news if isinstance(item, EventsLost)]
    assert lost == [51 - 32 - 1]  # 50 pulses and the boot, which had arrived
    assert [e.number for e in wire.events()] == [0, *range(51 - 32, 51)]


@settings(max_examples=30)
@given(seed=st.integers(0, 2**32), loss=st.sampled_from([0.0, 0.2]), before=st.integers(0, 6), after=st.integers(0, 9))
def test_a_reset_is_noticed_and_no_event_is_taken_for_one_of_another_boot(
    logic: ctypes.CDLL, seed: int, loss: float, before: int, after: int
) -> None:
    wire = Wire(logic, seed, loss)
    wire.link.heartbeat = True
    for nonce in range(before):
        wire.link.request(fire_one(nonce, DARK, us(100)))
    wire.run(2000)  # all are answered: a pulse asked for while the controller is reset may come once more
    wire.reboot()
    for nonce in range(100, 100 + after):
        # The zero ends what is left of a damaged frame of the link.
        frame = b"\0" + encode(Message(Type.FIRE_ONE, nonce % 256, fire_one(nonce, DARK, us(100)).payload))
        logic.bridge_talk(frame, len(frame), ctypes.create_string_buffer(100), wire.tick)
        wire.run(3)
    wire.loss = 0.0
    wire.run(400)
    cut = next(k for k, item in enumerate(wire.news) if isinstance(item, Restarted))
    assert [item for item in wire.news if isinstance(item, Restarted)] == [Restarted(2)]
    new = [item.event for item in wire.news[cut:] if isinstance(item, EventReceived)]
    assert [e.number for e in new] == list(range(after + 1))
    assert new[0].value == 2
    old = [item.event.number for item in wire.news[:cut] if isinstance(item, EventReceived)]
    assert old == list(range(len(old)))
