"""Compare the camera's clock, which gives frames their time stamps, with the host's monotonic clock.

The camera latches its time on command and returns the latched value afterwards. The host time of the latch is the
middle of the round trip, known to half of its duration. Aravis' fake camera has no latch and uses this computer's wall
clock for time stamps; for the fake, the wall clock and the monotonic clock are read one after the other.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from vaoi_station.acquisition.clocks import ClockReading
from vaoi_station.errors import DeviceError

LATCHES = (
    ("TimestampLatch", "TimestampLatchValue"),
    ("GevTimestampControlLatch", "GevTimestampValue"),
)
"""GenICam names of the latch command and of the latched value: SFNC 2 (value in ns), GigE Vision 1 (in ticks)."""
FAKE_VENDOR = "Aravis"
"""Vendor name of Aravis' fake camera."""


@dataclass(frozen=True)
class CameraClock:
    """The clock of one camera, in ns. The camera chooses the time at which its clock is 0."""

    read_ns: Callable[[], int]
    remote: bool = True
    """Whether a reading needs access to the camera over its network or USB port."""

    def read(self, epoch_ns: int) -> ClockReading:
        """Compare the camera's clock with the host's once.

        Args:
            epoch_ns: value of the camera's clock from which the `device_s` of the reading counts.

        Raises:
            GLib.Error: the camera does not reply.
        """
        asked_s = time.monotonic()
        device_ns = self.read_ns()
        answered_s = time.monotonic()
        return ClockReading((device_ns - epoch_ns) * 1e-9, (asked_s + answered_s) / 2, (answered_s - asked_s) / 2)


def find_clock(camera: Any, name: str) -> CameraClock:
    """Return a `CameraClock` that reads the clock of this camera.

    Raises:
        DeviceError: the camera has no readable clock, so that it could not be proven which frame belongs to which
            pulse.
    """
    device = camera.get_device()
    for command, value in LATCHES:
        if device.is_feature_available(command) and device.is_feature_available(value):
            return CameraClock(_latch(device, command, value, _ns_per_tick(camera, command)))
    if (camera.get_vendor_name() or "") == FAKE_VENDOR:
        return CameraClock(time.time_ns, remote=False)
    raise DeviceError(
        f"{name}: has no time stamp that can be latched ({', '.join(c for c, _ in LATCHES)}).",
        action="Use a camera whose clock can be latched; without it, frames cannot be assigned to pulses.",
        code="clock-unknown",
    )


def _latch(device: Any, command: str, value: str, ns_per_tick: float) -> Callable[[], int]:
    def read_ns() -> int:
        device.execute_command(command)
        ticks: int = device.get_integer_feature_value(value)
        return ticks if ns_per_tick == 1 else round(ticks * ns_per_tick)

    return read_ns


def _ns_per_tick(camera: Any, command: str) -> float:
    """Return the length of a clock tick in ns, because Aravis gives the time stamps of frames in ns."""
    if command != "GevTimestampControlLatch":
        return 1.0
    hertz = camera.get_device().get_timestamp_tick_frequency()
    return 1e9 / hertz if hertz else 1.0
