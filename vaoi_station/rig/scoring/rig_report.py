"""The report of `vaoi rig run`: a JSON document for programs. `tables` formats it as text for people."""

from __future__ import annotations

from vaoi_station.demo.truth_comparison import Deviation
from vaoi_station.model import Strict

LIMIT_PX = 0.10
"""Largest accepted rms position error of components, over all boards with the verdict ok. Runs with another verdict do
not count, because their results state a larger uncertainty.
"""
LATE_MS = 300.0
"""Delay from a pulse to the first packet of a frame above which the frame may arrive too late for the station."""
READY_LIMIT_S = 12.0
"""Longest accepted time from the recovery of a device until the station is ready again."""


class AffectedFrame(Strict):
    """A frame that the station reports as incomplete or missing, with the fault that the rig injected."""

    camera: int
    row: int
    verdict: str
    """`incomplete` or `missing`, as the station reports it."""
    cause: str
    """Cause that the station reports."""
    done: str
    """Fault that the rig injected; empty: none."""


class BoardScore(Strict):
    """The score of one board: its run compared with the truth, the rendered frames and the injected faults."""

    board: int
    run: str | None
    """Id of the run by which the station recorded this board; None if there is no such run."""
    state: str | None
    status: str | None
    armed_id: str | None
    """Board id with which the station was armed for this board; None if it was not armed for it."""
    board_id: str | None
    """Board id of the station's run; None: the run has none."""
    reasons: tuple[str, ...]
    cameras: int
    rows: int
    """Number of pulses that were fired."""
    rows_due: int
    """Number of pulses that the board needs to be filmed completely."""
    ok: int
    incomplete: int
    missing: int
    proven: int | None
    """Number of complete frames whose pixels all equal the frame rendered for that camera and row; None: unchecked."""
    wrong: tuple[str, ...]
    """Descriptions of frames whose pixels differ from the rendered frame."""
    mislit: tuple[str, ...] = ()
    """Descriptions of frames whose light or exposure the station states otherwise than the chip fired them."""
    affected: tuple[AffectedFrame, ...]
    innocent: tuple[tuple[int, int], ...]
    """(camera, row) of incomplete or missing frames without an injected fault."""
    unnamed: tuple[tuple[int, int], ...]
    """(camera, row) of incomplete or missing frames for which the station reports no cause."""
    unfilmed: int
    """Number of frames that were fired but that the station's run does not list."""
    pulse_off_us: float
    """Largest difference between a pulse and the time for which its frames were rendered."""
    sent_late_ms: float | None
    """Longest time from a pulse to the first packet of a frame; None: at least one frame never left its camera."""
    notes: tuple[str, ...]
    deviation: Deviation
    ready_after_last_frame_ms: float | None
    links_open: int | None
    """Number of stitching tasks not done when the last frame arrived. Tasks of the last row can only begin then."""

    held_s: float | None = 0.0
    """Time, s, for which the conveyor held the board back until the output "line ready" was on; None: it did not come
    on, and the board passed nevertheless."""

    @property
    def sound(self) -> bool:
        """Whether no frame is in a wrong row, no frame is lost without a fault, and every loss has a cause."""
        proven = self.proven is None or self.proven == self.ok
        return proven and not (self.wrong or self.mislit or self.innocent or self.unnamed or self.notes)

    @property
    def faultless(self) -> bool:
        """Whether the score is sound, all frames arrived, and the run has the verdict ok."""
        return self.sound and self.status == "ok" and self.ok == self.rows_due * self.cameras


class Recovery(Strict):
    """Recovery of the station from one fault: when the device worked again, and when the station was ready again."""

    fault: str
    back_s: float
    """Time since the start of the rig at which the device worked again."""
    ready_after_s: float | None
    """Time from the recovery of the device until the station was ready with all cameras; None: it was not."""


class Load(Strict):
    """The average number of busy CPU cores, by kind of process: CPU time divided by the measured time `over_s`."""

    over_s: float
    station: float
    acquisition: float
    workers: float
    cameras: float
    """Cores used by the virtual cameras, which replace real cameras and a network card."""
    chip: float
    rig: float
    acquisition_ms_per_frame: float


class RigReport(Strict):
    """The document that `vaoi rig run --json` writes."""

    format: str = "vaoi-rig"
    version: int = 3
    ok: bool
    scenario: str
    cameras: int
    width_px: int
    height_px: int
    frames_per_s: float
    """Frame rate of each camera while a board passes."""
    faults: tuple[str, ...]
    boards: tuple[BoardScore, ...]
    runs: int
    """Number of runs of the station; more than `boards` if other boards followed closely."""
    boards_missed: int
    stray_pulses: int
    rms_px: float
    """Rms position error over all views of components, of all boards with the verdict ok."""
    max_px: float
    recoveries: tuple[Recovery, ...]
    load: Load | None
    machine_load: float
    """Load average of the machine over the last minute, at the end."""
    took_s: float
    failings: tuple[str, ...]
    """The reasons why `ok` is false, one sentence each."""
