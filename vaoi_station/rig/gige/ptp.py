"""PTP (IEEE 1588) of a stand-in camera: how its clock comes to follow a master's, by the nodes of its description."""

from __future__ import annotations

import time
from dataclasses import dataclass
from typing import Protocol

from vaoi_station.rig.gige.description import Features

WAY = (("Initializing", 0.1), ("Listening", 0.3), ("Uncalibrated", 0.3))
"""States before the last one, and how long each lasts, s. A real camera needs ten times as long."""
OFFSET_NS = 40
"""What a slave states of its difference from the master."""
TAI_S = 37
"""By how much the time of PTP is ahead of UTC."""
TICK_HZ = 1_000_000_000
"""What clocks in the ticks of GigE Vision 1 count while they follow PTP, as of Teledyne DALSA."""
_SWITCHES = ("PtpEnable", "GevIEEE1588", "PtpMode")
_STATES = ("PtpStatus", "GevIEEE1588Status")
_LATCHED = {
    "PtpDataSetLatch": ("PtpStatus", "PtpOffsetFromMaster"),
    "GevIEEE1588DataSetLatch": (
        "GevIEEE1588StatusLatched", "GevIEEE1588OffsetFromMaster", "GevIEEE1588OffsetFromMasterLatched",
    ),
}  # fmt: skip
"""Command → the features that have their values from it."""


@dataclass
class ClockFaults:
    """What a device's clock does wrong."""

    ptp_ends_in: str = "Slave"
    """The state at which its PTP arrives: `Listening` without a master, `Master` if it is the best clock."""
    clock_ppm: float = 0.0
    """Drift of its clock, also while it says that it follows a master, as in holdover."""


class Clocked(Protocol):
    """A device with a clock."""

    features: Features
    tick_hz: int
    clock_offset_ns: int

    @property
    def faults(self) -> ClockFaults:
        """What its clock does wrong."""

    def set_tick_hz(self, tick_hz: int) -> None:
        """Count the clock in other ticks."""


class Ptp:
    """The PTP clock of a device since its last start."""

    def __init__(self, device: Clocked) -> None:
        """Find the nodes; `faults` of the device say where it ends, and whether its clock drifts."""
        self._device, features = device, device.features
        self._switch = next((name for name in _SWITCHES if name in features), "")
        self._latched = next((found for command, found in _LATCHED.items() if command in features), ())
        self._own_tick_hz, self._at_ns = device.tick_hz, time.monotonic_ns()
        self._since_ns: int | None = None
        """Since when PTP is on."""
        self.state = ""

    def advance(self) -> None:
        """Bring clock, state and registers to the present moment; called before whatever shows them."""
        device, now_ns = self._device, time.monotonic_ns()
        device.clock_offset_ns += round((now_ns - self._at_ns) * device.faults.clock_ppm * 1e-6)
        self._at_ns = now_ns
        if not self._switch:
            return
        is_on = device.features.value(self._switch) != 0
        if is_on != (self._since_ns is not None):
            self._since_ns = now_ns if is_on else None
            if "TimestampLatch" not in device.features:
                device.set_tick_hz(TICK_HZ if is_on else self._own_tick_hz)
        state = self._state(now_ns)
        if state == self.state:
            return
        if state == "Slave":
            device.clock_offset_ns = time.time_ns() + TAI_S * 1_000_000_000 - now_ns
        self.state = state
        for name in _STATES:
            if name not in self._latched:
                self._show(name)

    def latch(self, command: str) -> None:
        """Execute a command that brings state and offset into the registers."""
        for name in _LATCHED.get(command, ()):
            self._show(name)

    def _show(self, name: str) -> None:
        features = self._device.features
        if name not in features:
            return
        if "Offset" in name:
            features.put(name, OFFSET_NS if self.state == "Slave" else 0)
        elif self.state in features.description.entries(name):
            features.put(name, self.state)

    def _state(self, now_ns: int) -> str:
        if self._since_ns is None:
            return "Disabled"
        left_s, last = (now_ns - self._since_ns) * 1e-9, self._device.faults.ptp_ends_in
        for state, lasts_s in WAY:
            if left_s < lasts_s or state == last:
                return state
            left_s -= lasts_s
        return last
