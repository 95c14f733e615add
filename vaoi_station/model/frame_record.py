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
    """The record of one frame of a run: slot in the ring, final state with its cause, times and exposure."""

    camera: int
    row: int
    verdict: Verdict
    cause: str = ""
    slot: int | None = None
    """Slot of the ring that holds the frame; None if no frame arrived."""
    frame_id: int | None = None
    camera_time_s: float | None = None
    pulse_error_us: float | None = None
    """Time stamp of the frame minus time of its pulse, both converted to the host's clock."""
    exposure_us: float | None = None
    """Time for which the frame was exposed, or for which LEDs of a light program lit it if that is shorter; None if
    unknown."""
    gain: float | None = None
    """Linear gain of the frame; None if unknown."""
    light: str = ""
    """Name of the light pattern of the frame's row."""
    proven: bool = True
    """Whether the frame belongs to its row as far as the proof of the run shows; otherwise `cause` states the doubt."""

    @property
    def usable(self) -> bool:
        """Whether the frame is complete and proven; no other frame is stitched or shown as a view of a component."""
        return self.verdict is Verdict.OK and self.proven


class Pulse(FrozenModel):
    """One trigger pulse, which all cameras receive. Its time is in seconds of the controller's clock."""

    index: int
    time_s: float
    light: str = ""
