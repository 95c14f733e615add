"""The serial protocol of the trigger controller without any port (hw/protocol.md, version 1.4).

A frame is COBS(type, sequence, payload, CRC-16/CCITT-FALSE) and a zero (Cheshire and Baker, 1999). Messages are
little-endian, without padding, in ticks of 0.5 µs; `hw/protocol_vectors.json` has examples. Every request may be
repeated safely, so a lost reply only costs time; a reset shows by the boot counter, and events count from 0 again.
"""

from __future__ import annotations

import binascii
import itertools
import zlib
from collections import deque
from collections.abc import Sequence
from dataclasses import astuple, dataclass, fields
from enum import IntEnum
from struct import Struct
from typing import Any, ClassVar, TypeVar

from vaoi_station.acquisition.controller.interface import BoardOffer, Contacts, Permit
from vaoi_station.errors import DeviceError

PAYLOAD_LONGEST = 58
"""Longest payload, bytes; the firmware's buffers have this size (hw/firmware/logic/link/protocol.h)."""
_CONTENT_LONGEST = 2 + PAYLOAD_LONGEST + 2


@dataclass(frozen=True)
class Message:
    """One message of the host or of the controller: type, sequence number and content."""

    type: int
    sequence: int
    payload: bytes = b""


def encode(message: Message) -> bytes:
    """Return the frame of a message, including its delimiter; ValueError if the payload is too long."""
    if len(message.payload) > PAYLOAD_LONGEST:
        raise ValueError(f"a payload of {len(message.payload)} bytes; {PAYLOAD_LONGEST} is the longest")
    content = bytes([message.type, message.sequence]) + message.payload
    return cobs(content + crc16(content).to_bytes(2, "little")) + b"\0"


def decode(frame: bytes) -> Message | None:
    """Return the message in a frame without its delimiter; None if the frame is damaged."""
    # The length is checked first: the firmware has no longer frames, and noise may be of any length.
    content = uncob(frame) if len(frame) <= _CONTENT_LONGEST + 1 else None
    if content is None or len(content) < 4 or crc16(content[:-2]) != int.from_bytes(content[-2:], "little"):
        return None
    return Message(content[0], content[1], content[2:-2])


class FrameReader:
    """Reader that splits received bytes into messages. After a damaged frame it continues after the next zero byte."""

    def __init__(self) -> None:
        self._bytes = bytearray()
        self.bad = 0

    def feed(self, data: bytes) -> list[Message]:
        """Process received bytes, and return the messages that are complete with them."""
        self._bytes += data
        *frames, rest = self._bytes.split(b"\0")
        # Noise without zeros must not fill the memory. The part that is kept is still too long for a frame.
        self._bytes = rest[: _CONTENT_LONGEST + 2]
        messages = [(frame, decode(bytes(frame))) for frame in frames if frame]
        self.bad += sum(message is None for _, message in messages)
        return [message for _, message in messages if message is not None]


def crc16(data: bytes) -> int:
    """Return the checksum CRC-16/CCITT-FALSE: polynomial 0x1021, start value 0xFFFF, bits not reflected."""
    return binascii.crc_hqx(data, 0xFFFF)


def cobs(content: bytes) -> bytes:
    """Encode at most 253 bytes by COBS, so that the code contains no zero byte."""
    # COBS treats blocks of 254 bytes without a zero in a special way. They cannot occur in such a short content.
    return b"".join(bytes([len(part) + 1]) + part for part in content.split(b"\0"))


def uncob(frame: bytes) -> bytes | None:
    """Decode a COBS frame; return None if it is damaged (a code points beyond its end, or it contains a zero)."""
    parts: list[bytes] = []
    at = 0
    while at < len(frame):
        end = at + frame[at]
        if frame[at] == 0 or end > len(frame):
            return None
        parts.append(frame[at + 1 : end])
        at = end
    return None if b"\0" in frame else b"\0".join(parts)


VERSION = (1, 4)
TICK_S = 0.5e-6
ROW_NONE = 0xFFFF
PERMIT_TEST = 0
"""The permit of READY that sets the output "line ready" without a board, in the state IDLE only."""
REPLY = 0x80


class Type(IntEnum):
    """The types of messages, as the first byte of a message states them."""

    IDENT = 0x01
    STATUS = 0x02
    CLOCK = 0x03
    BEAT = 0x04
    TIMING = 0x05
    STEP = 0x06
    COMMIT = 0x07
    ARM = 0x08
    DISARM = 0x09
    FIRE_ONE = 0x0A
    SAFE = 0x0B
    READ_EVENT = 0x0C
    ACK_EVENTS = 0x0D
    READY = 0x0E
    WIDTH = 0x0F
    OFFER = 0x10
    EVENT = 0xC0
    NAK = 0xFF


