"""Translate the firmware's events into those of the controller's interface, with numbers that the host assigns."""

from __future__ import annotations

from collections.abc import Callable
from itertools import count

from vaoi_station.acquisition.cameras.interface import DeviceFault
from vaoi_station.acquisition.controller.interface import (
    BarrierBlocked,
    BarrierBlockedAgain,
    BarrierBounce,
    BarrierClear,
    BarrierClearAfterRun,
    BoardTooSoon,
    ControllerEvent,
    PulseFired,
    PulseSkipped,
    RunEnded,
)
from vaoi_station.acquisition.controller.protocol.messages import (
    ROW_NONE,
    TICK_S,
    Event,
    Fault,
    Kind,
    RunEnd,
    Suppressed,
)
from vaoi_station.acquisition.controller.trigger_rule import TOO_FAST
from vaoi_station.errors import DeviceError

_ENDS: dict[int, str] = {
    RunEnd.CLEAR: "clear",
    RunEnd.MAX_ROWS: "max-rows",
    RunEnd.DISARMED: "disarmed",
    RunEnd.SAFE: "the controller went into its safe state",
}
_SKIPPED: dict[int, str] = {
    Suppressed.LATE: "the controller did not fire it: it could not be prepared in time",
    Suppressed.LED_BUDGET: "the controller did not fire it: the LEDs had not cooled down",
    Suppressed.TOO_FAST: TOO_FAST,
}
_FAULTS: dict[int, tuple[str, str]] = {
    Fault.HEARTBEAT: (
        "The controller received no heartbeat from this computer for too long and switched all outputs off; "
        "boards that passed meanwhile were not filmed.",
        "Nothing, if this computer was stopped or the cable unplugged; the controller is armed again automatically.",
    ),
    Fault.COMMANDED: ("The controller received the command to switch all outputs off.", "Arm again."),
    Fault.GUARD: (
        "The controller's guard switched off an LED that was on for too long.",
        "Check the LED drivers and their wiring, then arm again.",
    ),
}


class EventTranslator:
    """Translator of events, in their order. It follows the run under way, so that each run that begins also ends."""

    def __init__(self) -> None:
        self._put: Callable[[ControllerEvent | DeviceFault], None] | None = None
        self._numbers = count()
        self._light: Callable[[int, int], str] = lambda _row, _channels: ""
        self._single_light = ""
        self._running = False
        self._rows = 0
        self._time_s = 0.0

    @property
    def running(self) -> bool:
        """Whether a run is under way."""
        return self._running

    def start(self, put: Callable[[ControllerEvent | DeviceFault], None]) -> None:
        """Pass events to `put` from now on. Events before this call are dropped."""
        self._put = put

    def set_lights(self, light: Callable[[int, int], str], single: str) -> None:
        """Set the names of the lights.

        Args:
            light: returns the name for a row and the LED channels (bits) that the controller lit.
            single: the name for single pulses.
        """
        self._light, self._single_light = light, single

    def translate(self, event: Event, time_s: float) -> None:
        """Translate the next event of the firmware, and pass the resulting events of the station on to `put`."""
        if event.kind == Kind.BOOT:
            return
        self._time_s = time_s
        if event.kind == Kind.BARRIER:
            self._barrier(event, time_s)
        elif event.kind == Kind.EDGE:
            self._edge(event, time_s)
        elif event.kind == Kind.PULSE:
            self._pulse(event, time_s)
        elif event.kind == Kind.SUPPRESSED:
            self._suppressed(event, time_s)
        elif event.kind == Kind.RUN_END and self._running:
            self._end(time_s, event.index + event.value, _ENDS.get(event.detail, "the controller ended it"))
        elif event.kind == Kind.FAULT and event.detail in _FAULTS:
            message, action = _FAULTS[event.detail]
            self.report_fault(DeviceError(message, action=action, code="controller-safe"))

    def end(self, reason: str) -> bool:
        """End the run under way, whose end the controller will not report. Return False if no run is under way."""
        if not self._running:
            return False
        self._end(self._time_s, self._rows, reason)
        return True

    def report_fault(self, error: DeviceError) -> None:
        """Pass on a fault of the controller as an event."""
        if self._put is not None:
            self._put(DeviceFault("controller", error))

    def _barrier(self, event: Event, time_s: float) -> None:
        if event.detail:
            # If a run is still under way here, its end event was overwritten in the firmware's ring of events.
            self.end("the controller's report of its end was lost")
            self._running, self._rows = True, 0
            self._emit(BarrierBlocked(next(self._numbers), time_s, event.value))
        elif self._running:
            self._emit(BarrierClear(next(self._numbers), time_s, event.value))

    def _edge(self, event: Event, time_s: float) -> None:
        if event.detail:
            # If the barrier event of a run was lost, an interruption within the run begins it.
            if not self._running:
                self._running, self._rows = True, 0
            self._emit(BarrierBlockedAgain(next(self._numbers), time_s, event.value))
        else:
            self._emit(BarrierClearAfterRun(next(self._numbers), time_s, event.value))

    def _pulse(self, event: Event, time_s: float) -> None:
        if event.index == ROW_NONE:
            # The firmware has one event for a single pulse; the interface has a run of one row.
            self._emit(PulseFired(next(self._numbers), time_s, 0, self._single_light))
            self._emit(RunEnded(next(self._numbers), time_s, 1, "single"))
            return
        # If the barrier event of a run was lost, its first pulse begins it.
        self._running, self._rows = True, event.index + 1
        light = self._light(event.index, event.detail)
        on_us = round(event.on_ticks * TICK_S * 1e6, 3)
        trigger_us = round(event.width_ticks * TICK_S * 1e6, 3) or None
        self._emit(PulseFired(next(self._numbers), time_s, event.index, light, on_us=on_us, trigger_us=trigger_us))

    def _suppressed(self, event: Event, time_s: float) -> None:
        if event.detail == Suppressed.BOUNCE:
            self._emit(BarrierBounce(next(self._numbers), time_s, event.value * TICK_S))
        elif event.detail == Suppressed.GAP:
            self._emit(BoardTooSoon(next(self._numbers), time_s, event.value * TICK_S))
            self.report_fault(
                DeviceError(
                    f"A board came {event.value * TICK_S:.3f} s after the one before had left, and was not filmed.",
                    action="Keep boards apart, or lower min_gap_s under [controller] in station.toml.",
                    code="board-too-soon",
                )
            )
        elif event.detail in _SKIPPED:
            self._rows = event.index + 1
            self._emit(PulseSkipped(next(self._numbers), time_s, event.index, _SKIPPED[event.detail]))

    def _end(self, time_s: float, rows: int, reason: str) -> None:
        self._running = False
        self._emit(RunEnded(next(self._numbers), time_s, rows, reason))

    def _emit(self, event: ControllerEvent) -> None:
        if self._put is not None:
            self._put(event)
