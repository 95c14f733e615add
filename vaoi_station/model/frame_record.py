"""A run: its pulses, and what became of each of their frames."""

from __future__ import annotations

from enum import StrEnum

from vaoi_station.model.frozen_model import FrozenModel


class Verdict(StrEnum):
    """How one (camera, row) of a run ended."""

    OK = "ok"
    INCOMPLETE = "incomplete"
    MISSING = "missing"


class FrameRecord(FrozenModel):
    """One (camera, row) of a run: where its pixels are and what became of it."""

    camera: int
    row: int
    verdict: Verdict
    cause: str = ""
    slot: int | None = None
    """Slot of the ring; None where nothing arrived."""
    frame_id: int | None = None
    camera_time_s: float | None = None
    pulse_error_us: float | None = None
    """Time stamp minus pulse time, after mapping both clocks to the host's."""
    exposure_us: float | None = None
    """Exposure time of the frame, where it is known."""
    light: str = ""
    """Light pattern of its row."""


class Pulse(FrozenModel):
    """One trigger of all cameras, by the controller's clock."""

    index: int
    time_s: float
    light: str = ""
