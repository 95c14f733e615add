"""The clock of a simulated or replayed device. Its time differs from `time.monotonic()` by an offset and a drift."""

from __future__ import annotations

import time
from dataclasses import dataclass, field

from vaoi_station.acquisition.clocks import ClockReading


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
        """Read the clock as over a network: the host time of the reading is the middle of the request's round trip."""
        asked_s = time.monotonic()
        device_s = self.now_s()
        answered_s = time.monotonic()
        return ClockReading(device_s, (asked_s + answered_s) / 2, (answered_s - asked_s) / 2)

    def read_exactly(self) -> ClockReading:
        """Read the clock with an error bound of 0, for replayed devices: their times come from the host's clock."""
        host_s = time.monotonic()
        return ClockReading(self.device_s(host_s), host_s, 0.0)


def simulated_clock(number: int) -> DeviceClock:
    """Return a clock that differs from other devices' clocks like real ones do: by hours and by up to ± 50 ppm.

    Args:
        number: number of the camera, or −1 for the controller.
    """
    # 37 and 101 have no common factor: neighbouring devices get drifts far apart, and the first 101 all differ.
    return DeviceClock(offset_s=3600.0 * (2 + number) + 0.137 * number, drift_ppm=-50 + (37 * (number + 2)) % 101)
