"""Decode the edges of the chip's pins into pulses. A pulse is a trigger with its LED strobe. No I/O.

A pulse with light is complete at the falling edge of the LED gate; a pulse without light is complete at the falling
edge of the trigger.
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


class PulseDecoder:
    """Decoder that takes edges one by one and returns pulses. It keeps the state of the pins between the edges."""

    def __init__(self) -> None:
        self._high: dict[str, Edge] = {}
        self._trigger: Edge | None = None
        """Rising edge of the trigger whose pulse is not complete; None: no pulse has begun."""
        self._gate: Edge | None = None
        self._lit: tuple[int, ...] = ()

    def process(self, edge: Edge) -> Pulse | None:
        """Process the next edge, in the order of cycles. Return a pulse if this edge completes one."""
        if edge.level:
            self._high[edge.pin] = edge
        else:
            self._high.pop(edge.pin, None)
        if edge.pin == TRIGGER and edge.level:
            self._trigger = edge
        elif edge.pin == GATE and edge.level:
            self._gate = edge
            # The firmware sets the channels before it opens the gate, so they are complete here.
            self._lit = tuple(n for n, pin in enumerate(CHANNELS) if pin in self._high)
        elif edge.pin == TRIGGER:
            return self._trigger_falls()
        elif edge.pin == GATE:
            return self._gate_falls(edge)
        return None

    def _trigger_falls(self) -> Pulse | None:
        return None if self._gate is not None else self._pulse(0.0)

    def _gate_falls(self, edge: Edge) -> Pulse | None:
        gate, self._gate = self._gate, None
        if gate is None or self._trigger is None:
            return None
        # Light before the trigger's rising edge is not counted, because the exposure starts at this edge.
        return self._pulse((edge.cycle - max(gate.cycle, self._trigger.cycle)) / CYCLES_PER_US)

    def _pulse(self, on_us: float) -> Pulse | None:
        trigger, self._trigger = self._trigger, None
        if trigger is None:
            return None
        return Pulse(trigger.cycle, trigger.host_ns, self._lit if on_us else (), on_us)
