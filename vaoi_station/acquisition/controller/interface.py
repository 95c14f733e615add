"""The interface of the trigger controller, which alone works in real time: the host may receive its events late."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from queue import SimpleQueue
from typing import NamedTuple, Protocol

from vaoi_station.acquisition.cameras.interface import DeviceFault
from vaoi_station.acquisition.clocks import ClockReading
from vaoi_station.line_config import Line
from vaoi_station.model import ProgramRow
from vaoi_station.supervised_thread import SupervisedThread

SLOWEST = 4.0
"""A belt whose way spaces the rows may need this many times its nominal time for a run."""
LEAST_GRACE_S, GRACE_SHARE = 8.0, 1.25
"""A board is filmed for this time after a Disarm, or for this share of the longest board's time if that is longer."""


@dataclass(frozen=True)
class BeltPacing:
    """Rows at equal distances of the belt: the distances of a plan in counts of the encoder."""

    counts_per_mm: float
    start: int
    """From the edge of the barrier to the count of row 0, which is fired `ENCODER_LATENCY_S` after it."""
    row: int
    tail: int
    shortest_s: float
    """Rows that the encoder asks for sooner than this after the row before are not fired."""

    @classmethod
    def of(cls, line: Line) -> BeltPacing | None:
        """Return the distances of a line; None if the controller's clock spaces its rows."""
        if not line.by_encoder or line.encoder is None:
            return None
        return cls(line.encoder.counts_per_mm, *line.encoder_places, line.shortest_period_s)

    @property
    def row_mm(self) -> float:
        """Distance of the belt between two rows."""
        return self.row / self.counts_per_mm


@dataclass(frozen=True)
class TriggerPlan:
    """The timing of one run, counted from the edge of the barrier. It does not change while the line is armed."""

    start_delay_s: float
    period_s: float
    tail_s: float
    max_rows: int
    debounce_s: float
    lights: Sequence[str] = ()
    """Names of the light patterns, which the rows use in turn. Empty: every row has the same light."""
    program: tuple[ProgramRow, ...] = ()
    """What the rows are filmed with, in turn. Empty: as station.toml states for lights and cameras."""

    by_trigger: tuple[int, ...] = ()
    """Cameras that expose for as long as the trigger is high, in each row for `trigger_us` of the program."""
    conveyor_mm_s: tuple[float, float] | None = None
    belt: BeltPacing | None = None
    """Distances of the rows if the encoder spaces them; the times above are then those at the nominal speed."""

    @property
    def shortest_period_s(self) -> float:
        """Shortest time between two rows."""
        return self.period_s if self.belt is None else self.belt.shortest_s

    @property
    def shortest_start_s(self) -> float:
        """Shortest time from the edge of the barrier to the first row."""
        return self.start_delay_s * self.shortest_period_s / self.period_s

    @property
    def longest_period_s(self) -> float:
        """Mean time between two rows on the slowest belt for which the end of a run is awaited."""
        return self.period_s if self.belt is None else SLOWEST * self.period_s

    @property
    def grace_s(self) -> float:
        """Longest time for which a board is still filmed after a Disarm. A board that takes longer has stopped."""
        return max(LEAST_GRACE_S, GRACE_SHARE * (self.start_delay_s + self.max_rows * self.period_s))

    @property
    def row_mm(self) -> float | None:
        """Distance of the rows by the encoder; None if the controller's clock spaces them."""
        return None if self.belt is None else self.belt.row_mm

    @classmethod
    def of(cls, line: Line, lights: Sequence[str] = (), program: tuple[ProgramRow, ...] = ()) -> TriggerPlan:
        """Return the plan that follows from the mechanics of a line; a program gives the lights."""
        return cls(
            start_delay_s=line.start_delay_s,
            period_s=line.trigger_period_s,
            tail_s=line.tail_s,
            max_rows=line.rows_of_longest_board,
            debounce_s=line.debounce_s,
            lights=tuple(row.light for row in program) or lights,
            program=program,
            conveyor_mm_s=line.conveyor_mm_s,
            belt=BeltPacing.of(line),
        )


@dataclass(frozen=True)
class FirmwareLimits:
    """The limits of a controller's firmware for a light program, µs."""

    version: str
    steps: int
    channels: int
    shortest_us: float
    longest_us: tuple[float, ...]
    share: int
    """LEDs are on for at most the period divided by this number."""
    widest_us: float
    """Longest width of the trigger that a row may have; 0: all rows have the same width."""


@dataclass(frozen=True)
class ControllerLimits:
    """What a controller can do with a light program."""

    lights: tuple[str, ...] | None = None
    """Names of the lights that it has; None: those of station.toml."""
    firmware: FirmwareLimits | None = None


@dataclass(frozen=True)
class Permit:
    """The station's permission for one board to come, for the output "line ready". A board that comes uses it up."""

    number: int
    until_s: float
    """time.monotonic() until which it is valid; the station renews it before."""


@dataclass(frozen=True)
class LineOutput:
    """The output "line ready" as the controller last reported it, and in words why it is low."""

    high: bool
    why: str = ""


@dataclass(frozen=True)
class BoardOffer:
    """A board behind the cameras that the contacts to the next machine offer, until the controller says it is taken."""

    number: int
    """Another one for each board, from 1 to 65535."""
    failed: bool
    """Whether "failed board available" closes, and not "board available"."""
    until_s: float
    """time.monotonic() until which it is valid; the station renews it before."""
    exit_s: tuple[float, float]
    """Shortest and longest time in which the board leaves; a machine that is not ready any more sooner has none."""