class Reason(IntEnum):
    """Why the controller refuses a request: the field `reason` of a NAK message."""

    UNKNOWN = 1
    LENGTH = 2
    RANGE = 3
    LED_LIMIT = 4
    STATE = 5
    CHECKSUM = 6
    LED_BUDGET = 7
    GONE = 8
    UNCONFIGURED = 9


class State(IntEnum):
    """The state of the controller, as the field `state` of a Status message."""

    IDLE = 0
    ARMED = 1
    RUNNING = 2
    SAFE = 3


class Fault(IntEnum):
    """The fault for which the controller went into its safe state."""

    NONE = 0
    HEARTBEAT = 1
    COMMANDED = 2
    GUARD = 3


class Pacing(IntEnum):
    """The quantity that sets the distance of two rows: a time, or a distance of the belt."""

    TIME = 0
    DISTANCE = 1


class Kind(IntEnum):
    """The kinds of events that the controller reports."""

    BOOT = 1
    BARRIER = 2
    PULSE = 3
    SUPPRESSED = 4
    RUN_END = 5
    FAULT = 6
    EDGE = 7
    CONTACTS = 8


class Suppressed(IntEnum):
    """Why the controller did not start a run or did not fire a pulse."""

    BOUNCE = 1
    GAP = 2
    LATE = 3
    LED_BUDGET = 4
    TOO_FAST = 5


class RunEnd(IntEnum):
    """Why the controller ended the pulses of a run: the field `detail` of the event RUN_END."""

    CLEAR = 1
    MAX_ROWS = 2
    DISARMED = 3
    SAFE = 4


class Hold(IntEnum):
    """Why the output "line ready" is low."""

    NONE = 0
    HOST = 1
    STATE = 2
    BARRIER = 3
    GAP = 4
    SPENT = 5


S = TypeVar("S", bound="_Wire")


@dataclass(frozen=True)
class _Wire:
    LAYOUT: ClassVar[Struct]
    GROWS: ClassVar[bool] = False
    """Whether a later minor version of the protocol may append fields to this message."""
    OLDEST_BYTES: ClassVar[int] = 0
    """Size in the oldest minor version that is used, 1.1; fields that are absent there are 0."""

    def pack(self) -> bytes:
        """Return the message as the bytes that are sent."""
        return self.LAYOUT.pack(*astuple(self))

    @classmethod
    def unpack(cls: type[S], payload: bytes) -> S:
        """Read the struct from a payload; ValueError if its size is wrong."""
        if len(payload) >= (cls.OLDEST_BYTES or cls.LAYOUT.size):
            payload = payload.ljust(cls.LAYOUT.size, b"\0")
        if len(payload) < cls.LAYOUT.size or (len(payload) > cls.LAYOUT.size and not cls.GROWS):
            raise ValueError(f"{cls.__name__} has {cls.LAYOUT.size} bytes, not {len(payload)}")
        values: tuple[Any, ...] = cls.LAYOUT.unpack_from(payload)
        return cls(*values)


@dataclass(frozen=True)
class Timing(_Wire):
    """The timing of the rows: delay, period and tail are in ticks, or in counts if the encoder spaces the rows."""

    LAYOUT = Struct("<BBHIIIIIIH")
    pacing: int
    steps: int
    max_rows: int
    start_delay: int
    period: int
    tail: int
    min_period: int
    debounce: int
    min_gap: int
    trigger_width: int


@dataclass(frozen=True)
class Step(_Wire):
    """The light of one row: bit k of `channels` stands for LED channel k, and `width` is its on-time in ticks."""

    LAYOUT = Struct("<BxH")
    channels: int
    width: int


