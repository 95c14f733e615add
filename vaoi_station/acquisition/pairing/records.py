"""What is known of one pulse, and of one frame, when a run is put together."""

from __future__ import annotations

from dataclasses import dataclass

from vaoi_station.model import Pulse


@dataclass(frozen=True)
class KnownPulse:
    """A pulse and the host time it was fired at."""

    pulse: Pulse
    host_s: float
    exposures_us: tuple[float, ...] = ()
    heard_s: float = float("inf")
    """Host time at which the controller's report of it was heard."""


@dataclass(frozen=True)
class Seen:
    """A whole frame."""

    row: int | None
    """None: it belongs to none."""
    frame_id: int | None
    time_s: float
    """By the camera's clock."""
    host_s: float
    """The same on the host's clock."""
    arrived_s: float
    epoch: int = 0
    """Frames of one epoch have one clock and one count: it goes up when the camera was lost and came back."""
