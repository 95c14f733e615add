"""Schemas of the documents about the station and its runs. The documents are immutable and become JSON as they are.

Points in time are strings, RFC 3339 in UTC. Durations are numbers (`_s`, `_ms`). Cameras and rows count from 0.
"""

from __future__ import annotations

from typing import Annotated, Literal, Self

from pydantic import Field, model_validator

from vaoi_station.acquisition.controller.announced import Came
from vaoi_station.acquisition.pairing.proof import TriggerProof
from vaoi_station.config import MethodName
from vaoi_station.model import BoardLimits, FrameRecord, PartLimits, Reason, Status, Strict
from vaoi_station.model.board_identity import IdentityDocument, IdentityState
from vaoi_station.model.board_type import BoardTypeState, UnseenCause
from vaoi_station.runs.states.tables import RunState, StationState
from vaoi_station.stitching.expectation import StitchTerms

ImageFormat = Literal["png", "jpeg", "tiff", "npy"]


FlipAxis = Literal["x", "y"]
"""Axis of the tester about which a board was turned over since its other side was filmed."""
Choice = Literal["film-again", "use"]
"""`film-again`: film the board again, do not use these pictures. `use`: use them in spite of the verdict."""


class Decision(Strict):
    """What a person has decided about a run, with name and reason. The verdict stays as it is."""

    choice: Choice
    name: str
    reason: str
    decided: str


class RunCounts(Strict):
    """Numbers of boards since a time, by verdict."""

    since: str
    ok: int
    degraded: int
    failed: int
    """Runs with the verdict failed, and runs that ended without a result."""
    missed: int
    complete: bool = True
    """False: since then more than 20,000 boards have come, of which the newest are counted."""


class IdentitySummary(Strict):
    """Which board a run shows, in short; `runs/{id}/identity` has reasons and codes."""

    state: IdentityState
    board_id: str | None = None
    """The id that was read from the board's code; `board_id` of the run is the one that the line was armed with."""
    boards: dict[str, str] = {}  # noqa: RUF012  pydantic copies it
    """On a panel: the id that was read of each board, by its position."""

    @staticmethod
    def of(document: IdentityDocument) -> IdentitySummary:
        """Return the summary of an identity."""
        return IdentitySummary(state=document.state, board_id=document.board_id, boards=document.boards)


class MadeWith(Strict):
    """What a run was made with besides software and calibration. Digests are 16 hex digits of a SHA-256."""

    configuration: str
    """Digest of the station's configuration; empty if it was not stored."""
    board_type: str
    """Digest of the board type as it was when the line was armed."""
    board_type_revision: str | None = None
    board_type_state: BoardTypeState | None = None
    method: MethodName
    reference: str | None = None
    """Id of the run against which the board was placed; None: without a reference."""
    reference_digest: str | None = None
    """Digest of the files of the reference."""
    terms: StitchTerms | None = None
    """What the station knew of line and lights; None for runs of earlier versions."""
    clock_synchronised: bool | None = None
    """Whether the machine's clock was kept right by a time server when the document was made; None: not known."""
    clock_max_error_s: float | None = None
    time_zone: str = ""
    utc_offset_s: int = 0
    """Local time of the station minus UTC, s."""


class Origin(Strict):
    """Where an imported run was filmed. Such a run is not announced: it is no board of this line."""

    station: str
    exported: str
    imported: str


class SetAsideFile(Strict):
    """A damaged, deleted or replaced database, of which a file was set aside beside the present one."""

    file: str
    code: str
    acknowledged: bool
    """Whether an administrator has acknowledged it, so that the station no longer warns."""


class ArchiveStatus(Strict):
    """The archive to which the station hands finished runs (`[archive]` of station.toml)."""

    url: str
    waiting: int
    """Number of runs that wait for it on the station's disk."""
    adding: str | None
    added: int
    dropped: int
    """Number of runs since the start whose recordings were deleted before the archive took them."""
    refused: int
    """Number of runs since the start that could not be added for a reason of their own."""
    problem: str


class ArmedWith(Strict):
    """The order in force for the next boards; the caller's ids are returned with every result."""

    board_type: str
    board_id: str | None
    job_id: str | None
    runs_left: int | None
    """Number of runs until the station disarms; None: it stays armed."""
    method: MethodName = "auto"
    reference: str | None = None
    board_id_certain: bool = True
    """Whether `board_id` belongs to the next board. If not, a board may have passed without a run: arm again."""
    resumed: bool = False


