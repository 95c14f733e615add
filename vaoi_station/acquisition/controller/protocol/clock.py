"""Conversion of the controller's 32-bit ticks to host time, with an error bound.

The counter restarts from 0 every 35.8 minutes. The host's time, which is far more accurate than half of that, shows how
often it has done so. The extended ticks are then a device clock like any other (`acquisition.clocks`).
"""

from __future__ import annotations

from vaoi_station.acquisition.clocks import ClockModel, ClockReading
from vaoi_station.acquisition.controller.protocol.messages import TICK_S

_WRAP = 1 << 32
"""Number of ticks after which the controller's 32-bit counter restarts from 0."""


class TickClock:
    """The fit of the controller's clock, from one reset of the controller to the next."""

    def __init__(self, name: str = "controller") -> None:
        self.model = ClockModel(name)
        self._known = False

    def add(self, tick: int, sent_s: float, received_s: float) -> ClockReading:
        """Add a reply to CLOCK. Its tick was read at a host time between `sent_s` (first request) and `received_s`."""
        # The midpoint is used, with half the round trip as bound: the split of the delay between both ways is unknown.
        host_s = (sent_s + received_s) / 2
        reading = ClockReading(self.device_s(tick, host_s), host_s, (received_s - sent_s) / 2)
        self.model.add(reading)
        self._known = True
        return reading

    def device_s(self, tick: int, near_host_s: float) -> float:
        """Return the seconds since the controller's reset for a tick that occurred within 17 minutes of a host time."""
        # Before the first reading, there is no time from which restarts of the counter could be counted. Any origin
        # will do, because the fit finds the offset.
        if not self._known:
            return tick * TICK_S
        expected = self.model.device_s(near_host_s) / TICK_S
        return (tick + _WRAP * round((expected - tick) / _WRAP)) * TICK_S
