"""Map the clock of a device to the host's `time.monotonic()`, with a bound of the error.

A reading states that the device's clock showed d when the host's showed h ± b, half the round trip of the request. The
line h = h₀ + (1 + s)·(d − d₀) is fitted with weights 1/b², so that short round trips dominate, and a prior for the
drift s. Its error is at most b plus the residual of a reading, and 3·σ_s·Δd more at a distance Δd from it.
"""

from __future__ import annotations

import math
import time
from collections import deque
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

from vaoi_station.errors import DeviceError

PRIOR_DRIFT = 2e-4
"""Standard deviation of the drift s of a crystal clock before anything is measured."""
JUMP_S = 1e-3
"""Smallest jump of a clock that is reported, s; smaller ones may be errors of readings."""
RESOLUTION_S = 1e-7
"""Lower limit for the error bound of a reading, s. It keeps the weights 1/b² finite."""


class ClockError(DeviceError):
    """A clock model is not accurate enough yet. More readings may improve it."""

    code = "clock-unknown"


@dataclass(frozen=True)
class ClockReading:
    """One comparison of a device's clock with time.monotonic()."""

    device_s: float
    host_s: float
    bound_s: float


@dataclass(frozen=True)
class ClockJump:
    """A jump of a device's clock between two of its readings."""

    size_s: float
    since_s: float
    """Earliest possible host time of the last reading before the jump, s."""
    until_s: float
    """Latest possible host time of the first reading after the jump, s."""

    def __str__(self) -> str:
        return f"its clock jumped by {self.size_s:+.2f} s"


class ClockModel:
    """The mapping from one device's clock to the host's, updated with every reading."""

    def __init__(self, name: str) -> None:
        self.name = name
        self._readings: deque[ClockReading] = deque(maxlen=60)
        self._device0_s = self._host0_s = 0.0
        self._slope = 0.0
        self._slope_sigma = PRIOR_DRIFT
        self._bound_s = math.inf
        self.restarts = 0

    def add(self, reading: ClockReading) -> ClockJump | None:
        """Add a reading and fit again. At a jump, discard older readings; return it if it is at least `JUMP_S`."""
        jump = None
        if self._readings:
            off_s = abs(self.host_s(reading.device_s) - reading.host_s)
            # As long as a clock runs on, line and reading differ by at most the sum of both bounds. More than twice
            # that sum means that the clock has restarted.
            if off_s > 2 * (self.bound_s(reading.device_s) + reading.bound_s + RESOLUTION_S):
                if off_s >= JUMP_S:
                    size_s = reading.device_s - self.device_s(reading.host_s)
                    # The camera took its time at some moment of the round trip, which may be long on a busy computer.
                    last = self._readings[-1]
                    jump = ClockJump(size_s, last.host_s - last.bound_s, reading.host_s + reading.bound_s)
                self._readings.clear()
                self.restarts += 1
        self._readings.append(reading)
        self._fit()
        self._bound_s = self.bound_s(reading.device_s)
        return jump

    def host_s(self, device_s: float) -> float:
        """Return the host time at which the device's clock shows `device_s`."""
        self._require_reading()
        return self._host0_s + (1 + self._slope) * (device_s - self._device0_s)

    def device_s(self, host_s: float) -> float:
        """Return what the device's clock shows at a host time; the inverse of the method `host_s`."""
        self._require_reading()
        return self._device0_s + (host_s - self._host0_s) / (1 + self._slope)

    def bound_s(self, device_s: float | None = None) -> float:
        """Return the bound of the error of `host_s` at a device time, in s; by default at the newest reading."""
        # Without a device time the bound stored by the last fit is returned: this is called with every frame.
        if device_s is None or not self._readings:
            return self._bound_s
        return min(
            max(r.bound_s, RESOLUTION_S)
            + abs(self.host_s(r.device_s) - r.host_s)
            + 3 * self._slope_sigma * abs(device_s - r.device_s)
            for r in self._readings
        )

    @property
    def read_s(self) -> float:
        """Earliest possible host time of the newest reading, s; minus infinity before the first."""
        return self._readings[-1].host_s - self._readings[-1].bound_s if self._readings else -math.inf

    @property
    def drift_ppm(self) -> float:
        """Drift s, ppm: by how much a second of the device is longer than a second of the host."""
        return self._slope * 1e6

    def require(self, limit_s: float) -> None:
        """Raise ClockError if the error bound of the model is above the limit."""
        if (bound_s := self.bound_s()) > limit_s:
            raise ClockError(
                f"{self.name}: times of its clock may be wrong by {bound_s * 1e3:.3f} ms "
                f"(limit {limit_s * 1e3:.3f} ms).",
                action="Check the link to the device and the load of this computer, then arm again.",
            )

    def _fit(self) -> None:
        weights = [1 / max(r.bound_s, RESOLUTION_S) ** 2 for r in self._readings]
        total = sum(weights)
        newest = self._readings[-1]
        # Times are relative to the newest reading, so that squares and products keep their precision after weeks.
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

    def _require_reading(self) -> None:
        if not self._readings:
            raise ClockError(
                f"{self.name}: its clock has never been read.", action="Check the link to the device, then arm again."
            )


