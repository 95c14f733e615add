"""Schemas of the documents about the station and its runs. The documents are immutable and become JSON as they are.

Points in time are strings, RFC 3339 in UTC. Durations are numbers (`_s`, `_ms`). Cameras and rows count from 0.
"""

from __future__ import annotations

from typing import Literal

from pydantic import BaseModel, ConfigDict

from vaoi_station.acquisition.pairing.proof import TriggerProof
from vaoi_station.config import MethodName
from vaoi_station.errors import VaoiError
from vaoi_station.model import FrameRecord, Status
from vaoi_station.model.board_type import UnseenCause
from vaoi_station.runs.states.decision_schemas import Decision
from vaoi_station.runs.states.identity_schemas import IdentitySummary
from vaoi_station.runs.states.made_with import MadeWith, Origin
from vaoi_station.runs.states.storage_schemas import ArchiveStatus, SetAsideFile
from vaoi_station.runs.states.tables import RunState, StationState

ImageFormat = Literal["png", "jpeg", "tiff", "npy"]


class Schema(BaseModel):
    """Base class of all documents: immutable; unknown keys are refused."""

    # By default, pydantic keeps up to 16,384 texts that it has read from JSON: the ids and times of each run.
    model_config = ConfigDict(frozen=True, extra="forbid", cache_strings="keys")


class Reason(Schema):
    """Explanation of a state or verdict, with the action that the user can take."""

    code: str
    message: str
    action: str = ""
    cause: str = ""
    """For a reason of a run's result, its code in `reason_codes` of the matrices; otherwise empty."""

    @staticmethod
    def of(error: VaoiError) -> Reason:
        """Return a reason with the code, message and action of an error."""
        return Reason(code=error.code, message=error.message, action=error.action)


class ArmedWith(Schema):
    """The order in force for the next boards; the caller's ids are returned with every result."""

    board_type: str
    board_id: str | None
    job_id: str | None
    runs_left: int | None
    """Number of runs until the station disarms; None: it stays armed."""
    method: MethodName = "auto"
    reference: str | None = None
    """Id of the run against which boards are placed."""
    board_id_certain: bool = True
    """Whether `board_id` belongs to the next board. If not, a board may have passed without a run: arm again."""
    resumed: bool = False
    """Whether the order was in force before a restart and was taken up again by itself."""


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
    next_try: str | None = None
    """Time of the next attempt to open the camera; None while the camera is connected or being opened."""
    counters: dict[str, int] = {}
    """Counters of the camera's driver for diagnosis, with the names that the driver uses."""


STARTING = "starting"
"""Value of `ProcessStatus.doing` for a process before its first message."""
WAITING = "waiting for the workers"
"""Value of `ProcessStatus.doing` for the acquisition process before its first start."""


class ProcessStatus(Schema):
    """State of one process of the station. Its name is "acquisition", "fork server", "worker 0", "worker 1", …"""

    name: str
    pid: int | None
    alive: bool
    restarts: int
    heartbeat_age_s: float | None
    """Time since the last message of the process; None before the first message."""
    doing: str = ""
    progress: str = ""
    """How far the start of the fork server has come, for which workers wait; empty if unknown, and afterwards."""
    next_try: str | None = None
    """Time of the next start of the process; None while the process runs or is being started."""


class LeaseStatus(Schema):
    """A holder's time-limited right to the frames of a run. The frames are not evicted during this time."""

    run: str
    holder: str
    purpose: str
    expires_in_s: float


class BayStatus(Schema):
    """Memory for the frames of one run, and its present use."""

    bay: int
    use: Literal["free", "granted", "filming", "stitching", "finished"]
    run: str | None
    generation: int = 0
    """Generation of the bay in the table of the ring; it is raised when the bay is given to another run."""


class RingStatus(Schema):
    """The shared memory for frames: its path, its size, and its use by runs."""

    path: str
    size_bytes: int
    bays: tuple[BayStatus, ...]
    leases: tuple[LeaseStatus, ...]


