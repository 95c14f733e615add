"""What the station and the acquisition process say to each other, over one pipe.

Commands go down, reports come up; both are frozen and picklable. The station grants memory ahead of
time, so that a board that comes right after another finds cameras with slots in their hands.
"""

from __future__ import annotations

from dataclasses import dataclass

from vaoi_station.acquisition.cameras.interface import CameraHealth
from vaoi_station.acquisition.controller.interface import TriggerPlan
from vaoi_station.acquisition.pairing.proof import TriggerProof
from vaoi_station.model import FrameRecord, Pulse, RecordingHead


@dataclass(frozen=True)
class Grant:
    """A bay of the ring for a coming run; grants are used in the order they come.

    Whoever grants has claimed the bay beforehand (`Ring.claim`): a new generation, all pixels zero.
    """

    run: str
    bay: int


@dataclass(frozen=True)
class Arm:
    """From now on every passage of the barrier is a run."""

    plan: TriggerPlan


@dataclass(frozen=True)
class Disarm:
    """Ignore the barrier; a run under way is finished with what it has."""


@dataclass(frozen=True)
class FireOne:
    """Fire one pulse now, whatever the barrier shows: a run of one row, into the next grant; only while disarmed."""


@dataclass(frozen=True)
class Shutdown:
    """Close cameras and controller, and end the process."""


Command = Grant | Arm | Disarm | FireOne | Shutdown


@dataclass(frozen=True)
class Ready:
    """Cameras and controller are open."""

    cameras: int


@dataclass(frozen=True)
class Armed:
    """The controller watches the barrier and the cameras hold memory for the next run."""


@dataclass(frozen=True)
class Disarmed:
    """The barrier is ignored; the bays of unused grants are free again."""

    unused: tuple[Grant, ...]


@dataclass(frozen=True)
class RunStarted:
    """A board is being filmed: its first pulse was fired. `host_time_s` is when it interrupted the barrier
    (of a pulse without the barrier: when it was asked for).

    That may be before the run ahead of it is finished, if that one still waits for late frames.
    """

    run: str
    bay: int
    host_time_s: float


@dataclass(frozen=True)
class PulseReported:
    """The controller fired one row."""

    run: str
    pulse: Pulse


@dataclass(frozen=True)
class FrameSettled:
    """One (camera, row) of a run has its verdict; ok frames come as soon as they are paired."""

    run: str
    frame: FrameRecord
    host_time_s: float


@dataclass(frozen=True)
class RunFinished:
    """Every (camera, row) has its verdict; nothing of this run will change any more.

    Runs finish in the order of their boards but where one has to wait for late frames (0.5 s at most).
    In `head` frames that are not whole count as missing; `frames` is ordered by camera, then row.
    """

    run: str
    bay: int
    head: RecordingHead
    frames: tuple[FrameRecord, ...]
    last_frame_host_s: float
    """time.monotonic() when the last frame of the run arrived (of the last pulse, if none did)."""
    reason: str
    """Why the pulses ended: see controller.RunEnded."""
    unassigned: int = 0
    """Count of frames that belong to no pulse of a run."""
    proof: TriggerProof | None = None
    """That every frame belongs to its pulse; None if the acquisition process did not live to give it."""


@dataclass(frozen=True)
class BoardMissed:
    """A board passed and nothing of it was filmed: no memory was granted, or no pulse was fired."""

    host_time_s: float
    reason: str


@dataclass(frozen=True)
class Health:
    """Sign of life, twice a second, with what the devices say of themselves."""

    cameras: tuple[CameraHealth, ...]
    controller: str
    host_time_s: float


@dataclass(frozen=True)
class Trouble:
    """A device does not do what it should; the operator's sentence is `action`."""

    code: str
    message: str
    action: str


Report = (
    Ready | Armed | Disarmed | RunStarted | PulseReported | FrameSettled | RunFinished | BoardMissed | Health | Trouble
)