def apart_s(clocks: Mapping[int, tuple[ClockModel, int]], host_s: float) -> dict[int, float]:
    """Return by how much clocks that should show one time certainly differ from their median; 0 within the bounds.

    Each comes with the time, ns, from which its seconds count.
    """
    known = {k: pair for k, pair in clocks.items() if math.isfinite(pair[0].read_s)}
    if len(known) < 2:
        return {}
    origin_ns = next(iter(known.values()))[1]
    times_s = {k: clock.device_s(host_s) + (epoch_ns - origin_ns) * 1e-9 for k, (clock, epoch_ns) in known.items()}
    bounds_s = {k: clock.bound_s(clock.device_s(host_s)) for k, (clock, _) in known.items()}
    ranked = sorted(known, key=times_s.__getitem__)
    middle, above = ranked[(len(known) - 1) // 2], ranked[len(known) // 2]
    if times_s[above] - times_s[middle] > bounds_s[middle] + bounds_s[above] + RESOLUTION_S:
        # Two halves: nothing says which one is right.
        return {k: t - times_s[above if t <= times_s[middle] else middle] for k, t in times_s.items()}
    off_s = {k: times_s[k] - times_s[middle] for k in known}
    return {k: off_s[k] if abs(off_s[k]) > bounds_s[k] + bounds_s[middle] + RESOLUTION_S else 0.0 for k in known}


def timed_reading(read_s: Callable[[], float]) -> ClockReading:
    """Read a device's clock: the host time of the reading is the middle of the request's round trip."""
    asked_s = time.monotonic()
    device_s = read_s()
    answered_s = time.monotonic()
    return ClockReading(device_s, (asked_s + answered_s) / 2, (answered_s - asked_s) / 2)


@dataclass(frozen=True)
class DeviceClock:
    """A simulated clock: device time = offset + (host time − origin) · (1 + drift)."""

    offset_s: float = 0.0
    drift_ppm: float = 0.0
    origin_s: float = field(default_factory=time.monotonic)

    def device_s(self, host_s: float) -> float:
        """Return what the device's clock shows at a host time."""
        return self.offset_s + (host_s - self.origin_s) * (1 + self.drift_ppm * 1e-6)

    def host_s(self, device_s: float) -> float:
        """Return the host time at which the device's clock shows `device_s`."""
        return self.origin_s + (device_s - self.offset_s) / (1 + self.drift_ppm * 1e-6)

    def now_s(self) -> float:
        """Return what the device's clock shows now."""
        return self.device_s(time.monotonic())

    def read(self) -> ClockReading:
        """Read the clock as over a network."""
        return timed_reading(self.now_s)

    def read_exactly(self) -> ClockReading:
        """Read the clock with an error bound of 0, for replayed devices: their times come from the host's clock."""
        host_s = time.monotonic()
        return ClockReading(self.device_s(host_s), host_s, 0.0)


def simulated_clock(number: int) -> DeviceClock:
    """Return a clock that differs from other devices' clocks like real ones do: by hours and by up to ± 50 ppm."""
    # 37 and 101 have no common factor: neighbouring devices get drifts far apart, and the first 101 all differ.
    return DeviceClock(offset_s=3600.0 * (2 + number) + 0.137 * number, drift_ppm=-50 + (37 * (number + 2)) % 101)
