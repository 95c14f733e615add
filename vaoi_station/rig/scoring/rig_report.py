"""The report of `vaoi rig run`: one document for programs, shown to people as tables."""

from __future__ import annotations

from vaoi_station.demo.truth_comparison import Deviation
from vaoi_station.model import Strict

LIMIT_PX = 0.10
"""Limit of the component positions, rms over all boards whose runs are ok; other runs state their own uncertainty."""
LATE_MS = 300.0
"""A frame that leaves its virtual camera later than this after its pulse may arrive too late for the station."""
READY_LIMIT_S = 12.0
"""Longest time from a recovered device to a ready station."""


class AffectedFrame(Strict):
    """A frame that is not whole: the station's verdict and cause, and the fault that the rig injected."""

    camera: int
    row: int
    verdict: str
    cause: str
    """The station's."""
    done: str
    """The rig's; empty: none."""


class BoardScore(Strict):
    """One board compared with the truth and the rendered frames."""

    board: int
    run: str | None
    """None: the station has no run of this board."""
    state: str | None
    status: str | None
    reasons: tuple[str, ...]
    cameras: int
    rows: int
    """Pulses that were fired."""
    rows_due: int
    """Pulses that the board needs."""
    ok: int
    incomplete: int
    missing: int
    proven: int | None
    """Whole frames whose pixels all equal the frame rendered for their camera and row; None: not checked."""
    wrong: tuple[str, ...]
    """Frames with other pixels."""
    affected: tuple[AffectedFrame, ...]
    innocent: tuple[tuple[int, int], ...]
    """(camera, row) that are not whole although no fault was injected."""
    unnamed: tuple[tuple[int, int], ...]
    """(camera, row) that are not whole and have no cause."""
    unfilmed: int
    """Frames that were fired and that the station's run does not list."""
    pulse_off_us: float
    """Largest difference between a pulse and the time for which its frames were rendered."""
    sent_late_ms: float | None
    """Longest time from a pulse to the first packet of a frame; None: a frame never left its camera."""
    notes: tuple[str, ...]
    deviation: Deviation
    ready_after_last_frame_ms: float | None
    links_open: int | None
    """Tasks of the stitch that were not done when the last frame had come; those of the last row never can be."""

    @property
    def sound(self) -> bool:
        """Whether no frame is in a wrong row, none is lost without a fault, and every loss has a cause."""
        proven = self.proven is None or self.proven == self.ok
        return proven and not (self.wrong or self.innocent or self.unnamed or self.notes)

    @property
    def faultless(self) -> bool:
        """Whether all frames arrived and were stitched with the verdict ok."""
        return self.sound and self.status == "ok" and self.ok == self.rows_due * self.cameras


class Recovery(Strict):
    """How long the station took after a fault."""

    fault: str
    back_s: float
    """Time since the start of the rig at which the device worked again."""
    ready_after_s: float | None
    """Time until the station was ready again with all its cameras; None: it was not."""


class Load(Strict):
    """CPU time divided by the time from the first board to the last result, in cores."""

    over_s: float
    station: float
    acquisition: float
    workers: float
    cameras: float
    """The virtual cameras, which stand for cameras and network card."""
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
    """Load average of the machine over the last minute, at the end."""
    took_s: float
    failings: tuple[str, ...]
    """The reasons why it is not ok."""