class OrderStatus(Strict):
    """An order that no board has taken yet."""

    id: str
    board_type: str
    board_id: str | None = None
    job_id: str | None = None
    skip: tuple[str, ...] = ()
    """Positions of the boards of a panel that are not to be tested."""
    side: Literal["top", "bottom"] = "top"
    flip: FlipAxis | None = None
    priority: int = 0
    state: Literal["waiting", "coming"] = "waiting"
    """`coming`: its board is on its way from the machine upstream to the barrier."""
    certain: bool = True
    """Whether its board is known to be the next one after those of the orders before. If not, arm again."""
    created: str


class OrderList(Strict):
    """The orders that no board has taken yet, the next one first."""

    orders: tuple[OrderStatus, ...]
    by_messages: bool = False
    """Whether boards take orders by messages of the machine upstream only."""


class CameraRecoveryStatus(Strict):
    """The latest step against a camera that hangs."""

    step: Literal["reopen", "restart", "reset", "power", "spent"]
    """Opened again; stream started again; reset; power switched off and on; all tried as often as permitted."""
    why: Literal["silent", "absent"]
    """It answers and sends nothing of boards that others film, or does not answer although its link is up."""
    at: str


class CameraPtpStatus(Strict):
    """What a camera with `ptp` states of its clock, at most 5 s ago."""

    state: str
    """By IEEE 1588: `Listening`, `Uncalibrated`, `Slave`, `Master` …; empty if the camera does not state it."""
    synchronised: bool
    """Whether that is `Slave` or `Master`."""
    offset_ns: int | None = None
    """Its clock minus that of its master, if it states that."""
    apart_us: float = 0.0
    """How far its clock certainly is from those of most others with PTP, or of the other half; 0 within bounds."""


class CameraStatus(Strict):
    """State of one camera at the last heartbeat of the acquisition process."""

    camera: int
    name: str
    connected: bool
    message: str = ""
    temperature_c: float | None = None
    delivered: int = 0
    incomplete: int = 0
    last_frame_age_s: float | None = None
    lost_since: str | None = None
    """Time at which it was lost, or at the start of the station not found; None while it is connected."""
    next_try: str | None = None
    """Time of the next attempt to open the camera; None while the camera is connected or being opened."""
    recovery: CameraRecoveryStatus | None = None
    """Present until the camera has sent a frame again."""
    ptp: CameraPtpStatus | None = None
    """Present with `ptp = true` while it is connected."""
    counters: dict[str, int] = {}  # noqa: RUF012  pydantic copies it
    """Counters of the camera's driver for diagnosis, with the names that the driver uses."""
    serial: str = ""
    """Serial number of the camera that is, or was last, connected at this place; empty if none was a real one."""
    model: str = ""
    address: str = ""
    link: str = ""
    """Name of the link by which it hangs on the station, as the uplink of a switch: `link` in station.toml."""


STARTING = "starting"
"""Value of `ProcessStatus.doing` for a process before its first message."""
WAITING = "waiting for the workers"
"""Value of `ProcessStatus.doing` for an acquisition process whose devices are open before the workers are ready."""


class ProcessStatus(Strict):
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


class LeaseStatus(Strict):
    """A holder's time-limited right to the frames of a run. The frames are not evicted during this time."""

    run: str
    holder: str
    purpose: str
    expires_in_s: float


class BayStatus(Strict):
    """Memory for the frames of one run, and its present use."""

    bay: int
    use: Literal["free", "granted", "filming", "stitching", "finished"]
    run: str | None
    generation: int = 0
    """Generation of the bay in the table of the ring; it is raised when the bay is given to another run."""


class RingStatus(Strict):
    """The shared memory for frames: its path, its size, and its use by runs."""

    path: str
    size_bytes: int
    bays: tuple[BayStatus, ...]
    leases: tuple[LeaseStatus, ...]


class Retention(Strict):
    """Which data the station keeps, and for how long."""

    runs_in_memory: int
    """Number of bays of the ring. One bay receives the frames of the present board, one is kept for the next board."""
    lease_s: float
    """Time after which a hold ends unless it is renewed."""
    keep_s: float = 0.0
    frames: str
    results: str
    events: str
    recordings: int = 0
    recordings_bytes: int = 0
    recordings_late: int = 0
    """Number of runs since the start whose memory was needed before their frames were on disk."""
    recordings_refused: int = 0
    """Number of runs since the start whose frames were not kept because of the quota, the disk or a fault."""
    mosaics: int = 0
    mosaics_bytes: int = 0
    archive: ArchiveStatus | None = None