@dataclass(frozen=True)
class Ident(_Wire):
    """The identity of the controller, the versions of its hardware and firmware, and its limits."""

    LAYOUT = Struct("<8BII8s8sHH4HHBBHH")
    GROWS = True
    OLDEST_BYTES = 48
    major: int
    minor: int
    firmware_major: int
    firmware_minor: int
    firmware_patch: int
    channels: int
    program_steps: int
    reset_cause: int
    boots: int
    unit: int
    build: bytes
    board: bytes
    tick_ns: int
    led_shortest: int
    led_longest_0: int
    led_longest_1: int
    led_longest_2: int
    led_longest_3: int
    led_bucket: int
    led_duty_shift: int
    heartbeat_s: int
    ready_longest_ms: int = 0
    """How long one READY keeps the output "line ready" high at most; 0 before 1.2, which has no such output."""
    trigger_longest: int = 0
    """Longest width of the trigger by which a step can set the exposure, in ticks; 0 before 1.3, which has no WIDTH."""

    @property
    def firmware(self) -> str:
        """The version of the firmware."""
        return f"{self.firmware_major}.{self.firmware_minor}.{self.firmware_patch}"

    @property
    def led_longest(self) -> tuple[int, ...]:
        """Longest on-time of each LED channel, ticks."""
        return self.led_longest_0, self.led_longest_1, self.led_longest_2, self.led_longest_3


@dataclass(frozen=True)
class Status(_Wire):
    """The state of the controller, sent in reply to STATUS and BEAT."""

    LAYOUT = Struct("<4BHH6I6HBBHBxH")
    GROWS = True
    OLDEST_BYTES = 44
    state: int
    fault: int
    reset_cause: int
    blocked: int
    run: int
    row: int
    tick: int
    boots: int
    config_crc: int
    events_next: int
    events_first: int
    position: int
    events_lost: int
    bad_frames: int
    unknown: int
    replies_lost: int
    bytes_lost: int
    edges_lost: int
    ready: int = 0
    hold: int = Hold.NONE
    permit: int = 0
    contacts: int = 0
    taken: int = 0

    @property
    def closed(self) -> Contacts:
        """The contacts of the neighbours that are closed."""
        return contacts_of(self.contacts, self.taken)


@dataclass(frozen=True)
class Event(_Wire):
    """An event of the controller. hw/protocol.md defines `detail`, `index` and `value` for each kind of event."""

    LAYOUT = Struct("<IIBBHI")
    number: int
    tick: int
    kind: int
    detail: int
    index: int
    value: int

    @property
    def on_ticks(self) -> int:
        """On-time of the LEDs that a PULSE states."""
        return self.value & 0xFFFF

    @property
    def width_ticks(self) -> int:
        """Width of the trigger that a PULSE states if its step has one of its own; otherwise 0."""
        return self.value >> 16


@dataclass(frozen=True)
class ClockReply(_Wire):
    """The tick that the controller's counter showed when it replied to CLOCK."""

    LAYOUT = Struct("<II")
    nonce: int
    tick: int


@dataclass(frozen=True)
class Nak(_Wire):
    """A refusal: type of the refused request, why it was refused, number of the field, and nearest allowed value."""

    LAYOUT = Struct("<BBBxI")
    request: int
    reason: int
    field: int
    limit: int


@dataclass(frozen=True)
class Request:
    """A request of the host that has no sequence number yet."""

    type: Type
    payload: bytes = b""


def set_step(index: int, step: Step) -> Request:
    """Return the request that sets step number `index` of the light program."""
    return Request(Type.STEP, bytes([index]) + step.pack())


def set_width(index: int, width: int) -> Request:
    """Return the request that sets the trigger's width of step number `index`, in ticks."""
    return Request(Type.WIDTH, bytes([index, 0]) + width.to_bytes(2, "little"))


def number_request(kind: Type, number: int) -> Request:
    """Return a request whose content is one number: CLOCK, COMMIT, READ_EVENT or ACK_EVENTS."""
    return Request(kind, number.to_bytes(4, "little"))


def arm(run: int, config_crc: int) -> Request:
    """Return the request to arm. The controller refuses it if its configuration has another checksum."""
    return Request(Type.ARM, run.to_bytes(2, "little") + config_crc.to_bytes(4, "little"))


def fire_one(nonce: int, step: Step, trigger_width: int) -> Request:
    """Return the request for one pulse without a row; the controller fires once for each value of `nonce`."""
    return Request(Type.FIRE_ONE, nonce.to_bytes(2, "little") + step.pack() + trigger_width.to_bytes(2, "little"))


def ready(permit: int, hold_ms: int) -> Request:
    """Return the request that permits one board for a time; `hold_ms` 0 withdraws the permit."""
    return Request(Type.READY, permit.to_bytes(2, "little") + hold_ms.to_bytes(2, "little"))


MOST_OFFER_MS = 0xFFFF
"""Longest time until a board counts as taken, ms."""


OFFER_MINOR = 4
"""The minor version that added OFFER."""


