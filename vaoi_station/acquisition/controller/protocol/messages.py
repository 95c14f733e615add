"""The binary messages of the protocol, version 1.3: little-endian, without padding, in ticks of 0.5 µs.

`hw/firmware/logic/link/protocol.h` defines the same structs in C. `hw/protocol_vectors.json` has examples that both
must encode to the same bytes.
"""

from __future__ import annotations

import zlib
from collections.abc import Sequence
from dataclasses import astuple, dataclass
from enum import IntEnum
from struct import Struct
from typing import Any, ClassVar, TypeVar

VERSION = (1, 3)
TICK_S = 0.5e-6
ROW_NONE = 0xFFFF
"""Index of a pulse that belongs to no row."""
PERMIT_TEST = 0
"""The permit of READY that sets the output "line ready" without a board, in the state IDLE only."""
REPLY = 0x80
"""Number that is added to the type of a request to get the type of its reply."""


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
    """Base class of the protocol's messages. It converts them to bytes and back."""

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
    """The timing of the rows. Delay, period and tail are in ticks or, if the belt sets the spacing, in encoder
    counts."""

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


@dataclass(frozen=True)
class Status(_Wire):
    """The state of the controller, sent in reply to STATUS and BEAT."""

    LAYOUT = Struct("<4BHH6I6HBBH")
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
    """Level of the output "line ready"."""
    hold: int = Hold.NONE
    permit: int = 0


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
    """Return the request for one pulse that belongs to no row.

    The controller fires once for each value of `nonce`, even if the request is repeated.
    """
    return Request(Type.FIRE_ONE, nonce.to_bytes(2, "little") + step.pack() + trigger_width.to_bytes(2, "little"))


def ready(permit: int, hold_ms: int) -> Request:
    """Return the request that permits one board for a time; `hold_ms` 0 withdraws the permit."""
    return Request(Type.READY, permit.to_bytes(2, "little") + hold_ms.to_bytes(2, "little"))


def config_crc(timing: Timing, steps: Sequence[Step], widths: Sequence[int] = ()) -> int:
    """Return the checksum (CRC-32 as in zlib) of a configuration, computed from the bytes that are sent.

    Args:
        timing: the timing.
        steps: the steps that it uses.
        widths: the trigger's width of each step, ticks; empty if all have that of the timing.
    """
    own = widths if any(width != timing.trigger_width for width in widths) else ()
    parts = (step.pack() for step in steps), (width.to_bytes(2, "little") for width in own)
    return zlib.crc32(b"".join([timing.pack(), *parts[0], *parts[1]]))


def configuration(timing: Timing, steps: Sequence[Step], widths: Sequence[int] = ()) -> list[Request]:
    """Return all requests that set and activate a configuration, with the arguments of `config_crc`.

    Raises:
        ValueError: there are too many or too few steps or widths.
    """
    if timing.steps != len(steps):
        raise ValueError(f"timing.steps is {timing.steps}, but there are {len(steps)} steps")
    if len(widths) not in (0, len(steps)):
        raise ValueError(f"there are {len(widths)} widths, but {len(steps)} steps")
    own = [set_width(k, width) for k, width in enumerate(widths) if width != timing.trigger_width]
    # COMMIT comes last: until then, the firmware keeps its old configuration, so that an incomplete one has no effect.
    return [
        Request(Type.TIMING, timing.pack()),
        *(set_step(k, step) for k, step in enumerate(steps)),
        *own,  # after TIMING, which sets the widths of all steps
        number_request(Type.COMMIT, config_crc(timing, steps, widths)),
    ]
