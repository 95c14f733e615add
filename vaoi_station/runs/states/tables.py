"""Two tables, states × events: what the station does, and what becomes of one board's run.

Pure: a table maps (state, event) to the next state; what is not in the table is illegal, raises
`StateError` and changes nothing. The diagrams of `docs/internals/runs.md` are drawn from these tables.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from enum import StrEnum
from typing import Generic, TypeVar

from vaoi_station.errors import StateError


class StationState(StrEnum):
    """What the station as a whole is doing."""

    STARTING = "starting"
    """Processes are being started, cameras and controller opened."""
    IDLE = "idle"
    """Everything is open; the light barrier is ignored."""
    ARMING = "arming"
    """Cameras are given memory, the controller is told to watch the barrier."""
    ARMED = "armed"
    """The next board that interrupts the barrier is filmed."""
    FILMING = "filming"
    """A board is passing."""
    BLOCKED = "blocked"
    """Armed, but no memory is free: a board that came now would be missed."""
    FAULTED = "faulted"
    """The acquisition process or a device is lost; it is being restarted."""
    STOPPING = "stopping"
    """The station is going down."""


class StationStep(StrEnum):
    """What happens to the station."""

    READY = "ready"
    ARM = "arm"
    ARMED = "armed"
    BOARD_ARRIVED = "board arrived"
    BOARD_FILMED = "board filmed"
    RING_FULL = "ring full"
    MEMORY_FREED = "memory freed"
    DISARMED = "disarmed"
    FAULT = "fault"
    STOP = "stop"


class RunState(StrEnum):
    """Where a run is in its life. Its verdict (ok, degraded, failed) outlives the last two."""

    FILMING = "filming"
    """Pulses are fired, frames arrive, links are found meanwhile."""
    STITCHING = "stitching"
    """Every frame has its verdict; the matrices are being computed."""
    READY = "ready"
    """The matrices are there and sound; frames are in memory."""
    DEGRADED = "degraded"
    """The matrices are there with reservations; see the reasons. Frames are in memory."""
    FAILED = "failed"
    """There are no usable matrices; frames are in memory."""
    RELEASED = "released"
    """The caller gave the frames up; the result is kept."""
    GONE = "gone"
    """The frames' memory went to a later board, or the station was restarted; the result is kept."""


class RunStep(StrEnum):
    """What happens to a run."""

    FILMED = "filmed"
    STITCHED = "stitched"
    STITCHED_WEAKLY = "stitched weakly"
    NOT_STITCHED = "not stitched"
    RELEASE = "release"
    MEMORY_TAKEN = "memory taken"
    STATION_LOST = "station lost"


S = TypeVar("S", bound=StrEnum)
E = TypeVar("E", bound=StrEnum)


@dataclass(frozen=True)
class Table(Generic[S, E]):
    """A state machine as data: `next` is all it can do."""

    what: str
    start: S
    steps: Mapping[tuple[S, E], S]

    def next(self, state: S, event: E, action: str = "") -> S:
        """The state after an event; `StateError` names both if the event is illegal there."""
        try:
            return self.steps[state, event]
        except KeyError:
            raise StateError(f"The {self.what} is {state}; {event!s} is not possible now.", action=action) from None

    def allows(self, state: S, event: E) -> bool:
        """Whether an event is legal in a state."""
        return (state, event) in self.steps


_S, _E = StationState, StationStep

STATION: Table[StationState, StationStep] = Table(
    "station",
    _S.STARTING,
    {
        (_S.STARTING, _E.READY): _S.IDLE,
        (_S.STARTING, _E.FAULT): _S.FAULTED,
        (_S.STARTING, _E.STOP): _S.STOPPING,
        (_S.IDLE, _E.ARM): _S.ARMING,
        (_S.IDLE, _E.FAULT): _S.FAULTED,
        (_S.IDLE, _E.STOP): _S.STOPPING,
        (_S.ARMING, _E.ARMED): _S.ARMED,
        (_S.ARMING, _E.DISARMED): _S.IDLE,
        (_S.ARMING, _E.FAULT): _S.FAULTED,
        (_S.ARMING, _E.STOP): _S.STOPPING,
        (_S.ARMED, _E.ARM): _S.ARMED,
        (_S.ARMED, _E.BOARD_ARRIVED): _S.FILMING,
        (_S.ARMED, _E.RING_FULL): _S.BLOCKED,
        (_S.ARMED, _E.DISARMED): _S.IDLE,
        (_S.ARMED, _E.FAULT): _S.FAULTED,
        (_S.ARMED, _E.STOP): _S.STOPPING,
        (_S.FILMING, _E.BOARD_ARRIVED): _S.FILMING,
        (_S.FILMING, _E.BOARD_FILMED): _S.ARMED,
        (_S.FILMING, _E.DISARMED): _S.IDLE,
        (_S.FILMING, _E.FAULT): _S.FAULTED,
        (_S.FILMING, _E.STOP): _S.STOPPING,
        (_S.BLOCKED, _E.MEMORY_FREED): _S.ARMED,
        (_S.BLOCKED, _E.DISARMED): _S.IDLE,
        (_S.BLOCKED, _E.FAULT): _S.FAULTED,
        (_S.BLOCKED, _E.STOP): _S.STOPPING,
        (_S.FAULTED, _E.READY): _S.IDLE,
        (_S.FAULTED, _E.FAULT): _S.FAULTED,
        (_S.FAULTED, _E.STOP): _S.STOPPING,
    },
)

ADVICE = {
    _S.STARTING: "Wait: workers start first, then cameras and controller are opened.",
    _S.ARMING: "Wait until the line is armed.",
    _S.FILMING: "Wait until the board has passed; every finished run is told by runs/next.",
    _S.BLOCKED: "Release a run.",
    _S.FAULTED: "See the reasons of the station; it tries again by itself.",
    _S.STOPPING: "Start it again.",
}
"""What to do in a state in which what was asked for is not possible."""

_R, _H = RunState, RunStep

RUN: Table[RunState, RunStep] = Table(
    "run",
    _R.FILMING,
    {
        (_R.FILMING, _H.FILMED): _R.STITCHING,
        (_R.FILMING, _H.STATION_LOST): _R.FAILED,
        (_R.STITCHING, _H.STITCHED): _R.READY,
        (_R.STITCHING, _H.STITCHED_WEAKLY): _R.DEGRADED,
        (_R.STITCHING, _H.NOT_STITCHED): _R.FAILED,
        (_R.STITCHING, _H.STATION_LOST): _R.FAILED,
        (_R.READY, _H.RELEASE): _R.RELEASED,
        (_R.READY, _H.MEMORY_TAKEN): _R.GONE,
        (_R.DEGRADED, _H.RELEASE): _R.RELEASED,
        (_R.DEGRADED, _H.MEMORY_TAKEN): _R.GONE,
        (_R.FAILED, _H.RELEASE): _R.RELEASED,
        (_R.FAILED, _H.MEMORY_TAKEN): _R.GONE,
        (_R.RELEASED, _H.RELEASE): _R.RELEASED,
        (_R.GONE, _H.RELEASE): _R.GONE,
    },
)

FINISHED = frozenset({_R.READY, _R.DEGRADED, _R.FAILED, _R.RELEASED, _R.GONE})
"""States in which a run no longer changes but for its memory."""
IN_MEMORY = frozenset({_R.READY, _R.DEGRADED, _R.FAILED})
"""Finished states in which the frames can be had."""
