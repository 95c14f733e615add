"""Documents about station and runs: frozen schemas, dumped to JSON unchanged.

Times are RFC 3339 in UTC where they name a moment and seconds or milliseconds where they name a
span; cameras and rows count from 0.
"""

from __future__ import annotations

from typing import Literal

from pydantic import BaseModel, ConfigDict

from vaoi_station.acquisition.pairing.proof import TriggerProof
from vaoi_station.config import MethodName
from vaoi_station.errors import VaoiError
from vaoi_station.model import FrameRecord, Status
from vaoi_station.runs.states.tables import RunState, StationState

ImageFormat = Literal["png", "jpeg", "tiff", "npy"]


class Schema(BaseModel):
    """Base of all documents: frozen, without unknown keys."""

    model_config = ConfigDict(frozen=True, extra="forbid")


class Reason(Schema):
    """Explanation of a state or verdict, and what to do about it."""

    code: str
    message: str
    action: str = ""

    @staticmethod
    def of(error: VaoiError) -> Reason:
        """Return the reason that an error stands for."""
        return Reason(code=error.code, message=error.message, action=error.action)


class ArmedWith(Schema):
    """The order in force for the next boards; the caller's ids are returned with every result."""

    board_type: str
    board_id: str | None
    job_id: str | None
    runs_left: int | None
    """Runs until the station disarms automatically; None: it stays armed."""
    method: MethodName = "auto"
    reference: str | None = None
    """The run against which boards are placed; None: no reference is used."""


class CameraStatus(Schema):
    """State of one camera at the last heartbeat of the acquisition process."""

    camera: int
    name: str
    connected: bool
    message: str = ""
    temperature_c: float | None = None
    delivered: int = 0
    incomplete: int = 0
    last_frame_age_s: float | None = None
    """Time since its last whole frame, at the last heartbeat; None before the first."""
    next_try: str | None = None
    """Time of the next attempt to open it; None while it is connected or being opened."""
    counters: dict[str, int] = {}
    """Counters of its driver, by the driver's names, for diagnosis."""


STARTING = "starting"
"""`doing` of a process before its first message."""
WAITING = "waiting for the workers"
"""`doing` of the acquisition process before its first start."""


class ProcessStatus(Schema):
    """State of one process of the station: "acquisition", "worker 0", …"""

    name: str
    pid: int | None
    alive: bool
    restarts: int
    heartbeat_age_s: float | None
    """Time since its last message; None before the first."""
    doing: str = ""
    next_try: str | None = None
    """Time of the next start; None while it runs or is being started."""


class LeaseStatus(Schema):
    """A holder's time-limited right to a run's frames; they are not evicted meanwhile."""

    run: str
    holder: str
    purpose: str
    expires_in_s: float


class BayStatus(Schema):
    """Memory for the frames of one run."""

    bay: int
    use: Literal["free", "granted", "filming", "stitching", "finished"]
    run: str | None


class RingStatus(Schema):
    """The shared memory for frames: path, size, use."""

    path: str
    size_bytes: int
    bays: tuple[BayStatus, ...]
    leases: tuple[LeaseStatus, ...]


class Retention(Schema):
    """What is kept, and for how long."""

    runs_in_memory: int
    """Bays of the ring; one of them is filmed into, one is ready for the next board."""
    lease_s: float
    frames: str
    results: str
    events: str


class Versions(Schema):
    """Versions of the software that computed the results."""

    station: str
    opencv: str
    python: str


class StationSnapshot(Schema):
    """State of the station at one moment."""

    name: str
    state: StationState
    since: str
    reasons: tuple[Reason, ...]
    """Reasons for this state."""
    warnings: tuple[Reason, ...] = ()
    """Conditions that do not prevent filming but need attention."""
    armed_with: ArmedWith | None
    cameras: tuple[CameraStatus, ...]
    all_cameras_ready: bool
    """False: the next board would be filmed with gaps, if at all."""
    controller: str
    processes: tuple[ProcessStatus, ...]
    ring: RingStatus
    versions: Versions
    retention: Retention
    last_run: str | None
    """The run that finished last; None before the first."""
    filming: str | None
    """The run being filmed."""
    last_event: int
    """Number of the newest event; 0 before the first."""
    boards_missed: int


