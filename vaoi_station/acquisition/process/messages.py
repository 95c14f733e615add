"""The messages between station and acquisition process: the station sends commands, the process sends reports.

The station grants memory ahead, so that the cameras hold slots when a board follows directly behind another.
"""

from __future__ import annotations

from dataclasses import dataclass

from vaoi_station.acquisition.cameras.interface import CameraExposure, CameraHealth
from vaoi_station.acquisition.controller.announced import Came
from vaoi_station.acquisition.controller.interface import (
    BoardOffer,
    Contacts,
    ControllerLimits,
    LineOutput,
    Permit,
    TriggerPlan,
)
from vaoi_station.acquisition.pairing.proof import TriggerProof
from vaoi_station.acquisition.pairing.run_record import Interruption
from vaoi_station.model import FrameRecord, Pulse, RecordingHead


@dataclass(frozen=True)
class Grant:
    """A bay of the ring, claimed by the station, for a coming run; grants are used in the order of sending."""

    run: str
    bay: int


@dataclass(frozen=True)
class Arm:
    """Film every board that interrupts the barrier from now on."""

    plan: TriggerPlan


@dataclass(frozen=True)
class Disarm:
    """Ignore the barrier once the board that is passing has left, at the latest after `TriggerPlan.grace_s`."""


@dataclass(frozen=True)
class PermitBoard:
    """Let the controller's output "line ready" permit one board; without a permit it holds boards back."""

    permit: Permit | None


@dataclass(frozen=True)
class OfferBoard:
    """Offer a board to the next machine by contacts, or with None no board."""

    offer: BoardOffer | None


@dataclass(frozen=True)
class FireOne:
    """Fire one pulse now, independent of the barrier: a run of one row, in the next granted bay. Refused if armed."""


@dataclass(frozen=True)
class FireTrial:
    """Fire one pulse now with settings on trial, into this memory: a run of one row. A refusal is `TrialFailed`."""

    grant: Grant
    exposures: tuple[CameraExposure, ...]
    light: str = ""
    on_us: float | None = None


@dataclass(frozen=True)
class EndTrial:
    """Set the exposures and gains of station.toml again. It does nothing while the station is armed."""


@dataclass(frozen=True)
class ReplaceCamera:
    """Use the camera with this serial number, which answers at this address, in the place of another one."""

    camera: int
    serial: str
    address: str


@dataclass(frozen=True)
class Shutdown:
    """Close cameras and controller, and end the process."""


Command = Grant | Arm | Disarm | PermitBoard | OfferBoard | FireOne | FireTrial | EndTrial | ReplaceCamera | Shutdown


@dataclass(frozen=True)
class Ready:
    """The report that cameras and controller are open. `cameras` is the number of cameras."""

    cameras: int


@dataclass(frozen=True)
class Armed:
    """The report that the controller watches the barrier. If memory was granted, the cameras hold slots."""


@dataclass(frozen=True)
class Disarmed:
    """The report that the barrier is ignored. The bays of unused grants are free again."""

    unused: tuple[Grant, ...]


@dataclass(frozen=True)
class RunStarted:
    """The report that the first pulse of a board was fired; the previous run may still wait for late frames."""

    run: str
    bay: int
    host_time_s: float
    edge_known: bool = True
    """Whether that time is known. If not, the report of the edge was lost, and nothing shows which board it is."""
    came: Came | None = None
    """How contacts of the machine upstream announced the board; None without such contacts."""


@dataclass(frozen=True)
class PulseReported:
    """The report that the controller fired one pulse."""

    run: str
    pulse: Pulse


@dataclass(frozen=True)
class FrameSettled:
    """The report that one (camera, row) of a run has its verdict. Good frames are reported when they are assigned."""

    run: str
    frame: FrameRecord
    host_time_s: float


@dataclass(frozen=True)
class RunFinished:
    """The report that every (camera, row) of a run has its verdict; runs that wait for late frames come later."""

    run: str
    bay: int
    head: RecordingHead
    """Head of a recording of this run; frames that are not complete or not proven count as missing."""
    frames: tuple[FrameRecord, ...]
    last_frame_host_s: float
    """time.monotonic() when the last frame of the run arrived; if no frame arrived, the time of the last pulse."""
    reason: str
    unassigned: int = 0
    proof: TriggerProof | None = None
    """The check that every frame belongs to its pulse; None if the acquisition process ended before it was made."""
    interruptions: tuple[Interruption, ...] = ()
    """Interruptions of the barrier during the run, in s since row 0 by the controller's clock; empty if unknown."""


@dataclass(frozen=True)
class BoardMissed:
    """The report that a board passed and was not filmed: no memory, no pulse, or it came at a wrong time."""

    host_time_s: float
    reason: str


@dataclass(frozen=True)
class MissedPassage:
    """The end of the passage of a missed board, which began at `host_time_s`; `interruptions` are relative to it."""

    host_time_s: float
    interruptions: tuple[Interruption, ...]
    ways_mm: tuple[Interruption, ...] | None = None
    """Way of the belt at the edges of each interruption since the first edge, mm, by the encoder; None without one."""


@dataclass(frozen=True)
class Health:
    """The heartbeat of the process, twice a second, with the state of the devices."""

    cameras: tuple[CameraHealth, ...]
    controller: str
    host_time_s: float
    controller_ready: bool = True
    line_output: LineOutput | None = None
    contacts: Contacts | None = None
    passing: bool = False
    """Whether a run is under way at the controller, also before its first pulse, or a board is in the barrier."""
    belt_stopped: bool = False
    limits: ControllerLimits | None = None
    standing: bool = False
    """Whether a board is in the barrier that is not filmed, because it came while the line was not armed."""


@dataclass(frozen=True)
class Trouble:
    """The report of a fault of a device. `action` is what the operator should do."""

    code: str
    message: str
    action: str


@dataclass(frozen=True)
class TrialFailed:
    """The report that a trial was not filmed; its memory is not used."""

    run: str
    why: Trouble


Report = (
    Ready
    | Armed
    | Disarmed
    | RunStarted
    | PulseReported
    | FrameSettled
    | RunFinished
    | BoardMissed
    | MissedPassage
    | Health
    | Trouble
    | TrialFailed
)