class Versions(Strict):
    """Versions of the software that computed the results."""

    station: str
    opencv: str
    python: str


class LineOutputStatus(Strict):
    """The controller's output "line ready" at the last heartbeat of the acquisition process."""

    high: bool
    """Whether the output lets a conveyor bring the next board."""
    why: str = ""


class BoardBehind(Strict):
    """A board behind the cameras that contacts offer to the next machine."""

    name: str
    """Id of its run; of a board that was not filmed, a name for `DELETE neighbours/boards/…`."""
    failed: bool
    """Whether it is offered as a failed board."""


class ContactsStatus(Strict):
    """The neighbours by the contacts of IPC-SMEMA-9851."""

    known: bool
    """Whether the controller has reported the contacts; if not, all are shown as open."""
    available: bool
    """Whether the machine upstream has a board."""
    failed: bool
    """Whether the machine upstream has a failed board."""
    next_ready: bool | None
    """Whether the next machine takes a board; None if its contacts are not used."""
    offered: Literal["none", "available", "failed"]
    """Which contact to the next machine is closed."""
    boards: tuple[BoardBehind, ...] = ()
    """The boards that wait for the next machine, the first one first."""


class StationSnapshot(Strict):
    """State of the station at one moment."""

    name: str
    state: StationState
    since: str
    reasons: tuple[Reason, ...]
    warnings: tuple[Reason, ...] = ()
    """Conditions that do not prevent filming but need attention."""
    set_aside: tuple[SetAsideFile, ...] = ()
    """Databases that were set aside; an administrator acknowledges the warning about each."""
    armed_with: ArmedWith | None
    next_order: ArmedWith | None = None
    """Order that takes effect when the board that passes has left; None if there is none."""
    orders: tuple[OrderStatus, ...] = ()
    """The next orders that no board has taken yet; `GET orders` lists all."""
    orders_waiting: int = 0
    cameras: tuple[CameraStatus, ...]
    all_cameras_ready: bool
    """Whether all cameras are connected. If False, the next board is filmed with gaps or not at all."""
    line_ready: bool = False
    """Whether the next board may come: it would be filmed by all cameras, and its result kept on disk."""
    line_held: tuple[Reason, ...] = ()
    line_output: LineOutputStatus | None = None
    """The controller's output "line ready", which a conveyor obeys; None if it is not used or there is none."""
    controller: str
    processes: tuple[ProcessStatus, ...]
    ring: RingStatus
    versions: Versions
    retention: Retention
    last_run: str | None
    filming: str | None
    last_event: int
    boards_missed: int
    times_blocked: int = 0


class BoardTypeSummary(Strict):
    """One entry of the list of board types; `fault` is set if its file cannot be used."""

    name: str
    revision: str | None = None
    state: str = "approved"
    side: str = "top"
    unit: str = "mm"
    components: int = 0
    fiducials: int = 0
    fault: Reason | None = None


class VerdictCounts(Strict):
    """Numbers of frames of a run by verdict. Frames that are not proven to belong to their row are not among `ok`."""

    ok: int
    incomplete: int
    missing: int
    unproven: int = 0


class BeltSpeed(Strict):
    """Belt velocity (x, y) in tester coordinates: nominal, and as measured from this board."""

    nominal_mm_s: tuple[float, float]
    measured_mm_s: tuple[float, float]
    ratio: float


class Timings(Strict):
    """Durations of the steps of a run, by the host's clock."""

    filming_s: float
    ready_after_last_frame_ms: float | None
    """Time from the arrival of the last frame to the finished matrices; None without matrices."""
    links_ms: float
    conclude_ms: float
    links: int
    links_while_filming: int


class RunSummary(Strict):
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
    recording: bool = False
    decision: Decision | None = None
    identity: IdentitySummary | None = None
    origin: Origin | None = None
    figures: dict[str, float] | None = None
    """Its figures by their names in `trends`, those of a part as `seam_px:0-1`; None if not asked for or not known."""

    @property
    def identity_decided(self) -> bool:
        """Whether no code of the board is still to be read, so that the verdict is not lowered for one any more."""
        return self.identity is None or self.identity.state != "pending"


class Interruption(Strict):
    """One interruption of the light barrier; times are in seconds since row 0, by the controller's clock."""

    blocked_s: float
    clear_s: float | None = None
    """None if the barrier was still interrupted when the run ended."""


