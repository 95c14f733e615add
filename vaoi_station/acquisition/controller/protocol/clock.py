"""The controller's 32-bit ticks → time of the host, with a bound.

The counter wraps every 35.8 minutes. Which turn a tick is of follows from the host's time, which is known to far
better than half a turn; what is left is a device clock like any other (`acquisition.clocks`).
"""

from __future__ import annotations

from vaoi_station.acquisition.clocks import ClockModel, ClockReading
from vaoi_station.acquisition.controller.protocol.messages import TICK_S

_WRAP = 1 << 32


class TickClock:
    """Fed with replies to CLOCK; one per boot of the controller."""

    def __init__(self, name: str = "controller") -> None:
        self.model = ClockModel(name)
        self._known = False

    def add(self, tick: int, sent_s: float, received_s: float) -> ClockReading:
        """A reply: the tick lies between the first sending of the question and the answer's arrival."""
        host_s = (sent_s + received_s) / 2
        reading = ClockReading(self.device_s(tick, host_s), host_s, (received_s - sent_s) / 2)
        self.model.add(reading)
        self._known = True
        return reading

    def device_s(self, tick: int, near_host_s: float) -> float:
        """Seconds since the controller's start, for a tick within 17 minutes of a host time."""
        if not self._known:
            return tick * TICK_S
        expected = self.model.device_s(near_host_s) / TICK_S
        return (tick + _WRAP * round((expected - tick) / _WRAP)) * TICK_S

    def host_s(self, tick: int, near_host_s: float) -> float:
        """Host time of a tick within 17 minutes of another host time; DeviceError before the first reading."""
        return self.model.host_s(self.device_s(tick, near_host_s))

    def bound_s(self, tick: int, near_host_s: float) -> float:
        """How far `host_s` may be off for this tick."""
        return self.model.bound_s(self.device_s(tick, near_host_s))