class BoardTypeSummary(Schema):
    """One entry of the list of board types; `fault` is set if its file cannot be used."""

    name: str
    side: str = "top"
    unit: str = "mm"
    components: int = 0
    fiducials: int = 0
    fault: Reason | None = None


class ReferenceRecord(Schema):
    """A run that is kept as the reference of its board type."""

    run: str
    taught: str
    calibration: str
    """Digest of the calibration it was filmed with."""
    cameras: int
    rows: int
    frames: int
    """Number of frames kept: a small set of each row."""
    size_bytes: int
    cad_sigma_px: float | None
    """Standard deviation of its CAD positions at the worst corner of the board."""


class ReferenceStatus(ReferenceRecord):
    """A reference, and whether boards can be placed against it now."""

    board_type: str
    usable: bool
    fault: Reason | None = None
    """Reason why it is not usable."""


class StitchingMethod(Schema):
    """Method by which runs of a board type are stitched."""

    method: MethodName
    chosen: Literal["board-type", "station"]
    """Whether it is the board type's own method or that of the station."""


class VerdictCounts(Schema):
    """Numbers of frames of a run by verdict."""

    ok: int
    incomplete: int
    missing: int


class BeltSpeed(Schema):
    """Belt speed measured from this board, in tester coordinates."""

    nominal_mm_s: tuple[float, float]
    measured_mm_s: tuple[float, float]
    ratio: float
    """Measured over nominal speed."""


class Timings(Schema):
    """Durations of the steps of a run; host clock."""

    filming_s: float
    """From the barrier to the last frame."""
    ready_after_last_frame_ms: float | None
    """From the last frame's arrival to the finished matrices."""
    links_ms: float
    """Sum of the workers' time for links."""
    conclude_ms: float
    """Worker's time for the adjustment and the CAD mapping."""
    links: int
    links_while_filming: int
    """Links that were computed before the last frame arrived."""


class RunSummary(Schema):
    """One run, without its frames."""

    id: str
    board_type: str
    board_id: str | None
    job_id: str | None
    state: RunState
    verdict: Status | None
    """Verdict of the stitch; None while there is none. Kept when the frames are gone."""
    started: str
    finished: str | None
    rows: int
    cameras: int
    counts: VerdictCounts
    reasons: tuple[Reason, ...]
    belt: BeltSpeed | None
    timings: Timings | None
    frames_available: bool


class RunDetail(RunSummary):
    """One run with the verdict of every (camera, row)."""

    frames: tuple[FrameRecord, ...]
    ended: str
    """Cause of the end of the pulses: "clear" (the board left), "max-rows", …; "" while filming."""
    strays: int
    """Number of frames that belong to no pulse."""
    proof: TriggerProof | None = None
    """Evidence that every frame belongs to its pulse, with findings against it; None while filming."""
    software: Versions
    calibration: str
    """Digest of the calibration with which it was stitched."""


class TaskTiming(Schema):
    """One task of a run; seconds since the barrier's edge, host clock."""

    kind: str
    camera: int
    row: int
    other_camera: int | None
    other_row: int | None
    ready_s: float
    """When its last frame was settled."""
    done_s: float
    worker_ms: float


class Timeline(Schema):
    """Times of the steps of a run; seconds since the barrier's edge, host clock."""

    frames_settled_s: tuple[tuple[int, int, float], ...]
    """(camera, row, time)."""
    tasks: tuple[TaskTiming, ...]
    last_frame_s: float
    ready_s: float | None


class ComponentSummary(Schema):
    """One component of a run's board type, and its position."""

    address: str
    ref: str
    panel: str | int | None
    center_mm: tuple[float, float]
    """CAD position in mm."""
    width_mm: float
    height_mm: float
    rotation_deg: float
    tester_mm: tuple[float, float] | None
    """Position at the first row in tester coordinates; None without a CAD mapping."""
    views: int
    """Number of frames that show at least half of it."""


class EventRecord(Schema):
    """One entry of the event log, numbered from 1 without gaps; kept over restarts."""

    number: int
    time: str
    kind: str
    """"station" and "run" (a new `state`), "armed", "board-missed", "trouble", "process", "board-type", …"""
    state: str = ""
    run: str | None = None
    code: str = ""
    message: str = ""
    action: str = ""