class Unseen(Strict):
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
    proof: TriggerProof | None = None
    """Check that every frame belongs to its pulse, with its evidence and its findings; None while filming."""
    software: Versions
    calibration: str
    made_with: MadeWith | None = None
    """What else the run was made with; None for runs of earlier versions."""
    bay: int | None = None
    """Bay of the ring that holds the frames; `slot` of each frame is one of its slots. None for earlier runs."""
    generation: int | None = None
    """Generation of that bay for this run; while the bay's table has another one, its pixels are of another run."""
    unseen: tuple[Unseen, ...] = ()
    skipped_boards: tuple[str, ...] = ()
    came: Came | None = None
    """How the line announced the board: `failed`, as a failed one; `by-hand`: not at all. None if nothing is known."""
    flip: FlipAxis | None = None
    """Axis of the tester about which the board was turned over since its other side was filmed, as its order states."""


class ComponentSummary(Strict):
    """One component of a run's board type, and its position."""

    address: str
    ref: str
    panel: str | int | None
    center_mm: tuple[float, float]
    width_mm: float
    height_mm: float
    rotation_deg: float
    tester_mm: tuple[float, float] | None
    """Position of the component's centre at row 0, in tester coordinates; None without a CAD mapping."""
    views: int
    """Number of frames that show at least half of the component."""
    coverage: float | None = None
    in_one_frame: bool | None = None
    unseen: bool = False
    """Whether the good frames show less of the component than the board type or the station asks for."""
    skipped: bool = False
    sigma_px: float | None = None
    """Standard deviation of the component's position in its worst view; None if it is not known."""
    sigma_mm: float | None = None
    footprint: tuple[tuple[float, float], ...] = ()
    """Corners of the footprint, going round, in CAD coordinates (unit of the board type)."""


class EventRecord(Strict):
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


class TaskTiming(Strict):
    """Times of one task of a run, in seconds since the board interrupted the barrier, by the host's clock."""

    kind: str
    camera: int
    row: int
    other_camera: int | None
    other_row: int | None
    ready_s: float
    """Time at which the last of the task's frames was settled."""
    done_s: float
    worker_ms: float


class RowTiming(Strict):
    """Pulse, light and exposure of one row."""

    row: int
    pulse_s: float
    """Time of the pulse since the board interrupted the barrier, by the controller's clock."""
    light: str = ""
    led_us: float | None = None
    """On-time of the LEDs by the light program; None if they shine for the whole exposure, or without a program."""
    exposure_us: float
    """Longest exposure of a camera in this row: for how long its shutter is open."""


class BarrierTiming(Interruption):
    """One interruption of the light barrier, since the first one of the run, by the controller's clock."""


class Timeline(Strict):
    """Times of the steps of a run, in seconds since the board interrupted the barrier.

    Frames, tasks and the result have the times of the host's clock, pulses and the barrier those of the controller's.
    """

    frames_settled_s: tuple[tuple[int, int, float], ...]
    tasks: tuple[TaskTiming, ...]
    last_frame_s: float
    ready_s: float | None
    rows: tuple[RowTiming, ...] = ()
    """Every row; empty in runs of earlier versions, and where the controller reports no interruptions."""
    barrier: tuple[BarrierTiming, ...] = ()


class ReferenceRecord(Strict):
    """A run that is kept as the reference of its board type."""

    run: str
    taught: str
    calibration: str
    cameras: int
    rows: int
    frames: int
    """Number of frames that are kept: a small set from each row."""
    size_bytes: int
    cad_sigma_px: float | None
    """Standard deviation of positions by the run's CAD mapping, at the board's worst corner; None if unknown."""


class ReferenceStatus(ReferenceRecord):
    """The reference of a board type, and whether boards can be placed against it now."""

    board_type: str
    usable: bool
    fault: Reason | None = None


class StitchingMethod(Strict):
    """The method by which runs of a board type are stitched."""

    method: MethodName
    chosen: Literal["board-type", "station"]
    """Origin of the method: it was set for the board type, or it is the station's method."""


class CameraDrift(Strict):
    """Displacement of a camera since its calibration."""

    size_px: float
    """Root mean square of the displacement over all pixels of the frame."""
    x_px: float
    y_px: float
    turn_px: float
    since_run: str
    since: str
    runs: int
    instead: tuple[int, ...] = ()
    """Indices of cameras that may have moved instead of this one; pictures of boards cannot show which has moved."""


class CameraMoment(Strict):
    """Displacement of one camera in one run."""

    run: str
    time: str
    x_px: float
    y_px: float
    turn_px: float
    sigma_px: float
    rms_px: float | None = None
    """Root mean square residual of the camera's links to its neighbours and of its fiducials; None without both."""
    links: int
    fiducials: int


