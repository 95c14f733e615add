"""The two state machines, as tables: one for the station, one for a run.

A table maps (state, step) to the next state. A step is what happens: a request, or a report of a process. A pair that
is not in the table is illegal: it raises `StateError` and does not change the state. The diagrams in
`docs/explanation/runs.md` are drawn from these tables.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from enum import StrEnum
from typing import Generic, TypeVar

from vaoi_station.errors import StateError


class StationState(StrEnum):
    """State of the station as a whole."""

    STARTING = "starting"
    """Processes are starting; cameras and controller are being opened."""
    IDLE = "idle"
    """Devices are open; the light barrier is ignored."""
    ARMING = "arming"
    """Cameras receive memory, the controller is being armed."""
    ARMED = "armed"
    """The next board that interrupts the barrier is filmed."""
    FILMING = "filming"
    """A board is passing."""
    BLOCKED = "blocked"
    """Armed, but no memory is free: the next board would be missed."""
    FAULTED = "faulted"
    """The acquisition process is lost; it is being restarted."""
    STOPPING = "stopping"
    """The station is shutting down."""


class StationStep(StrEnum):
    """A step, which may change the state of the station."""

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
    """State of a run. In the states RELEASED and GONE, the verdict (ok, degraded, failed) of the run stays valid."""

    FILMING = "filming"
    """The board is passing: trigger pulses are sent, frames arrive, links are computed."""
    STITCHING = "stitching"
    """Every frame is settled; the matrices are being computed."""
    READY = "ready"
    """The matrices are available and sound; frames are in memory."""
    DEGRADED = "degraded"
    """The matrices are available but less reliable; the reasons explain it. Frames are in memory."""
    FAILED = "failed"
    """There are no usable matrices; frames are in memory."""
    RELEASED = "released"
    """A caller released the frames; the result is kept."""
    GONE = "gone"
    """The frames were evicted for a later board, or the station was restarted; the result is kept."""


class RunStep(StrEnum):
    """A step, which changes the state of a run."""

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
    """A state machine: its name in messages, its first state, and the next state for each legal (state, step)."""

    what: str
    start: S
    steps: Mapping[tuple[S, E], S]

    def next(self, state: S, event: E, action: str = "") -> S:
        """Return the state that follows a step; `StateError`, with the given action, if the step is illegal."""
        try:
            return self.steps[state, event]
        except KeyError:
            raise StateError(f"The {self.what} is {state}; {event!s} is not possible now.", action=action) from None

    def allows(self, state: S, event: E) -> bool:
        """Return whether the table permits this step in this state."""
        return (state, event) in self.steps


_S, _E = StationState, StationStep

STATION: Table[StationState, StationStep] = Table(
    "station",
    _S.STARTING,
    {
        **{(state, _E.FAULT): _S.FAULTED for state in _S if state is not _S.STOPPING},
        **{(state, _E.STOP): _S.STOPPING for state in _S if state is not _S.STOPPING},
        (_S.STARTING, _E.READY): _S.IDLE,
        (_S.FAULTED, _E.READY): _S.IDLE,
        (_S.IDLE, _E.ARM): _S.ARMING,
        (_S.ARMING, _E.ARMED): _S.ARMED,
        # An order that is given while the line is armed applies to the boards that come from then on.
        (_S.ARMED, _E.ARM): _S.ARMED,
        (_S.ARMED, _E.BOARD_ARRIVED): _S.FILMING,
        # Boards may follow closely: the next board may arrive while late frames of the previous board are awaited.
        (_S.FILMING, _E.BOARD_ARRIVED): _S.FILMING,
        (_S.FILMING, _E.BOARD_FILMED): _S.ARMED,
        (_S.ARMED, _E.RING_FULL): _S.BLOCKED,
        (_S.BLOCKED, _E.MEMORY_FREED): _S.ARMED,
        **{(state, _E.DISARMED): _S.IDLE for state in (_S.ARMING, _S.ARMED, _S.FILMING, _S.BLOCKED)},
    },
)

ADVICE = {
    _S.STARTING: "Wait: workers start first, then cameras and controller are opened.",
    _S.ARMING: "Wait until the line is armed.",
    _S.FILMING: "Wait until the board has passed; runs/next reports every finished run.",
    _S.BLOCKED: "Release a run.",
    _S.FAULTED: "Check the station's reasons; it retries automatically.",
    _S.STOPPING: "Start the station again.",
}
"""Action that a refusal advises to the caller, by the state in which the request is not possible."""

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
        **{(state, _H.RELEASE): _R.RELEASED for state in (_R.READY, _R.DEGRADED, _R.FAILED)},
        **{(state, _H.MEMORY_TAKEN): _R.GONE for state in (_R.READY, _R.DEGRADED, _R.FAILED)},
        # A second release is legal, so that a caller may repeat it after a lost reply.
        (_R.RELEASED, _H.RELEASE): _R.RELEASED,
        (_R.GONE, _H.RELEASE): _R.GONE,
    },
)

FINISHED = frozenset({_R.READY, _R.DEGRADED, _R.FAILED, _R.RELEASED, _R.GONE})
"""States of a run that has ended. Only the availability of its frames can still change."""
IN_MEMORY = frozenset({_R.READY, _R.DEGRADED, _R.FAILED})
"""States of a run that has ended, in which its frames are still in memory."""
