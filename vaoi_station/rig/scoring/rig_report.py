"""What `vaoi rig run` tells: one document for programs, tables for people."""

from __future__ import annotations

from vaoi_station.demo.deviation import Deviation
from vaoi_station.model import Strict

LIMIT_PX = 0.10
"""Component positions, root mean square over all boards whose runs are ok; others tell their own uncertainty."""
LATE_MS = 300.0
"""A frame that leaves its virtual camera later than this after its pulse may come too late for the station."""
READY_LIMIT_S = 12.0
"""From a device that is back to a station that is ready."""


class Named(Strict):
    """A frame that is not whole: what the station says of it, and what was done to it."""

    camera: int
    row: int
    verdict: str
    cause: str
    """The station's."""
    done: str
    """The rig's; empty: nothing."""


class BoardScore(Strict):
    """One board against truth and film."""

    board: int
    run: str | None
    """None: the station filmed nothing of it."""
    state: str | None
    status: str | None
    reasons: tuple[str, ...]
    cameras: int
    rows: int
    """Pulses that were fired."""
    rows_due: int
    """Pulses that the board should have had."""
    ok: int
    incomplete: int
    missing: int
    proven: int | None
    """Whole frames of which every pixel is the film's for their camera and row; None: nobody could look."""
    wrong: tuple[str, ...]
    """Frames with pixels of anything else."""
    affected: tuple[Named, ...]
    innocent: tuple[tuple[int, int], ...]
    """(camera, row) that are not whole although nothing was done to them."""
    unnamed: tuple[tuple[int, int], ...]
    """(camera, row) that are not whole and have no cause."""
    unfilmed: int
    """Frames that were fired and that the station says nothing about."""
    pulse_off_us: float
    """Largest difference between a pulse and the time its frames were rendered for."""
    sent_late_ms: float | None
    """From a pulse to the first packet of a frame, the longest of all; None: a frame never left its camera."""
    notes: tuple[str, ...]
    deviation: Deviation
    ready_after_last_frame_ms: float | None
    links_open: int | None
    """Tasks of the stitch that were not done when the last frame had come; those of the last row cannot be."""

    @property
    def sound(self) -> bool:
        """Nothing in a wrong row, nothing lost without a reason, nothing without a cause."""
        proven = self.proven is None or self.proven == self.ok
        return proven and not (self.wrong or self.innocent or self.unnamed or self.notes)

    @property
    def faultless(self) -> bool:
        """All of it was filmed, and stitched with a verdict of ok."""
        return self.sound and self.status == "ok" and self.ok == self.rows_due * self.cameras


class Recovery(Strict):
    """How long it took."""

    fault: str
    back_s: float
    """Since the rig's start, when the device was back."""
    ready_after_s: float | None
    """Until the station was ready again with all its cameras; None: it was not."""


class Load(Strict):
    """CPU time over the time from the first board to the last result, in cores."""

    over_s: float
    station: float
    acquisition: float
    workers: float
    cameras: float
    """The senders: they stand in for cameras and network card."""
    chip: float
    rig: float
    acquisition_ms_per_frame: float


class RigReport(Strict):
    """The document of `vaoi rig run --json`."""

    format: str = "vaoi-rig"
    version: int = 1
    ok: bool
    scenario: str
    cameras: int
    width_px: int
    height_px: int
    frames_per_s: float
    """Of each camera, while a board passes."""
    faults: tuple[str, ...]
    boards: tuple[BoardScore, ...]
    boards_missed: int
    stray_pulses: int
    rms_px: float
    """Over all views of components of all boards that are ok."""
    max_px: float
    recoveries: tuple[Recovery, ...]
    load: Load | None
    machine_load: float
    """Of the machine over the last minute, at the end."""
    took_s: float
    failings: tuple[str, ...]
    """Why it is not ok."""
