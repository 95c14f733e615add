"""Edges of the chip's pins → shots: a trigger, and the light that came with it. Pure logic.

A shot is known when its light is out: at the gate's falling edge, or, in darkness, at the trigger's.
"""

from __future__ import annotations

from dataclasses import dataclass

from vaoi_station.rig.devices.chip import HZ, Edge

TRIGGER, GATE = "PB1", "PB2"
CHANNELS = ("PD4", "PD5", "PD6", "PD7")
CYCLES_PER_US = HZ / 1e6


@dataclass(frozen=True)
class Shot:
    """All cameras were triggered once."""

    cycle: int
    """Of the trigger's rising edge."""
    host_ns: int
    """CLOCK_MONOTONIC of it."""
    channels: tuple[int, ...]
    """LEDs that were lit; none: it stayed dark."""
    on_us: float
    """How long they were lit after the trigger rose."""


class Pins:
    """What is high, and since when."""

    def __init__(self) -> None:
        self._high: dict[str, Edge] = {}
        self._trigger: Edge | None = None
        """Of the shot that is not known yet."""
        self._gate: Edge | None = None
        self._lit: tuple[int, ...] = ()

    def edge(self, edge: Edge) -> Shot | None:
        """The next edge, in the order of cycles; a shot if it is known now."""
        if edge.level:
            self._high[edge.pin] = edge
        else:
            self._high.pop(edge.pin, None)
        if edge.pin == TRIGGER and edge.level:
            self._trigger = edge
        elif edge.pin == GATE and edge.level:
            self._gate = edge
            self._lit = tuple(n for n, pin in enumerate(CHANNELS) if pin in self._high)
        elif edge.pin == TRIGGER:
            return self._trigger_falls()
        elif edge.pin == GATE:
            return self._gate_falls(edge)
        return None

    def _trigger_falls(self) -> Shot | None:
        return None if self._gate is not None else self._shot(0.0)

    def _gate_falls(self, edge: Edge) -> Shot | None:
        gate, self._gate = self._gate, None
        if gate is None or self._trigger is None:
            return None
        return self._shot((edge.cycle - max(gate.cycle, self._trigger.cycle)) / CYCLES_PER_US)

    def _shot(self, on_us: float) -> Shot | None:
        trigger, self._trigger = self._trigger, None
        if trigger is None:
            return None
        return Shot(trigger.cycle, trigger.host_ns, self._lit if on_us else (), on_us)