def contacts_of(bits: int, taken: int) -> Contacts:
    """Return the contacts by the bits of STATUS and of the event CONTACTS."""
    available, failed, next_ready, offered, offered_failed = (bool(bits >> k & 1) for k in (0, 1, 2, 4, 5))
    return Contacts(available, failed, next_ready, offered, offered_failed, taken)


def offer(offered: BoardOffer | None, hold_ms: int) -> Request:
    """Return the request that offers a board to the next machine by contacts; `hold_ms` 0 withdraws the offer."""
    if offered is None:
        return Request(Type.OFFER, bytes(10))
    times_ms = (min(round(time_s * 1e3), MOST_OFFER_MS) for time_s in offered.exit_s)
    contacts = 0x20 if offered.failed else 0x10
    return Request(Type.OFFER, Struct("<HHBxHH").pack(offered.number, hold_ms, contacts, *times_ms))


def config_crc(timing: Timing, steps: Sequence[Step], widths: Sequence[int] = ()) -> int:
    """Return the checksum (CRC-32 as in zlib) of a configuration, computed from the bytes that are sent."""
    own = widths if any(width != timing.trigger_width for width in widths) else ()
    parts = (step.pack() for step in steps), (width.to_bytes(2, "little") for width in own)
    return zlib.crc32(b"".join([timing.pack(), *parts[0], *parts[1]]))


def configuration(timing: Timing, steps: Sequence[Step], widths: Sequence[int] = ()) -> list[Request]:
    """Return all requests that set and activate a configuration, with the arguments of `config_crc`."""
    own = [set_width(k, width) for k, width in enumerate(widths) if width != timing.trigger_width]
    # COMMIT comes last: until then, the firmware keeps its old configuration, so that an incomplete one has no effect.
    return [
        Request(Type.TIMING, timing.pack()),
        *(set_step(k, step) for k, step in enumerate(steps)),
        *own,  # after TIMING, which sets the widths of all steps
        number_request(Type.COMMIT, config_crc(timing, steps, widths)),
    ]


class EventOrder:
    """Passes on each numbered event of one boot of the controller once, and in order."""

    def __init__(self) -> None:
        self.next_number = 0
        self._early: dict[int, Event] = {}
        self._announced = 0

    def add(self, event: Event) -> list[Event]:
        """Add an event, and return the events that can be passed on now, in order."""
        if event.number >= self.next_number:
            self._early[event.number] = event
            self.announce(event.number + 1)
        return self._release()

    def announce(self, count: int) -> None:
        """Record that the controller has numbered `count` events so far, so that lost events are noticed."""
        self._announced = max(self._announced, count)

    def missing(self) -> int | None:
        """Return the number of the next event if it was lost and must be read again; None if no event is missing."""
        return self.next_number if self.next_number < self._announced else None

    def skip_to(self, number: int) -> tuple[int, list[Event]]:
        """Give up the missing events before `number`. Return their count, and the events that can be passed on now."""
        lost = sum(k not in self._early for k in range(self.next_number, number))
        # Events that arrived early are not lost: they are passed on before those that follow the gap.
        waiting = [self._early.pop(k) for k in sorted(self._early) if k < number]
        self.next_number = max(self.next_number, number)
        return lost, waiting + self._release()

    def _release(self) -> list[Event]:
        events: list[Event] = []
        while self.next_number in self._early:
            events.append(self._early.pop(self.next_number))
            self.next_number += 1
        return events


BOARD = b"m328p16"
OLDEST_FIRMWARE, OLDEST_MINOR = (1, 1, 0), 1
_FLASH = "Write the firmware that came with this station: make -C hw/firmware flash."
FIRST_STEP = 16
"""Fields of a refused COMMIT from this number on are steps; those before are the fields of `Timing`."""


def check_ident(payload: bytes) -> Ident:
    """Read the reply to IDENT. Raise DeviceError for any other device, and for firmware that is too old."""
    # The first two bytes are the protocol's version in every version of the protocol; the rest may differ.
    if payload[:1] != bytes([VERSION[0]]):
        spoken = ".".join(str(number) for number in payload[:2])
        raise DeviceError(
            f"The controller speaks protocol {spoken}, this station {VERSION[0]}.{VERSION[1]}.",
            action=_FLASH,
            code="protocol-version",
        )
    ident = Ident.unpack(payload)
    board = ident.board.rstrip(b"\0")
    if board != BOARD:
        raise DeviceError(
            f"The device on the controller's port calls itself {board!r}, but must be {BOARD!r}.",
            action="Check which device the port leads to.",
            code="foreign-device",
        )
    firmware = (ident.firmware_major, ident.firmware_minor, ident.firmware_patch)
    if firmware < OLDEST_FIRMWARE or ident.minor < OLDEST_MINOR:
        raise DeviceError(
            f"The controller has firmware {ident.firmware} with protocol {ident.major}.{ident.minor}, but needs "
            "1.1.0 with 1.1 at least.",
            action=_FLASH,
            code="firmware-too-old",
        )
    return ident


