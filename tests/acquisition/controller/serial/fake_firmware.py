"""A trigger controller in Python behind a pseudo terminal: it keeps the protocol, without timing or pulses."""

from __future__ import annotations

import os
import select
import threading
import tty
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace

from tests.hw.emulated.vectors import IDENT
from vaoi_station.acquisition.controller.protocol import (
    REPLY,
    ROW_NONE,
    ClockReply,
    Event,
    FrameReader,
    Hold,
    Kind,
    Message,
    Nak,
    Reason,
    State,
    Status,
    Step,
    Timing,
    Type,
    config_crc,
    encode,
)


class FakeFirmware:
    """The controller's state and its replies; a thread serves the terminal until it is stopped."""

    def __init__(self, terminal: int) -> None:
        self.lock = threading.RLock()
        self.state, self.run, self.crc, self.boots = State.IDLE, 0, 0, 1
        self.mute = False
        """Whether requests are ignored, until `reply_late`."""
        self._ignored: list[Message] = []
        self.refuse: dict[Type, Nak] = {}
        """Requests that are refused, and how."""
        self.requests: list[Type] = []
        self.permits: list[bytes] = []
        """Payloads of READY."""
        self.ident = IDENT
        self._events: list[Event] = []
        self._timing, self._steps, self._widths = Timing.unpack(bytes(30)), [Step(0, 0)] * 16, [0] * 16
        self._tick = 0
        self._terminal, self._reader = terminal, FrameReader()

    def reset(self, cause: int = 2) -> None:
        """As by the reset line: the configuration is lost, and events count from 0."""
        with self.lock:
            self.state, self.crc, self._events, self._tick = State.IDLE, 0, [], 0
            self.boots += 1
            self.cause = cause

    cause = 1

    def emit(self, kind: Kind, detail: int = 0, index: int = 0, value: int = 0) -> None:
        """An event, sent at once without a request."""
        with self.lock:
            event = Event(len(self._events), self._tick, kind, detail, index, value)
            self._events.append(event)
            os.write(self._terminal, encode(Message(Type.EVENT, self.boots % 256, event.pack())))

    def receive(self, data: bytes) -> None:
        """Reply to every complete request."""
        with self.lock:
            for message in self._reader.feed(data):
                self._tick += 2000
                self.requests.append(Type(message.type))
                if self.mute:
                    self._ignored.append(message)
                else:
                    self._send_reply(message)

    def reply_late(self) -> None:
        """Reply to the newest request that was ignored, and to all requests from now on."""
        with self.lock:
            self.mute = False
            self._send_reply(self._ignored[-1])

    def in_state(self, state: State) -> bool:
        return self.state is state

    def _send_reply(self, message: Message) -> None:
        reply = self._reply(message)
        kind = Type.NAK if isinstance(reply, Nak) else message.type | REPLY
        payload = reply.pack() if isinstance(reply, Nak) else reply
        os.write(self._terminal, encode(Message(kind, message.sequence, payload)))

    def _reply(self, message: Message) -> bytes | Nak:
        kind, payload = Type(message.type), message.payload
        if kind in self.refuse:
            return self.refuse[kind]
        if kind == Type.ARM and self.state != State.IDLE:
            return Nak(kind, Reason.STATE, 0, self.state)
        reply = b""
        match kind:
            case Type.IDENT:
                reply = replace(self.ident, boots=self.boots, reset_cause=self.cause).pack()
            case Type.STATUS | Type.BEAT | Type.READY:
                self.permits += [payload] if kind == Type.READY else []
                reply = self._status()
            case Type.CLOCK:
                reply = ClockReply(int.from_bytes(payload, "little"), self._tick).pack()
            case Type.TIMING | Type.STEP | Type.WIDTH | Type.COMMIT:
                reply = self._configure(kind, payload)
            case Type.ARM:
                self.state, self.run = State.ARMED, int.from_bytes(payload[:2], "little")
            case Type.DISARM:
                self.state = State.IDLE
            case Type.FIRE_ONE:
                self.emit(Kind.PULSE, payload[2], ROW_NONE, int.from_bytes(payload[4:6], "little"))
            case Type.READ_EVENT:
                reply = self._events[int.from_bytes(payload, "little")].pack()
        return reply

    def _configure(self, kind: Type, payload: bytes) -> bytes:
        if kind == Type.TIMING:
            self._timing = Timing.unpack(payload)
            self._widths = [self._timing.trigger_width] * 16
        elif kind == Type.STEP:
            self._steps[payload[0]] = Step.unpack(payload[1:])
        elif kind == Type.WIDTH:
            self._widths[payload[0]] = int.from_bytes(payload[2:], "little")
        else:
            used = slice(self._timing.steps)
            self.crc = config_crc(self._timing, self._steps[used], self._widths[used])
            return payload
        return b""

    def _is_high(self) -> bool:
        test, held = (not any(p) for p in (self.permits[-1][:2], self.permits[-1][2:])) if self.permits else (0, 1)
        return not held and self.state is (State.IDLE if test else State.ARMED)

    def _status(self) -> bytes:
        return replace(
            Status.unpack(bytes(44)),
            ready=self._is_high(),
            hold=Hold.STATE if self.state is not State.ARMED else Hold.HOST,
            state=self.state,
            run=self.run,
            boots=self.boots,
            config_crc=self.crc,
            events_next=len(self._events),
        ).pack()


@contextmanager
def fake_firmware() -> Iterator[tuple[str, FakeFirmware]]:
    """The name of a terminal, and the controller behind it."""
    ours, theirs = os.openpty()
    tty.setraw(theirs)
    end, stop = os.pipe()
    firmware = FakeFirmware(ours)

    def serve() -> None:
        while end not in (ready := select.select([ours, end], [], [])[0]):
            if ours in ready:
                firmware.receive(os.read(ours, 4096))

    thread = threading.Thread(target=serve)
    thread.start()
    try:
        yield os.ttyname(theirs), firmware
    finally:
        os.close(stop)
        thread.join()
        for handle in (ours, theirs, end):
            os.close(handle)