class Retention(Schema):
    """Which data the station keeps, and for how long."""

    runs_in_memory: int
    """Number of bays of the ring. One bay receives the frames of the present board, one is kept for the next board."""
    lease_s: float
    """Time after which a hold ends unless it is renewed."""
    keep_s: float = 0.0
    """Time from the announcement of a run during which its frames are not evicted."""
    frames: str
    results: str
    events: str
    recordings: int = 0
    """Number of runs whose frames are kept on disk as recordings."""
    recordings_bytes: int = 0
    recordings_late: int = 0
    """Number of runs since the start whose memory was needed before their frames were on disk."""
    recordings_refused: int = 0
    """Number of runs since the start whose frames were not kept because of the quota, the disk or a fault."""
    mosaics: int = 0
    """Number of runs of which a small picture of the whole board is kept."""
    mosaics_bytes: int = 0
    archive: ArchiveStatus | None = None
    """The archive to which runs are handed; None if none is configured."""


class Versions(Schema):
    """Versions of the software that computed the results."""

    station: str
    opencv: str
    python: str


class LineOutputStatus(Schema):
    """The controller's output "line ready" at the last heartbeat of the acquisition process."""

    high: bool
    """Whether the output lets a conveyor bring the next board."""
    why: str = ""
    """Why the output is low; empty if it is high."""


class StationSnapshot(Schema):
    """State of the station at one moment."""

    name: str
    state: StationState
    since: str
    reasons: tuple[Reason, ...]
    """Reasons for the present state."""
    warnings: tuple[Reason, ...] = ()
    """Conditions that do not prevent filming but need attention."""
    set_aside: tuple[SetAsideFile, ...] = ()
    """Databases that were set aside; an administrator acknowledges the warning about each."""
    armed_with: ArmedWith | None
    next_order: ArmedWith | None = None
    """Order that takes effect when the board that passes has left; None if there is none."""
    cameras: tuple[CameraStatus, ...]
    all_cameras_ready: bool
    """Whether all cameras are connected. If False, the next board is filmed with gaps or not at all."""
    line_ready: bool = False
    """Whether the next board may come: it would be filmed by all cameras, and its result kept on disk."""
    line_held: tuple[Reason, ...] = ()
    """Why the next board must wait; empty exactly if `line_ready` is True."""
    line_output: LineOutputStatus | None = None
    """The controller's output "line ready", which a conveyor obeys; None if it is not used or there is none."""
    controller: str
    processes: tuple[ProcessStatus, ...]
    ring: RingStatus
    versions: Versions
    retention: Retention
    last_run: str | None
    """Id of the run that finished last; None if no run has finished yet."""
    filming: str | None
    """Id of the run that is being filmed; None if no board is passing."""
    last_event: int
    """Number of the newest event; 0 if there is no event yet."""
    boards_missed: int
    times_blocked: int = 0
    """How often the armed line had no memory for the next board since the station was started."""


class BoardTypeSummary(Schema):
    """One entry of the list of board types; `fault` is set if its file cannot be used."""

    name: str
    revision: str | None = None
    """Revision of the product's data, as its owner names it."""
    state: str = "approved"
    side: str = "top"
    unit: str = "mm"
    components: int = 0
    fiducials: int = 0
    fault: Reason | None = None


class VerdictCounts(Schema):
    """Numbers of frames of a run by verdict. Frames that are not proven to belong to their row are not among `ok`."""

    ok: int
    incomplete: int
    missing: int
    unproven: int = 0


class BeltSpeed(Schema):
    """Belt velocity (x, y) in tester coordinates: nominal, and as measured from this board."""

    nominal_mm_s: tuple[float, float]
    measured_mm_s: tuple[float, float]
    ratio: float
    """Measured speed divided by nominal speed."""


class Timings(Schema):
    """Durations of the steps of a run, by the host's clock."""

    filming_s: float
    """Time from the board's arrival at the barrier to the arrival of the last frame."""
    ready_after_last_frame_ms: float | None
    """Time from the arrival of the last frame to the finished matrices; None without matrices."""
    links_ms: float
    """Total time that the workers took for the tasks of the run."""
    conclude_ms: float
    """Time that a worker took for the adjustment and the CAD mapping."""
    links: int
    """Number of tasks that the workers performed for the run."""
    links_while_filming: int
    """Number of these tasks that were done before the last frame arrived."""