class CameraExchange(Strict):
    """What boards show of a camera that was exchanged and is not calibrated yet."""

    boards: int
    """Number of boards since the exchange."""
    ready: bool
    """Whether its calibration can be confirmed; otherwise message and action say why not."""
    x_px: float | None = None
    """How its picture lies beside that of its predecessor, with the turn as a distance at the corner of the frame."""
    y_px: float | None = None
    turn_px: float | None = None
    sigma_px: float | None = None
    """Largest standard deviation of the three."""
    message: str = ""
    action: str = ""


class CameraCalibration(Strict):
    """The state of one camera since its calibration, and its displacement in each of the latest runs."""

    camera: int
    name: str
    state: Literal["steady", "drifted", "unseen", "unknown"]
    """"steady" or "drifted"; "unseen": the latest runs give no evidence of the camera's position; "unknown": no run was
    checked."""
    drift: CameraDrift | None = None
    history: tuple[CameraMoment, ...] = ()
    exchange: CameraExchange | None = None
    """None for a camera that is calibrated."""


class CalibrationStatus(Strict):
    """The calibration in force, and the state of every camera."""

    digest: str
    """Digest of the calibration's content; the documents of runs refer to the calibration by it."""
    created: str | None = None
    runs: int
    cameras: tuple[CameraCalibration, ...]


Number = Annotated[float, Field(strict=True, allow_inf_nan=False)]


class HeightInterval(Strict):
    """A range of heights that explain the pictures of a component."""

    low_mm: Number
    """Least height."""
    high_mm: Number
    """Largest height."""
    probability: Number = Field(description="Probability that the height lies in it.")


class HeightEntry(Strict):
    """The height of one component above the board."""

    height_mm: Number | None = Field(None, description="Absent where several heights are probable.")
    sigma_mm: Number | None = Field(None, description="Standard deviation of `height_mm`.")
    views: int = Field(strict=True, description="Number of frames that show the component; a height needs two.")
    low_mm: Number | None = Field(None, description="Interval that contains the height with a probability of 0.99:")
    high_mm: Number | None = Field(None, description="absent if `height_mm` is known, or if nothing can be said.")
    intervals: tuple[HeightInterval, ...] | None = Field(
        None, description="The parts of this interval that explain the pictures, if there are several."
    )
    expected_mm: Number | None = Field(None, description="`body_height` of the board type.")
    comparison: Literal["agrees", "lower", "higher", "ambiguous", "unknown"] | None = Field(
        None,
        description="Statement about `expected_mm`: `agrees` with a probability of at least 0.95, `lower` or `higher` "
        "of at least 0.995. `ambiguous`: several `intervals` are left, compare the part by eye.",
    )
    probability: Number | None = Field(None, description="Probability of the statement, or of the best one.")

    @model_validator(mode="after")
    def _has_both_or_neither(self) -> Self:
        if (self.height_mm is None) != (self.sigma_mm is None):
            raise ValueError("has only one of height_mm and sigma_mm; must have both or neither")
        return self


class HeightList(Strict):
    """The heights of a run's components, by address."""

    heights: dict[str, HeightEntry]


class PartMeasure(Strict):
    """What the pictures of one part say. What cannot be said is absent, for the `reasons`."""

    presence: Number | None = Field(None, description="Probability that the part is there.")
    dx_mm: Number | None = Field(None, description="Place against the CAD data, along the CAD axes.")
    dy_mm: Number | None = None
    """The same along y."""
    sigma_mm: Number | None = Field(None, description="Standard deviation of the place along the worse axis.")
    turn_deg: Number | None = Field(None, description="Turn against the CAD data, counter-clockwise as seen.")
    sigma_deg: Number | None = None
    """Standard deviation of the turn."""
    orientation: dict[str, Number] | None = Field(None, description="Probability by turn, degrees; needs marks.")
    alike: Number | None = Field(None, description="Probability that it is what good boards have there.")
    height_mm: Number | None = Field(None, description="Height above the board by parallax.")
    frames: int = Field(strict=True, description="Number of frames on which the measure rests.")
    boards: int = Field(strict=True, description="Number of good boards on which it rests.")
    reasons: tuple[str, ...] = Field(description="Why something is absent; `reason_texts` has the sentences.")
    marked: tuple[str, ...] = Field((), description="The measures that are beyond the limits of the board type.")


