"""What the recorder asks of a camera, whatever drives it.

A camera fills slots of the ring by itself, in a thread of its own: before the first pulse every slot
of the coming run is queued; each pulse fills the next one. The recorder pulls `Arrival`s from one
queue for all cameras. Nothing here looks at pixels.
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
    """What a camera says of one slot it has finished with.

    Without `complete`, trust nothing: `frame_id` and `time_s` are None where the camera's word would
    be stale (`notes`: an incomplete GigE frame repeats an older id).
    """

    camera: int
    slot: int
    complete: bool
    frame_id: int | None
    time_s: float | None
    """Start of exposure by the camera's own clock."""
    host_time_s: float
    """time.monotonic() when the slot was handed over."""
    fault: str = ""
    """The backend's word for what went wrong, for the verdict's cause."""


@dataclass(frozen=True)
class CameraHealth:
    """What a status page shows of one camera."""

    connected: bool
    message: str = ""
    temperature_c: float | None = None
    delivered: int = 0
    incomplete: int = 0
    last_frame_s: float | None = None
    """time.monotonic() when the last whole frame was handed over."""
    counters: tuple[tuple[str, int], ...] = ()
    """The driver's own, by name, for diagnosis."""
    next_try_s: float | None = None
    """time.monotonic() when one that is not connected is opened again; None while it is being opened."""
    action: str = ""
    """What to do about one that is not connected, where that is known."""


@dataclass(frozen=True)
class DeviceFault:
    """A device's own thread ran into trouble; it goes the way of its news."""

    device: str
    error: VaoiError


@dataclass(frozen=True)
class CameraLost:
    """A camera does not answer any more; its backend goes on looking for it."""

    camera: int
    since_s: float
    """time.monotonic() since when it may have been away."""
    why: str
    """In a few words, for the causes of what it misses."""
    error: VaoiError


@dataclass(frozen=True)
class CameraBack:
    """A camera that was lost films again; its clock may have started anew."""

    camera: int
    at_s: float
    reading: ClockReading


CameraNews = Arrival | CameraLost | CameraBack | DeviceFault


class CameraDevice(Protocol):
    """One camera of the array, opened and in trigger mode."""

    def start(self, arrivals: SimpleQueue[CameraNews]) -> None:
        """Begin to deliver; every finished slot is announced in `arrivals`."""

    def queue(self, slot: Slot) -> None:
        """Offer memory for a coming frame; slots are filled in the order they were queued."""

    def take_back(self) -> list[int]:
        """Withdraw the slots that were queued and not used; their numbers."""

    def read_clock(self) -> ClockReading:
        """Compare the camera's clock with the host's; called from a thread of its own, as it may take seconds."""

    def health(self) -> CameraHealth:
        """The camera's state; never blocks."""

    def close(self) -> None:
        """Stop delivering and release the camera; no slot is written to afterwards."""