class Contacts(NamedTuple):
    """The contacts of the neighbours by IPC-SMEMA-9851; True: closed."""

    available: bool = False
    """The machine upstream has a board."""
    failed: bool = False
    """The machine upstream has a failed board."""
    next_ready: bool = False
    """The next machine takes a board."""
    offered: bool = False
    """A board is offered to the next machine."""
    offered_failed: bool = False
    """A failed board is offered to the next machine."""
    taken: int = 0
    """Number of the board that the next machine has taken last; 0: none since the controller's start."""

    @property
    def closed(self) -> str:
        """The contacts that are closed, in words."""
        offers = "board offered", "failed board offered"
        names = "board available", "failed board available", "next machine ready", *offers
        return ", ".join(name for name, is_closed in zip(names, self, strict=False) if is_closed) or "none"


@dataclass(frozen=True)
class ControllerEvent:
    """An event of the controller, numbered from 0 without gaps; `time_s` is the controller's own time."""

    number: int
    time_s: float


@dataclass(frozen=True)
class BarrierEdge(ControllerEvent):
    """A confirmed edge of the barrier."""

    counts: int | None = None
    """Position of the encoder at the edge, modulo 2³²; None if the backend does not report it."""


@dataclass(frozen=True)
class BarrierBlocked(BarrierEdge):
    """A board that reached the barrier; a run begins."""


@dataclass(frozen=True)
class BarrierClear(BarrierEdge):
    """A board that has left the barrier. The controller fires on until the tail time has passed."""


@dataclass(frozen=True)
class BarrierBlockedAgain(BarrierEdge):
    """An interruption within the tail of a run, by a cut-out of the board or by another board. The run continues."""


@dataclass(frozen=True)
class BarrierClearAfterRun(BarrierEdge):
    """The end of an interruption outside a run: of a board that was refused, that stood in the barrier when the line
    was armed, or whose run had ended."""


@dataclass(frozen=True)
class ContactsChanged(ControllerEvent):
    """A change of a contact, or the levels at the time from which on changes are reported."""

    contacts: Contacts


@dataclass(frozen=True)
class BoardTooSoon(ControllerEvent):
    """A board that was not filmed because it came too early: `gap_s` after the previous board had left."""

    gap_s: float


@dataclass(frozen=True)
class BarrierBounce(ControllerEvent):
    """An interruption of the barrier that was ignored, because it was too short for a board."""

    duration_s: float


@dataclass(frozen=True)
class PulseFired(ControllerEvent):
    """A trigger pulse for all cameras and LEDs; `time_s` is its rising edge."""

    index: int
    light: str = ""
    exposures_us: tuple[float, ...] = ()
    gains: tuple[float, ...] = ()
    on_us: float | None = None
    trigger_us: float | None = None


@dataclass(frozen=True)
class PulseSkipped(ControllerEvent):
    """A row whose pulse was due but was not fired. `time_s` is the time at which the pulse was due."""

    index: int
    reason: str


@dataclass(frozen=True)
class RunEnded(ControllerEvent):
    """The end of a run, after its last pulse."""

    pulses: int
    reason: str
    """"clear" (board left, tail over), "max-rows" (more rows were due than allowed), "disarmed", "single"
    (requested by `fire_one`), or a sentence on the failure of the controller."""


EventQueue = SimpleQueue[ControllerEvent | DeviceFault | ClockReading]
"""The queue of a controller's reports. A `ClockReading` in it is a reading of the controller's own clock."""


class Controller(Protocol):
    """A trigger controller. Once armed, it films one board after another until it is disarmed."""

    def start(self, events: EventQueue) -> None:
        """Begin to put events into the queue; after a jump of the clock, readings come before the first new event."""

    def arm(self, plan: TriggerPlan) -> None:
        """Film every board that passes the barrier from now on with this plan."""

    def disarm(self) -> None:
        """Ignore the barrier from now on; end a run under way. All events, also RunEnded, are reported on return."""

    def fire_one(self, light: str = "", on_us: float | None = None) -> None:
        """Trigger all cameras and LEDs once, now: a run of one pulse, which ends with the reason "single".

        The light is the one of this name, lit for `on_us`; without them the first one of station.toml, as it states.
        StateError: the controller is armed, or cannot fire by itself. InputError: the light is unknown, or beyond the
        limits of the firmware.
        """

    def read_clock(self) -> ClockReading:
        """Compare the controller's clock with the host's; called from a separate thread because it may take time."""

    def permit_board(self, permit: Permit | None) -> None:  # noqa: ARG002
        """Let the output "line ready" permit one board, if it would be filmed; None holds boards back. At once."""
        return

    def line_output(self) -> LineOutput | None:
        """Return the state of the output "line ready"; None if there is none. Does not wait for the device."""
        return None

    def offer_board(self, offer: BoardOffer | None) -> None:  # noqa: ARG002
        """Offer a board to the next machine by contacts; None opens them. At once."""
        return

    def contacts(self) -> Contacts | None:
        """Return the contacts of the neighbours; None if they are not used. Does not wait for the device."""
        return None

    def barrier_blocked(self) -> bool | None:
        """Return whether the barrier is interrupted; None if that is not known. Does not wait for the device."""
        return None

    def is_watching(self) -> bool:
        """Return whether the controller replies, and fires for boards when armed. Does not wait for the device."""
        return True

    def limits(self) -> ControllerLimits:
        """Return what the controller can do with a light program, without waiting for the device."""
        return ControllerLimits()

    def health(self) -> str:
        """Return a sentence that describes the controller's state, without waiting for the device."""

    def threads(self) -> tuple[SupervisedThread, ...]:
        """Return the threads of the controller, which must neither end nor hang while it is open."""

    def close(self) -> None:
        """Switch all outputs off and close the port."""
