"""One pulse and one frame as the recorder observes them, in device time and in host time."""

from __future__ import annotations

from dataclasses import dataclass

from vaoi_station.model import Pulse


@dataclass(frozen=True)
class ObservedPulse:
    """A pulse that the controller reported."""

    pulse: Pulse
    host_s: float
    """Host time at which it was fired."""
    exposures_us: tuple[float, ...] = ()
    """Exposure of every camera; empty where the controller does not report them."""
    reported_s: float = float("inf")
    """Host time at which the controller's report of it was received."""


@dataclass(frozen=True)
class ObservedFrame:
    """A complete frame."""

    row: int | None
    """The row it is assigned to; None for an unassigned frame."""
    frame_id: int | None
    time_s: float
    """Time stamp by the camera's clock."""
    host_s: float
    """The time stamp on the host's clock."""
    arrived_s: float
    """Host time of its arrival."""
    epoch: int = 0
    """Count of outages of its camera before it. Frames of one epoch share one clock and one frame counter."""