class RunSummary(Schema):
    """One run, without its frames."""

    id: str
    board_type: str
    board_id: str | None
    job_id: str | None
    state: RunState
    verdict: Status | None
    """Verdict of the result; None while there is no result. It stays when the frames are gone."""
    started: str
    finished: str | None
    rows: int
    cameras: int
    counts: VerdictCounts
    reasons: tuple[Reason, ...]
    belt: BeltSpeed | None
    timings: Timings | None
    frames_available: bool
    stored: bool = True
    """Whether the run is on disk. False: it is under way, or the storage takes no writes and it is in memory only."""
    frames_kept_until: str | None = None
    """Time until which frames stay unless released; later only while they are held or their memory is not needed."""
    forgotten: bool = False
    """Whether only this summary is kept; requests for the run are refused with 410 `run-forgotten`."""
    pinned: bool = False
    """Whether the run is kept until a caller unpins it."""
    recording: bool = False
    """Whether its frames are kept on disk as a recording."""
    decision: Decision | None = None
    """What a person has decided about its pictures; None if there is no decision."""
    identity: IdentitySummary | None = None
    """Which board the run shows by its code; None if boards of its type have no codes."""
    origin: Origin | None = None
    """The station that filmed an imported run; None for runs of this station."""
    figures: dict[str, float] | None = None
    """Its figures by their names in `trends`, those of a part as `seam_px:0-1`; None if not asked for or not known."""

    @property
    def identity_decided(self) -> bool:
        """Whether no code of the board is still to be read, so that the verdict is not lowered for one any more."""
        return self.identity is None or self.identity.state != "pending"


class Interruption(Schema):
    """One interruption of the light barrier; times are in seconds since row 0, by the controller's clock."""

    blocked_s: float
    clear_s: float | None = None
    """None if the barrier was still interrupted when the run ended."""


class Unseen(Schema):
    """A component that the good frames of a run show too little of, by the `visibility` that is asked for."""

    address: str
    coverage: float
    """Share of the footprint that the good frames show together."""
    views: int
    """Number of good frames that show at least half of the footprint."""
    in_one_frame: bool
    cause: UnseenCause
    """Lost frames; frames that ended before or began after the component passed; a seam; beside the cameras."""


class RunDetail(RunSummary):
    """One run, with the verdict of every frame (camera, row)."""

    frames: tuple[FrameRecord, ...]
    ended: str
    """Why the pulses ended: "clear" (the board has left), "max-rows" (more rows were due), …; "" while filming."""
    interruptions: tuple[Interruption, ...] = ()
    strays: int
    """Number of frames that could not be assigned to a pulse."""
    proof: TriggerProof | None = None
    """Check that every frame belongs to its pulse, with its evidence and its findings; None while filming."""
    software: Versions
    calibration: str
    """Digest of the calibration with which the run was stitched."""
    made_with: MadeWith | None = None
    """What else the run was made with; None for runs of earlier versions."""
    bay: int | None = None
    """Bay of the ring that holds the frames; `slot` of each frame is one of its slots. None for earlier runs."""
    generation: int | None = None
    """Generation of that bay for this run; while the bay's table has another one, its pixels are of another run."""
    unseen: tuple[Unseen, ...] = ()
    """Components that the good frames show too little of; the run is then not ok."""
    skipped_boards: tuple[str, ...] = ()
    """Positions of the boards of a panel that are crossed out; their components are not demanded."""


class ComponentSummary(Schema):
    """One component of a run's board type, and its position."""

    address: str
    ref: str
    panel: str | int | None
    center_mm: tuple[float, float]
    """CAD position of the component's centre in mm."""
    width_mm: float
    height_mm: float
    rotation_deg: float
    tester_mm: tuple[float, float] | None
    """Position of the component's centre at row 0, in tester coordinates; None without a CAD mapping."""
    views: int
    """Number of frames that show at least half of the component."""
    coverage: float | None = None
    """Share of the footprint that the good frames show together; None without a CAD mapping."""
    in_one_frame: bool | None = None
    """Whether one good frame shows the whole footprint; None without a CAD mapping."""
    unseen: bool = False
    """Whether the good frames show less of the component than the board type or the station asks for."""
    skipped: bool = False
    """Whether its board on the panel is crossed out, so that it is not demanded."""
    sigma_px: float | None = None
    """Standard deviation of the component's position in its worst view; None if it is not known."""
    sigma_mm: float | None = None
    """The same on the board."""
    footprint: tuple[tuple[float, float], ...] = ()
    """Corners of the footprint, going round, in CAD coordinates (unit of the board type)."""


class EventRecord(Schema):
    """One entry of the event log. Events are numbered from 1 without gaps, also across restarts of the station."""

    number: int
    time: str
    kind: str
    """Kind of the event: "station" or "run" (for a new `state`), "armed", "board-missed", "line", "trouble", …"""
    state: str = ""
    run: str | None = None
    code: str = ""
    message: str = ""
    action: str = ""
