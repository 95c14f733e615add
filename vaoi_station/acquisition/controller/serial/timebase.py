"""Seconds of the controller's clock through all its resets.

A reset begins its ticks anew. Every boot has a stretch of its own on one axis, far enough from the one before
that a clock model takes it for the jump it is (`acquisition.clocks`).
"""

from __future__ import annotations

from vaoi_station.acquisition.clocks import ClockReading
from vaoi_station.acquisition.controller.protocol.clock import TickClock

BOOT_SPACING_S = 3600.0
"""Between the end of one boot's stretch and the beginning of the next."""
BITS_PER_BYTE = 10
REQUEST_BYTES = 10
REPLY_BYTES = 14
"""Frames of CLOCK and its reply on the line."""


class Timebase:
    """Ticks → seconds; fed with readings of the clock."""

    def __init__(self, baud: int) -> None:
        byte_s = BITS_PER_BYTE / baud
        self._request_s, self._reply_s = REQUEST_BYTES * byte_s, REPLY_BYTES * byte_s
        self._clock = TickClock()
        self._origin_s = self._latest_s = 0.0

    def restart(self) -> None:
        """The controller has been reset."""
        self._clock = TickClock()
        self._origin_s = self._latest_s + BOOT_SPACING_S

    def add_reply(self, tick: int, sent_s: float, received_s: float) -> ClockReading:
        """A reply to CLOCK: the tick is of a time when the whole question had arrived and the answer had not begun."""
        earliest_s, latest_s = sent_s + self._request_s, received_s - self._reply_s
        if earliest_s > latest_s:  # faster than a line of this rate: it is none
            earliest_s, latest_s = sent_s, received_s
        reading = self._clock.add(tick, earliest_s, latest_s)
        return ClockReading(self._at(reading.device_s), reading.host_s, reading.bound_s)

    def time_s(self, tick: int, near_host_s: float) -> float:
        """Of a tick within 17 minutes of a host time."""
        return self._at(self._clock.device_s(tick, near_host_s))

    def drift_ppm(self) -> float:
        """How much slower than the host's the controller's clock goes."""
        return self._clock.model.drift_ppm

    def bound_s(self) -> float:
        """How well it is known."""
        return self._clock.model.bound_s()

    def _at(self, since_boot_s: float) -> float:
        time_s = self._origin_s + since_boot_s
        self._latest_s = max(self._latest_s, time_s)
        return time_s
