"""The interface of a camera, independent of its backend.

A camera fills slots of the ring from a separate thread. All slots of a coming run are queued before its first pulse,
and each pulse fills the next queued slot. The acquisition process reads `Arrival`s from one queue for all cameras.
Pixels are not read at this level.
"""

from __future__ import annotations

from dataclasses import dataclass
from queue import SimpleQueue
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from vaoi_station.acquisition.clocks import ClockReading
from vaoi_station.errors import VaoiError
from vaoi_station.supervised_thread import SupervisedThread


@dataclass(frozen=True)
class Slot:
    """Memory for one frame: its number in the ring and a writable byte view of exactly one frame."""

    number: int
    memory: NDArray[np.uint8]
    room: int = 0
    """Bytes behind the view that the camera may write to as well, for chunk data."""


GAIN_TOLERANCE_DB = 0.3
"""Accepted difference of a gain: cameras have coarse steps of gain."""


def exposure_tolerance_us(exposure_us: float) -> float:
    """Return the accepted difference of an exposure, µs: some sensors round it to the time of a line of pixels."""
    return max(20.0, 0.01 * exposure_us)


@dataclass(frozen=True)
class StatedExposure:
    """What a frame states in its chunk data: the exposure with which the camera took it."""

    exposure_us: float
    gain_db: float | None


@dataclass(frozen=True)
class Arrival:
    """The report that a camera has delivered a frame, complete or not, into a slot.

    `frame_id` and `time_s` are None if the frame is incomplete: an incomplete GigE frame has the id and the time stamp
    of an older frame.
    """

    camera: int
    slot: int
    complete: bool
    frame_id: int | None
    time_s: float | None
    """Start of the exposure by the camera's clock, s; None if the frame is incomplete."""
    host_time_s: float
    """Time at which the camera delivered the slot, by time.monotonic()."""
    fault: str = ""
    """The defect that the backend found; it becomes the cause of the frame's verdict. Empty if there is none."""
    stated: StatedExposure | None = None
    """The exposure that the frame itself states; None if the camera adds no chunk data."""


@dataclass(frozen=True)
class CameraExposure:
    """How a camera exposes the rows of a run."""

    exposures_us: tuple[float, ...]
    """Exposure of the rows, in turn. They are equal unless the width of the trigger or the sequencer sets them."""
    gain_db: float
    by_trigger: bool = False
    sequence: tuple[tuple[float, float], ...] = ()
    """Exposure (µs) and gain (dB) of the sets of the camera's sequencer, which its frames use in turn; empty if the
    camera uses no sequencer."""


@dataclass(frozen=True)
class CameraLimits:
    """The exposures and gains that a camera can take, as lowest and highest value; None: it does not state them."""

    exposure_us: tuple[float, float] | None = None
    gain_db: tuple[float, float] | None = None
    sets: int | None = None
    """Number of sets of its sequencer; None without one."""
    row_s: float | None = None
    """Time in which the links carry a row of all cameras, s; None if their speeds are not known."""


@dataclass(frozen=True)
class CameraRecovery:
    """The latest step against a camera that hangs."""

    step: str
    """`reopen`, `restart`, `reset`, `power`, or `spent` once all were taken as often as permitted."""
    why: str
    """`silent`: it answers and sends nothing; `absent`: it does not answer although its link is up."""
    at_s: float
    """time.monotonic() of the step."""


@dataclass(frozen=True)
class CameraPtp:
    """What a camera whose clock is to follow a PTP master states of that."""

    state: str
    """By IEEE 1588: `Listening`, `Uncalibrated`, `Slave` …; empty if the camera does not state it."""
    offset_ns: int | None = None
    """Its clock minus that of its master; None if it does not state it."""
    epoch_ns: int = 0
    """Time of its clock from which the seconds of its readings count."""
    apart_s: float = 0.0
    """How far its clock certainly is from those of most others with PTP, or of the other half; 0 within bounds."""

    @property
    def synchronised(self) -> bool:
        """Whether it says that its clock is that of a master. A camera whose master has gone may still say so."""
        return self.state in ("Slave", "Master")


@dataclass(frozen=True)
class CameraHealth:
    """The state of one camera, for `GET station`, the page and `vaoi doctor`."""

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
    limits: CameraLimits | None = None
    """None for a camera without limits of its own, or one that is not connected."""
    serial: str = ""
    model: str = ""
    address: str = ""
    """What the camera at this place is; empty for one that is no device."""
    recovery: CameraRecovery | None = None
    """None for a camera that films, or was lost for another cause."""
    ptp: CameraPtp | None = None
    """None for a camera without `ptp`, or one that is not connected."""


def is_silent(health: CameraHealth) -> bool:
    """Return whether not one packet of a connected GigE camera has arrived since it was opened."""
    return health.connected and dict(health.counters).get("n_received_packets") == 0


@dataclass(frozen=True)
class DeviceFault:
    """A fault in the thread of a device, reported through the queue of the device's events."""

    device: str
    error: VaoiError


@dataclass(frozen=True)
class CameraLost:
    """The report that a camera stopped answering; its backend continues to search for it."""

    camera: int
    since_s: float
    """Earliest time.monotonic() from which on the camera may have been away."""
    why: str
    """Cause of the loss in a few words; it appears in the cause of every frame that is missing during the outage."""
    error: VaoiError


@dataclass(frozen=True)
class CameraBack:
    """The report that a lost camera delivers again; the camera's clock may have restarted."""

    camera: int
    at_s: float
    reading: ClockReading
    """A reading of the camera's clock, taken before its first frame after the outage."""


CameraEvent = Arrival | CameraLost | CameraBack | DeviceFault


class CameraDevice(Protocol):
    """One camera of the array, opened and in trigger mode."""

    def start(self, events: SimpleQueue[CameraEvent]) -> None:
        """Begin to deliver frames; put every delivered slot and every change of state into the queue `events`."""

    def set_exposure(self, wanted: CameraExposure) -> None:  # noqa: ARG002
        """Expose with these values from now on. Called while no pulse is fired.

        Raises:
            DeviceError: the camera refuses or ignores a value, cannot expose for the width of the trigger, or has no
                sequencer for these values. A camera that is lost takes the values when it is back.
        """
        return

    def rewind(self) -> None:
        """Let the next frame be exposed with the first set of the sequencer. Called between two runs.

        It does nothing without a sequencer. A camera that does not answer counts as lost; that is reported as usual.
        """
        return

    def sent_nothing(self, rows: int, since_s: float) -> None:  # noqa: ARG002
        """Note that no frame of this camera belongs to a run of this number of rows since a time of time.monotonic().

        Others filmed the run. Never blocks.
        """
        return

    def replace(self, serial: str, address: str) -> None:  # noqa: ARG002
        """Use the camera with this serial number from now on, with the settings of the one before.

        `address` is where it answers now. It is opened as soon as possible; only a real camera can be exchanged.
        """
        return

    def queue(self, slot: Slot) -> None:
        """Queue memory for a coming frame; slots are filled in the order in which they were queued."""

    def take_back(self) -> list[int]:
        """Withdraw the slots that were queued and are not used yet; return their numbers."""

    def read_clock(self) -> ClockReading:
        """Compare the camera's clock with the host's clock; this may block for seconds."""

    def health(self) -> CameraHealth:
        """Return the camera's state; never blocks."""

    def threads(self) -> tuple[SupervisedThread, ...]:
        """Return the threads of the camera, which must neither end nor hang while it is open."""

    def close(self) -> None:
        """Stop delivery and release the camera; after the return the camera writes to no slot."""
