"""What the station says of itself: frozen shapes, dumped to JSON as they stand.

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


class Shape(BaseModel):
    """Frozen, no unknown keys; dumps to JSON as it stands."""

    model_config = ConfigDict(frozen=True, extra="forbid")


class Reason(Shape):
    """Why something is as it is, and what to do about it."""

    code: str
    message: str
    action: str = ""

    @staticmethod
    def of(error: VaoiError) -> Reason:
        """What an error says."""
        return Reason(code=error.code, message=error.message, action=error.action)


class ArmedWith(Shape):
    """What the next boards are taken for; ids are the caller's own and echoed in every result."""

    board_type: str
    board_id: str | None
    job_id: str | None
    runs_left: int | None
    """Runs until the station disarms by itself; None: it stays armed."""
    method: MethodName = "auto"
    reference: str | None = None
    """The run that boards are placed against; None: no reference is used."""


class CameraStatus(Shape):
    """One camera as the acquisition process last saw it."""

    camera: int
    name: str
    connected: bool
    message: str = ""
    temperature_c: float | None = None
    delivered: int = 0
    incomplete: int = 0
    last_frame_age_s: float | None = None
    """Since its last whole frame, at the last sign of life; None before the first."""
    next_try: str | None = None
    """When it is opened again; None while it is connected, or is being opened."""
    counters: dict[str, int] = {}
    """What its driver counts, by the driver's names, for diagnosis."""


STARTING = "starting"
"""What a process does before its first word."""
WAITING = "waiting for the workers"
"""What the acquisition process does before it is begun for the first time."""


class ProcessStatus(Shape):
    """One of our processes: "acquisition", "worker 0", …"""

    name: str
    pid: int | None
    alive: bool
    restarts: int
    heartbeat_age_s: float | None
    """Since its last sign of life; None before the first."""
    doing: str = ""
    next_try: str | None = None
    """When it is started again; None while it lives, or is being started."""


class LeaseStatus(Shape):
    """Somebody uses a run's frames; its memory is not given away meanwhile."""

    run: str
    holder: str
    purpose: str
    expires_in_s: float


class BayStatus(Shape):
    """Memory for one run."""

    bay: int
    use: Literal["free", "granted", "filming", "stitching", "finished"]
    run: str | None


class RingStatus(Shape):
    """The shared memory for frames: where, how large, who uses it."""

    path: str
    size_bytes: int
    bays: tuple[BayStatus, ...]
    leases: tuple[LeaseStatus, ...]


class Retention(Shape):
    """What is kept how long."""

    runs_in_memory: int
    """Bays of the ring; one of them is filmed into, one is ready for the next board."""
    lease_s: float
    frames: str
    results: str
    events: str


class Versions(Shape):
    """What computed the results."""

    station: str
    opencv: str
    python: str


class StationSnapshot(Shape):
    """The station at one moment."""

    name: str
    state: StationState
    since: str
    reasons: tuple[Reason, ...]
    """Why it is in this state."""
    warnings: tuple[Reason, ...] = ()
    """What does not keep it from filming, but should be seen to."""
    armed_with: ArmedWith | None
    cameras: tuple[CameraStatus, ...]
    all_cameras_ready: bool
    """False: a board that came now would be filmed with gaps, if at all."""
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


class BoardTypeSummary(Shape):
    """One entry of the list of board types; `fault` says why its file cannot be used."""

    name: str
    side: str = "top"
    unit: str = "mm"
    components: int = 0
    fiducials: int = 0
    fault: Reason | None = None


class ReferenceRecord(Shape):
    """A run that was taught as the reference of its board type."""

    run: str
    taught: str
    calibration: str
    """Digest of the calibration it was filmed with."""
    cameras: int
    rows: int
    frames: int
    """How many were kept: a small set of each row."""
    size_bytes: int
    cad_sigma_px: float | None
    """How well its own positions are known: of one standard deviation, at the worst corner of the board."""


class ReferenceStatus(ReferenceRecord):
    """The same, and whether boards can be placed against it now."""

    board_type: str
    usable: bool
    fault: Reason | None = None
    """Why not."""


class StitchingMethod(Shape):
    """How runs of a board type are stitched."""

    method: MethodName
    chosen: Literal["board-type", "station"]
    """Whether the board type has a way of its own, or the station's holds."""


class VerdictCounts(Shape):
    """How the frames of a run ended."""

    ok: int
    incomplete: int
    missing: int


class BeltSpeed(Shape):
    """The belt as this board saw it, in tester coordinates."""

    nominal_mm_s: tuple[float, float]
    measured_mm_s: tuple[float, float]
    ratio: float
    """Measured over nominal speed."""


class Timings(Shape):
    """Where the time went; host clock."""

    filming_s: float
    """From the barrier to the last frame."""
    ready_after_last_frame_ms: float | None
    """From the last frame's arrival to the finished matrices."""
    links_ms: float
    """Workers' time spent on links, summed."""
    conclude_ms: float
    """Worker's time for adjustment and CAD mapping."""
    links: int
    links_while_filming: int
    """Links that existed before the last frame arrived."""


class RunSummary(Shape):
    """One board's passage, in a line."""

    id: str
    board_type: str
    board_id: str | None
    job_id: str | None
    state: RunState
    verdict: Status | None
    """The stitch's; None while there is none. Outlives the frames."""
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
    """One board's passage with the verdict of every (camera, row)."""

    frames: tuple[FrameRecord, ...]
    ended: str
    """Why the pulses ended: "clear" (the board left), "max-rows", …; "" while filming."""
    strays: int
    """Frames that belonged to no pulse."""
    proof: TriggerProof | None = None
    """That every frame belongs to its pulse, or what speaks against it; None while filming."""
    software: Versions
    calibration: str
    """Digest of the calibration it was stitched with."""


class TaskTiming(Shape):
    """One piece of work of a run; seconds since the barrier's edge, host clock."""

    kind: str
    camera: int
    row: int
    other_camera: int | None
    other_row: int | None
    ready_s: float
    """When its last frame had settled."""
    done_s: float
    worker_ms: float


class Timeline(Shape):
    """When what happened in a run; seconds since the barrier's edge, host clock."""

    frames_settled_s: tuple[tuple[int, int, float], ...]
    """(camera, row, when)."""
    tasks: tuple[TaskTiming, ...]
    last_frame_s: float
    ready_s: float | None


class ComponentSummary(Shape):
    """One component of a run's board type, and where it was."""

    address: str
    ref: str
    panel: str | int | None
    center_mm: tuple[float, float]
    """CAD, in mm."""
    width_mm: float
    height_mm: float
    rotation_deg: float
    tester_mm: tuple[float, float] | None
    """Place at the first row, tester coordinates; None without a CAD mapping."""
    views: int
    """Frames in which its middle lies."""


class EventRecord(Shape):
    """Something that happened, numbered from 1 without gaps; kept over restarts."""

    number: int
    time: str
    kind: str
    """"station" and "run" (a new `state`), "armed", "board-missed", "trouble", "process", "board-type", …"""
    state: str = ""
    run: str | None = None
    code: str = ""
    message: str = ""
    action: str = ""