def check_interlock(ident: Ident) -> None:
    """Raise DeviceError if the firmware has no output "line ready"."""
    if not ident.ready_longest_ms:
        raise DeviceError(
            f"The controller has firmware {ident.firmware}, which has no output 'line ready', but [controller] "
            'interlock in station.toml is "on".',
            action=f'{_FLASH} Or set interlock = "off", and hold boards back by another way.',
            code="interlock-missing",
        )


def check_contacts(ident: Ident) -> None:
    """Raise DeviceError if the firmware has no contacts of neighbours but "line ready"."""
    if ident.minor < OFFER_MINOR:
        raise DeviceError(
            f"The controller has firmware {ident.firmware}, which has no contacts for IPC-SMEMA-9851 but 'line ready', "
            "but station.toml has a table [smema].",
            action=f"{_FLASH} Or take [smema] out of station.toml.",
            code="contacts-missing",
        )


def describe(nak: Nak) -> str:
    """Return a sentence that states why the controller refused a request, with the field and its limit."""
    request = Type(nak.request).name if nak.request in set(Type) else f"request {nak.request:#04x}"
    texts = {
        Reason.UNKNOWN: "this firmware does not know it",
        Reason.LENGTH: f"its payload must have {nak.limit} bytes",
        Reason.RANGE: f"{_field(nak)} is out of range, the nearest allowed value is {nak.limit}",
        Reason.LED_LIMIT: f"{_field(nak)} asks more of the LEDs than their limit of {nak.limit} ticks",
        Reason.STATE: f"the controller is {State(nak.limit).name if nak.limit in set(State) else nak.limit}",
        Reason.CHECKSUM: f"the checksum of the controller's configuration is {nak.limit:#010x}",
        Reason.LED_BUDGET: f"the LEDs of channel {nak.field} have not cooled down",
        Reason.GONE: f"the oldest event it still has is number {nak.limit}",
        Reason.UNCONFIGURED: "it has no configuration since its reset",
    }
    return f"{request} was refused: {texts.get(Reason(nak.reason)) if nak.reason in set(Reason) else nak.reason}."


def _field(nak: Nak) -> str:
    if nak.request == Type.COMMIT:
        names_of_timing = [field.name for field in fields(Timing)]
        return f"step {nak.field - FIRST_STEP}" if nak.field >= FIRST_STEP else names_of_timing[nak.field % 10]
    # Only COMMIT numbers its fields; other requests have one value that can be out of range.
    names: dict[int, str] = {
        Type.STEP: "its index",
        Type.FIRE_ONE: "its pulse",
        Type.READY: "its time",
        Type.OFFER: "its value",
    }
    return names.get(nak.request, f"field {nak.field}")


