"""The pulses of a run and the final state of each frame."""

from __future__ import annotations

from enum import StrEnum

from vaoi_station.model.frozen_model import FrozenModel


class Verdict(StrEnum):
    """The final state of one (camera, row) of a run."""

    OK = "ok"
    INCOMPLETE = "incomplete"
    MISSING = "missing"


class FrameRecord(FrozenModel):
    """One (camera, row) of a run: its slot, its final state and the cause, its times and exposure."""

    camera: int
    row: int
    verdict: Verdict
    cause: str = ""
    slot: int | None = None
    """Slot of the ring; None if no frame arrived."""
    frame_id: int | None = None
    camera_time_s: float | None = None
    pulse_error_us: float | None = None
    """Time stamp minus pulse time, both mapped to the host's clock."""
    exposure_us: float | None = None
    """Exposure time of the frame, if known."""
    light: str = ""
    """Light pattern of its row."""


class Pulse(FrozenModel):
    """One trigger pulse of all cameras; the time is that of the controller's clock."""

    index: int
    time_s: float
    light: str = ""
