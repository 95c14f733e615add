"""A device's clock → the host's `time.monotonic()`, with a bound that is honest about both.

Every `ClockReading` says: when the device's clock showed d, the host's showed h ± b (b is half the round
trip). A straight line h = h₀ + (1 + s)·(d − d₀) is fitted with weights 1/b², where s, the drift, is known
beforehand to be a few hundred ppm at most; short round trips therefore decide. At each reading the line is
wrong by no more than b plus its residual there; away from it the uncertainty of s is added.
"""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass

from vaoi_station.errors import DeviceError

PRIOR_DRIFT = 2e-4
"""Standard deviation of the relative rate of crystals, before anything is measured."""
RESOLUTION_S = 1e-7
"""No reading is trusted further than this."""


class ClockError(DeviceError):
    """A clock is not known well enough yet; more readings may mend that."""

    code = "clock-unknown"


@dataclass(frozen=True)
class ClockReading:
    """One comparison of a device's clock with time.monotonic()."""

    device_s: float
    host_s: float
    bound_s: float
    """Half the round trip of the question: the reading is no further off than this."""


class ClockModel:
    """The clock of one device, kept up to date by readings."""

    def __init__(self, name: str, keep: int = 60) -> None:
        self.name = name
        self._readings: deque[ClockReading] = deque(maxlen=keep)
        self._device0_s = self._host0_s = 0.0
        self._slope = 0.0
        self._slope_sigma = PRIOR_DRIFT
        self._bound_s = math.inf
        self.restarts = 0
        """How often the device's clock jumped (it was switched off and on)."""

    def add(self, reading: ClockReading) -> None:
        """Take in one reading; one that contradicts the line beyond all bounds starts a new one."""
        if self._readings:
            off_s = abs(self.host_s(reading.device_s) - reading.host_s)
            if off_s > 2 * (self.bound_s(reading.device_s) + reading.bound_s + RESOLUTION_S):
                self._readings.clear()
                self.restarts += 1
        self._readings.append(reading)
        self._fit()
        self._bound_s = self.bound_s(reading.device_s)

    def host_s(self, device_s: float) -> float:
        """Host time at which the device's clock shows `device_s`."""
        self._must_know()
        return self._host0_s + (1 + self._slope) * (device_s - self._device0_s)

    def device_s(self, host_s: float) -> float:
        """What the device's clock shows at a host time: the inverse of `host_s`."""
        self._must_know()
        return self._device0_s + (host_s - self._host0_s) / (1 + self._slope)

    def bound_s(self, device_s: float | None = None) -> float:
        """How far `host_s` may be off (at the newest reading, if no time is given); infinite before the first."""
        if device_s is None or not self._readings:
            return self._bound_s
        return min(
            max(r.bound_s, RESOLUTION_S)
            + abs(self.host_s(r.device_s) - r.host_s)
            + 3 * self._slope_sigma * abs(device_s - r.device_s)
            for r in self._readings
        )

    @property
    def drift_ppm(self) -> float:
        """By how much the device's seconds are longer than the host's."""
        return self._slope * 1e6

    def require(self, limit_s: float) -> None:
        """ClockError while the bound is above the limit."""
        if (bound_s := self.bound_s()) > limit_s:
            raise ClockError(
                f"{self.name}: its clock is known to ± {bound_s * 1e3:.3f} ms, but must be to {limit_s * 1e3:.3f} ms.",
                action="Check the link to the device and the load of this computer, then arm again.",
            )

    def _fit(self) -> None:
        """Weighted least squares about the weighted mean; the prior on the slope acts like one more reading."""
        weights = [1 / max(r.bound_s, RESOLUTION_S) ** 2 for r in self._readings]
        total = sum(weights)
        newest = self._readings[-1]
        d = [r.device_s - newest.device_s for r in self._readings]
        e = [(r.host_s - newest.host_s) - x for r, x in zip(self._readings, d, strict=True)]
        d0 = sum(w * x for w, x in zip(weights, d, strict=True)) / total
        e0 = sum(w * y for w, y in zip(weights, e, strict=True)) / total
        information = sum(w * (x - d0) ** 2 for w, x in zip(weights, d, strict=True)) + PRIOR_DRIFT**-2
        product = sum(w * (x - d0) * (y - e0) for w, x, y in zip(weights, d, e, strict=True))
        self._slope = product / information
        self._slope_sigma = information**-0.5
        self._device0_s = newest.device_s + d0
        self._host0_s = newest.host_s + d0 + e0

    def _must_know(self) -> None:
        if not self._readings:
            raise ClockError(f"{self.name}: its clock has never been read.")
