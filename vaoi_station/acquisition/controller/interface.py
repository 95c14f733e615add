"""What the recorder asks of the controller: arm, pulses with index and time, barrier events, stop.

Real time belongs to the controller: once armed it watches the barrier and fires cameras and LEDs by
itself; the host learns of it by events and may be late.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from queue import SimpleQueue
from typing import Protocol

from vaoi_station.acquisition.cameras.interface import DeviceFault
from vaoi_station.acquisition.clocks import ClockReading
from vaoi_station.config import Line


@dataclass(frozen=True)
class TriggerPlan:
    """What happens after the barrier's edge; fixed while armed."""

    start_delay_s: float
    period_s: float
    tail_s: float
    max_rows: int
    debounce_s: float
    lights: Sequence[str] = ()
    """Names of the light patterns, used in turn; empty: always the same light."""

    @classmethod
    def of(cls, line: Line, lights: Sequence[str] = ()) -> TriggerPlan:
        """What follows from the mechanics of a line."""
        return cls(
            start_delay_s=line.start_delay_s,
            period_s=line.trigger_period_s,
            tail_s=line.tail_s,
            max_rows=line.rows_of_longest_board,
            debounce_s=line.debounce_s,
            lights=lights,
        )


@dataclass(frozen=True)
class ControllerEvent:
    """Something that happened, numbered from 0 without gaps, with the controller's own time."""

    number: int
    time_s: float


@dataclass(frozen=True)
class BarrierBlocked(ControllerEvent):
    """A board has reached the barrier; a run begins."""


@dataclass(frozen=True)
class BarrierClear(ControllerEvent):
    """The board has left the barrier; the tail begins."""


@dataclass(frozen=True)
class BarrierBounce(ControllerEvent):
    """An interruption too short to be a board was ignored."""

    duration_s: float


@dataclass(frozen=True)
class PulseFired(ControllerEvent):
    """All cameras and LEDs were triggered; `time_s` is the rising edge."""

    index: int
    light: str = ""
    exposures_us: tuple[float, ...] = ()
    """Exposure of every camera, where it varies from row to row."""


@dataclass(frozen=True)
class PulseSkipped(ControllerEvent):
    """A row was due and not fired; `time_s` is when it was due."""

    index: int
    reason: str


@dataclass(frozen=True)
class RunEnded(ControllerEvent):
    """The last pulse of a run has been fired."""

    pulses: int
    """Rows of the run, those skipped included."""
    reason: str
    """"clear" (board left, tail over), "max-rows" (the board did not leave in time), "disarmed", "single"
    (asked for by `fire_one`), or what befell the controller."""


EventQueue = SimpleQueue[ControllerEvent | DeviceFault | ClockReading]
"""What a controller reports to; a `ClockReading` is one of its own clock."""


class Controller(Protocol):
    """The trigger controller; it stays armed for one passage after another until disarmed."""

    def start(self, events: EventQueue) -> None:
        """Begin to report events.

        Where its clock has jumped, readings of it come before the first event of the new time.
        """

    def arm(self, plan: TriggerPlan) -> None:
        """From now on every passage of the barrier is a run with this plan."""

    def disarm(self) -> None:
        """Ignore the barrier; a run under way is ended with the next pulse left out.

        All events up to then, its RunEnded included, have been reported when this returns.
        """

    def fire_one(self) -> None:
        """Trigger all cameras and LEDs once, now, whatever the barrier shows: a run of one pulse.

        Its PulseFired (index 0) and its RunEnded ("single") are reported like those of a board; the firmware's
        `FIRE_ONE` tells of a pulse of no row only, of which its host end makes both.

        Raises:
            StateError: it is armed, or cannot fire but when a board passes.
        """

    def read_clock(self) -> ClockReading:
        """Compare the controller's clock with the host's; called from a thread of its own."""

    def health(self) -> str:
        """A sentence on its state; never blocks."""

    def close(self) -> None:
        """Outputs off, port closed."""
