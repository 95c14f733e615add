"""The interface of a camera, independent of its backend.

A camera fills slots of the ring from a thread of its own: every slot of a coming run is queued before the first pulse,
and each pulse fills the next one. The acquisition process reads `Arrival`s from one queue for all cameras. No pixel is
read here.
"""

from __future__ import annotations

from dataclasses import dataclass
from queue import SimpleQueue
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from vaoi_station.acquisition.clocks import ClockReading
from vaoi_station.errors import VaoiError


@dataclass(frozen=True)
class Slot:
    """Memory for one frame: its number in the ring and a writable byte view of exactly one frame."""

    number: int
    memory: NDArray[np.uint8]


@dataclass(frozen=True)
class Arrival:
    """A slot that a camera has finished with.

    `frame_id` and `time_s` are None unless `complete`: an incomplete GigE frame repeats those of an older frame.
    """

    camera: int
    slot: int
    complete: bool
    frame_id: int | None
    time_s: float | None
    """Start of exposure by the camera's clock."""
    host_time_s: float
    """time.monotonic() when the slot was delivered."""
    fault: str = ""
    """What the backend found wrong, for the cause of the verdict; empty if nothing."""


@dataclass(frozen=True)
class CameraHealth:
    """The state of one camera, for status pages."""

    connected: bool
    message: str = ""
    temperature_c: float | None = None
    delivered: int = 0
    incomplete: int = 0
    last_frame_s: float | None = None
    """time.monotonic() when the last complete frame was delivered."""
    counters: tuple[tuple[str, int], ...] = ()
    """Counters of the driver by name, for diagnosis."""
    next_try_s: float | None = None
    """time.monotonic() of the next attempt to open a camera that is not connected; None during an attempt."""
    action: str = ""
    """What to do about a camera that is not connected, where that is known."""


@dataclass(frozen=True)
class DeviceFault:
    """A fault in a device's own thread; it goes through the queue of the device's events."""

    device: str
    error: VaoiError


@dataclass(frozen=True)
class CameraLost:
    """A camera stopped answering; its backend continues to look for it."""

    camera: int
    since_s: float
    """Earliest time.monotonic() at which it may have been away."""
    why: str
    """The reason in a few words, for the causes of the frames that it misses."""
    error: VaoiError


@dataclass(frozen=True)
class CameraBack:
    """A lost camera delivers again; its clock may have restarted."""

    camera: int
    at_s: float
    reading: ClockReading
    """A reading of its clock, taken before its first frame."""


CameraEvent = Arrival | CameraLost | CameraBack | DeviceFault


class CameraDevice(Protocol):
    """One camera of the array, opened and in trigger mode."""

    def start(self, events: SimpleQueue[CameraEvent]) -> None:
        """Begin to deliver; put every finished slot and every change of state into `events`."""

    def queue(self, slot: Slot) -> None:
        """Queue memory for a coming frame; slots are filled in the order in which they were queued."""

    def take_back(self) -> list[int]:
        """Withdraw the slots that were queued and not used; return their numbers."""

    def read_clock(self) -> ClockReading:
        """Compare the camera's clock with the host's; may block for seconds."""

    def health(self) -> CameraHealth:
        """Return the camera's state; never blocks."""

    def close(self) -> None:
        """Stop delivery and release the camera; no slot is written to afterwards."""
