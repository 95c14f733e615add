"""The clock of a device that does not exist: an offset and a drift against `time.monotonic()`."""

from __future__ import annotations

import time
from dataclasses import dataclass, field

from vaoi_station.acquisition.clocks import ClockReading


@dataclass(frozen=True)
class DeviceClock:
    """device = offset + (host − origin) · (1 + drift)."""

    offset_s: float = 0.0
    drift_ppm: float = 0.0
    origin_s: float = field(default_factory=time.monotonic)

    def device_s(self, host_s: float) -> float:
        """What the device's clock shows at a host time."""
        return self.offset_s + (host_s - self.origin_s) * (1 + self.drift_ppm * 1e-6)

    def host_s(self, device_s: float) -> float:
        """Host time at which the device's clock shows a time."""
        return self.origin_s + (device_s - self.offset_s) / (1 + self.drift_ppm * 1e-6)

    def now_s(self) -> float:
        """What the device's clock shows now."""
        return self.device_s(time.monotonic())

    def read(self) -> ClockReading:
        """Ask the device, as one would over a wire: the answer is dated by the middle of the round trip."""
        asked_s = time.monotonic()
        device_s = self.now_s()
        answered_s = time.monotonic()
        return ClockReading(device_s, (asked_s + answered_s) / 2, (answered_s - asked_s) / 2)

    def read_exactly(self) -> ClockReading:
        """A reading without a wire, where both clocks are the same one."""
        host_s = time.monotonic()
        return ClockReading(self.device_s(host_s), host_s, 0.0)


def crystal(number: int) -> DeviceClock:
    """A clock as unlike its neighbours' as real ones: hours apart, ± 50 ppm; −1 is the controller's."""
    return DeviceClock(offset_s=3600.0 * (2 + number) + 0.137 * number, drift_ppm=-50 + (37 * (number + 2)) % 101)
