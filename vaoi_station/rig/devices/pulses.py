"""Decode the edges of the chip's pins into pulses. A pulse is a trigger with its LED strobe. No I/O.

A pulse is complete when both the trigger and the LED gate have fallen.
"""

from __future__ import annotations

from dataclasses import dataclass

from vaoi_station.rig.devices.chip import HZ, Edge

TRIGGER, GATE = "PB1", "PB2"
CHANNELS = ("PD4", "PD5", "PD6", "PD7")
CYCLES_PER_US = HZ / 1e6


@dataclass(frozen=True)
class Pulse:
    """One trigger pulse for all cameras."""

    cycle: int
    """Cycle of the trigger's rising edge."""
    host_ns: int
    """Time of that cycle, ns of CLOCK_MONOTONIC."""
    channels: tuple[int, ...]
    """Indices of the LED channels that were on; empty: no light."""
    on_us: float
    """Time, µs, for which the LED channels were on after the trigger's rising edge."""
    width_us: float = 0.0
    """Time, µs, for which the trigger was high."""


class PulseDecoder:
    """Decoder that takes edges one by one and returns pulses. It keeps the state of the pins between the edges."""

    def __init__(self) -> None:
        self._high: dict[str, Edge] = {}
        self._trigger: Edge | None = None
        """Rising edge of the trigger whose pulse is not complete; None: no pulse has begun."""
        self._fallen: Edge | None = None
        """Falling edge of that trigger; None while it is high."""
        self._gate: Edge | None = None
        self._lit: tuple[int, ...] = ()
        self._on_us = 0.0

    def process(self, edge: Edge) -> Pulse | None:
        """Process the next edge, in the order of cycles. Return a pulse if this edge completes one."""
        if edge.level:
            self._high[edge.pin] = edge
        else:
            self._high.pop(edge.pin, None)
        if edge.pin == TRIGGER and edge.level:
            self._trigger, self._fallen, self._on_us = edge, None, 0.0
        elif edge.pin == GATE and edge.level:
            self._gate = edge
            # The firmware sets the channels before it opens the gate, so they are complete here.
            self._lit = tuple(n for n, pin in enumerate(CHANNELS) if pin in self._high)
        elif edge.pin == TRIGGER:
            self._fallen = edge
            return self._complete()
        elif edge.pin == GATE:
            gate, self._gate = self._gate, None
            if gate is not None and self._trigger is not None:
                # Light before the trigger's rising edge is not counted, because the exposure starts at this edge.
                self._on_us = (edge.cycle - max(gate.cycle, self._trigger.cycle)) / CYCLES_PER_US
            return self._complete()
        return None

    def _complete(self) -> Pulse | None:
        """Return the pulse if the trigger and the gate have fallen."""
        trigger, fallen, on_us = self._trigger, self._fallen, self._on_us
        if trigger is None or fallen is None or self._gate is not None:
            return None
        self._trigger = self._fallen = None
        width_us = (fallen.cycle - trigger.cycle) / CYCLES_PER_US
        return Pulse(trigger.cycle, trigger.host_ns, self._lit if on_us else (), on_us, width_us)