class PartsDocument(Strict):
    """The measures of a run's parts, by address."""

    format: Literal["vaoi-parts"]
    version: Literal[1]
    board_type: str
    """Name of the board type."""
    good_boards: tuple[str, ...] = Field(description="Runs with which it was compared.")
    remarks: tuple[str, ...] = Field(description="What changed since teaching; whether this is another revision.")
    remark_codes: tuple[str, ...] = Field((), description="The code of each remark.")
    remark_values: tuple[dict[str, int | str | tuple[str, ...]], ...] = Field(
        (), description="The values in the sentence of each remark."
    )
    parts: dict[str, PartMeasure]
    reason_texts: dict[str, str]
    """The sentence of each of the reasons."""


class PartPictures(Strict):
    """Addresses of the pictures of a part under one light: grey, upright, of equal size and place."""

    light: str
    exposure: Number = Field(description="Exposure time times gain of its frames, µs.")
    part: str = Field(description="The part, averaged over the frames that show it.")
    good: str | None = Field(None, description="The same part of the good board `good`.")
    difference: str | None = Field(None, description="Part less good one; equal pixels are grey (128).")


class PartPage(Strict):
    """What is known of one part of a run, with its pictures beside those of a good board."""

    run: str
    board_type: str
    address: str
    measure: PartMeasure | None = Field(None, description="As in the document of all parts, if it is stored.")
    limits: PartLimits = Field(description="The limits by which it was marked.")
    good: str | None = Field(None, description="The good board whose part looks most like this one.")
    views: tuple[PartPictures, ...] = Field(description="By light; none if the frames are no longer kept.")


class GoodBoard(Strict):
    """One good board of a board type."""

    run: str
    size_bytes: int = Field(description="Size of what is kept of it.")


class Disagreement(Strict):
    """A part of a good board that looks unlike others of its kind on good boards."""

    board: str
    part: str
    unlike: Number = Field(description="How unlike it looks; good ones mostly stay below 3.")


class GoodBoards(Strict):
    """The good boards of a board type, and doubts about the one that was just taught."""

    board_type: str
    boards: tuple[GoodBoard, ...]
    disagreements: tuple[Disagreement, ...] = ()
    absent: tuple[str, ...] = Field((), description="Parts of the taught board that were measured as absent before.")


class MarkedPart(Strict):
    """A part of a board that limits mark."""

    run: str
    part: str
    measures: tuple[str, ...] = Field(description="The measures that are beyond a limit.")


class LimitsReport(Strict):
    """Limits of the parts of a board type, and what they would have marked on the latest boards."""

    board_type: str
    limits: BoardLimits
    runs: int = Field(description="Number of boards whose stored measures were compared: of the latest 200.")
    measured: int = Field(description="Number of parts on these boards.")
    marked_parts: int = Field(description="Number of parts that would have been marked.")
    marked_runs: int = Field(description="Number of boards with such a part.")
    marked: tuple[MarkedPart, ...] = Field(description="These parts, those of the newest boards first; 500 at most.")


Point = tuple[float, float]


class OverlayFrame(Strict):
    """What one frame shows of the board."""

    camera: int
    row: int
    usable: bool
    """Whether it is complete and proven; other frames are not used."""
    light: str = ""
    corners: tuple[Point, ...]
    """The corners of the frame on the board, going round."""
    sigma_px: float | None = None
    """Standard deviation of its matrix at its worst corner; None if it is not known."""


class OverlayLinks(Strict):
    """The links of two frames."""

    a: tuple[int, int]
    b: tuple[int, int]
    found: int
    used: int
    """Number of links that have weight in the adjustment."""
    at: Point | None = None
    residual: Point | None = None
    """Mean residual of the used links: from the point in the first frame to where the second one predicts it."""
    residual_px: float | None = None
    rms_px: float | None = None
    why: str = ""


class OverlayFiducial(Strict):
    """A fiducial of the board type, and where it was seen."""

    name: str
    at: Point
    diameter: float
    sightings: int
    residual: Point | None = None
    residual_px: float | None = None


class RunOverlay(Strict):
    """What is drawn over the mosaics of a run."""

    unit: str
    px_per_mm: float
    """Mean resolution of the cameras, to which px refer."""
    outline: tuple[Point, ...] = ()
    frames: tuple[OverlayFrame, ...]
    links: tuple[OverlayLinks, ...]
    """Pairs of frames that were searched for links; empty in runs of earlier versions but for those without links."""
    fiducials: tuple[OverlayFiducial, ...]
