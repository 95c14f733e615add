"""One time axis, in s, for the controller's clock across all its resets.

A reset sets the tick counter to 0. Each boot gets a separate interval on one time axis. The intervals are so far apart
that a clock fit recognises the jump between them (`acquisition.clocks`).
"""

from __future__ import annotations

from vaoi_station.acquisition.clocks import ClockReading
from vaoi_station.acquisition.controller.protocol.clock import TickClock

BOOT_SPACING_S = 3600.0
"""Time, s, between the end of one boot and the beginning of the next, on the time axis that covers all boots."""
BITS_PER_BYTE = 10
"""Bits on the serial line for one byte: one start bit, eight data bits, one stop bit."""
REQUEST_BYTES = 10
REPLY_BYTES = 14
"""Bytes of the frame of a CLOCK request, and of the frame of its reply."""


class Timebase:
    """Converter from the controller's ticks to seconds on the time axis, based on replies to CLOCK."""

    def __init__(self, baud: int) -> None:
        byte_s = BITS_PER_BYTE / baud
        self._request_s, self._reply_s = REQUEST_BYTES * byte_s, REPLY_BYTES * byte_s
        self._clock = TickClock()
        self._origin_s = self._latest_s = 0.0

    def restart(self) -> None:
        """Begin a new interval of the time axis after a reset of the controller."""
        self._clock = TickClock()
        self._origin_s = self._latest_s + BOOT_SPACING_S

    def add_reply(self, tick: int, sent_s: float, received_s: float) -> ClockReading:
        """Add a reply to CLOCK. Return it as a clock reading whose device time is on the time axis."""
        # The tick was read after the whole request had arrived and before the reply began, which narrows the bound.
        earliest_s, latest_s = sent_s + self._request_s, received_s - self._reply_s
        # A reply faster than the baud rate allows comes from a pseudo terminal or native USB, where byte times do not
        # apply.
        if earliest_s > latest_s:
            earliest_s, latest_s = sent_s, received_s
        reading = self._clock.add(tick, earliest_s, latest_s)
        return ClockReading(self._at(reading.device_s), reading.host_s, reading.bound_s)

    def time_s(self, tick: int, near_host_s: float) -> float:
        """Return the time, s, on the one time axis across all resets, for a tick that occurred within 17 minutes of a
        host time."""
        return self._at(self._clock.device_s(tick, near_host_s))

    def drift_ppm(self) -> float:
        """Return how much slower the controller's clock runs than the host's, in ppm."""
        return self._clock.model.drift_ppm

    def bound_s(self) -> float:
        """Return the largest error of the clock fit, in s."""
        return self._clock.model.bound_s()

    def _at(self, since_boot_s: float) -> float:
        time_s = self._origin_s + since_boot_s
        self._latest_s = max(self._latest_s, time_s)
        return time_s