RETRY_S = 0.1
"""Time without a reply after which a request is sent again."""
MAX_TRIES = 10
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
    """A request, also one of the link itself, without a known outcome: no reply came, or the controller was reset."""

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

    def __init__(self, *, heartbeat: bool = False) -> None:
        self.heartbeat = heartbeat
        self.permit: Permit | None = None
        """Permission for the next board, renewed while it is valid; None: boards are held back."""
        self.ready_longest_ms = 0
        """Longest time, ms, for which one READY is valid. 0 without an output "line ready": READY is not sent."""
        self.offer: BoardOffer | None = None
        """The board that is offered to the next machine by contacts, renewed while it is valid; None: none is."""
        self.contacts = False
        """Whether contacts of the neighbours are used. Else OFFER is not sent, and the controller reports none."""
        self.retries = 0
        self.unmatched = 0
        self.messages = 0
        self.boots: int | None = None
        self.status: Status | None = None
        self._reader = FrameReader()
        self._sequences = itertools.cycle(range(256))
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
        self._next_offer_s = 0.0
        self._stated_offer: tuple[int, bool] | None = None
        """Number of the board that the controller offers, 0 for none, and whether as failed; None: it is to be sent."""
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
            elif self._pending.request.type == Type.OFFER:
                request = offer(self.offer, self._left_ms(self.offer, now_s))
                self._pending.request, self._pending.sequence = request, next(self._sequences)
        self._pending.last_s = now_s
        self._pending.tries += 1
        return encode(Message(self._pending.request.type, self._pending.sequence, self._pending.request.payload))

    def receive(self, data: bytes, now_s: float, begun_s: float | None = None) -> list[Notification]:
        """Process received bytes. It is also called without bytes, so that missing replies are noticed."""
        news = [item for message in self._reader.feed(data) for item in self._on_message(message, now_s)]
        pending, listened_s = self._pending, now_s if begun_s is None else begun_s
        if pending is not None and pending.tries >= MAX_TRIES and listened_s - pending.last_s >= RETRY_S:
            self._pending = None
            self._yielding = pending.internal
            news.append(Unanswered(pending.request))
        return news

    def _next_request(self, now_s: float) -> _Pending | None:
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
        # First of all the permit: a board that must not come is held back at once.
        if self._ready_is_due(now_s):
            self._next_ready_s = now_s + HEARTBEAT_S
            return _Pending(self._ready_request(now_s), internal=True)
        if self._offer_is_due(now_s):
            self._next_offer_s = now_s + HEARTBEAT_S
            return _Pending(offer(self.offer, self._left_ms(self.offer, now_s)), internal=True)
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
        return self._left_ms(self.permit, now_s)

    def _left_ms(self, given: Permit | BoardOffer | None, now_s: float) -> int:
        left_s = 0.0 if given is None else given.until_s - now_s
        return min(max(int(left_s * 1e3), 0), self.ready_longest_ms)

    def _wanted_offer(self, now_s: float) -> tuple[int, bool]:
        valid = self.offer is not None and self._left_ms(self.offer, now_s) > 0
        return (self.offer.number, self.offer.failed) if valid and self.offer is not None else (0, False)

    def _offer_is_due(self, now_s: float) -> bool:
        if not self.contacts:
            return False
        wanted = self._wanted_offer(now_s)
        return wanted != self._stated_offer or (wanted[0] > 0 and now_s >= self._next_offer_s)

    def _ready_request(self, now_s: float) -> Request:
        if self.permit is not None:
            self._permit_number = self.permit.number
        return ready(self._permit_number, self._hold_ms(now_s))

    def _ready_is_due(self, now_s: float) -> bool:
        if not self.ready_longest_ms:
            return False
        valid = self.permit.number if self.permit is not None and self._hold_ms(now_s) > 0 else None
        return valid != self._stated or (valid is not None and now_s >= self._next_ready_s)

    def _on_message(self, message: Message, now_s: float) -> list[Notification]:
        self.messages += 1
        if message.type == Type.EVENT:
            return self._on_event(message)
        pending = self._pending
        if pending is None or message.sequence != pending.sequence:
            self.unmatched += 1
            return []
        try:
            if message.type == Type.NAK:
                news = self._on_refusal(pending, Nak.unpack(message.payload))
            elif message.type == pending.request.type | REPLY:
                news = self._on_reply(pending, message.payload, now_s)
            else:
                raise ValueError("a reply to another request")
        except ValueError:  # or its checksum was right by chance; the request stays pending and is repeated
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

    def _on_reply(self, pending: _Pending, payload: bytes, now_s: float) -> list[Notification]:
        news: list[Notification] = []
        if pending.request.type in (Type.STATUS, Type.BEAT, Type.READY, Type.OFFER):
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
        """Record what READY or OFFER has stated, even if it was refused: it is then repeated only at renewals."""
        if request.type == Type.READY:
            number, hold_ms = request.payload[:2], request.payload[2:]
            self._stated = int.from_bytes(number, "little") if any(hold_ms) else None
        elif request.type == Type.OFFER:
            valid = any(request.payload[2:4])
            number = request.payload[:2] if valid else b"\0"
            self._stated_offer = int.from_bytes(number, "little"), valid and bool(request.payload[4] & 0x20)

    def _on_boot_count(self, boots: int) -> list[Notification]:
        """Compare the boot counter with the last one. After a reset, return all queued requests as unanswered."""
        if self.boots == boots:
            return []
        # Queued requests were meant for the configuration before the reset. Their callers decide what to do.
        first, self.boots = self.boots is None, boots
        self._order, self._acknowledged, self._stated, self._stated_offer = EventOrder(), 0, None, None
        if first:
            return []
        dropped = [a.request for a in self._queue if not a.internal]
        self._queue.clear()
        return [Restarted(boots), *(Unanswered(request) for request in dropped)]
