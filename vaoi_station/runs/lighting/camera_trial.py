"""Settings of a camera on trial while the line is disarmed: one pulse at a time, into memory of its own.

A trial is filmed as a run of one row that no other part of the station knows. It changes nothing for good: arming sets
the exposures of the plan, and without a further pulse those of station.toml come back after `TRIAL_S`.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from concurrent.futures import Future
from dataclasses import dataclass
from typing import Protocol

from vaoi_station.acquisition.process import messages
from vaoi_station.errors import BusyError, DeviceError, InputError, StateError, VaoiError
from vaoi_station.runs.run.memory import Bay, Memory
from vaoi_station.runs.states.tables import StationState

TRIAL_S = 10.0
"""Time after the last pulse of a trial until the exposures of station.toml are set again, s."""
LEAST_BAYS = 2
"""Bays that must be available for a pulse: one for its frames, and one for the board of an order that comes at once."""

_ARMED = frozenset({StationState.ARMED, StationState.FILMING, StationState.BLOCKED})
"""States in which the cameras have the exposures of a plan."""


@dataclass(frozen=True)
class TrialShot:
    """The frames of one pulse of a trial. Their memory is granted until `CameraTrial.release`."""

    run: str
    bay: Bay
    report: messages.RunFinished


class Sender(Protocol):
    """The one method of the acquisition process that a trial calls."""

    def send(self, command: messages.Command) -> None:
        """Send a command to the acquisition process, without waiting for its effect."""


class CameraTrial:
    """The trial under way. Used by the coordinator's thread only."""

    def __init__(
        self,
        acquisition: Sender,
        state: Callable[[], StationState],
        memory: Memory,
        on_evicted: Callable[[str], None],
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        """Prepare trials.

        Args:
            acquisition: receives the commands.
            state: returns the state of the station.
            memory: gives each pulse a bay.
            on_evicted: called with the run whose frames were given up for a pulse. A ring full of finished runs is
                usual, so a trial takes the memory of the one that finished first, as a board does.
            clock: time.monotonic.
        """
        self._acquisition, self._state, self._memory = acquisition, state, memory
        self._on_evicted, self._clock = on_evicted, clock
        self._count = 0
        self._bay: Bay | None = None
        self._completion: Future[TrialShot] | None = None
        self._until_s = math.inf

    def fire(self, wanted: messages.FireTrial, completion: Future[TrialShot]) -> None:
        """Fire one pulse; the completion gets its frames, or the refusal. The memory of `wanted` is replaced.

        Raises:
            StateError: the line is not disarmed, or another pulse is under way.
            BusyError: there is not enough memory.
        """
        if (state := self._state()) is not StationState.IDLE:
            raise StateError(f"The line is {state}.", action="Disarm it, then try settings.", code="line-armed")
        if self._bay is not None:
            raise StateError("Another pulse is under way.", action="Try again in a moment.", code="trial-running")
        if self._memory.available() < LEAST_BAYS:
            message = f"A trial needs {LEAST_BAYS} bays of the ring that may be used; one stays for the next board."
            raise BusyError(message, action="Release runs, end holds, or increase [ring] runs.", code="ring-full")
        self._count += 1
        granted = self._memory.grant(f"trial-{self._count}")
        if granted.evicted is not None:
            self._on_evicted(granted.evicted)
        self._bay, self._completion = granted.bay, completion
        assert granted.bay.run is not None
        grant = messages.Grant(granted.bay.run, granted.bay.number)
        self._acquisition.send(messages.FireTrial(grant, wanted.exposures, wanted.light, wanted.on_us))
        self._until_s = self._clock() + TRIAL_S

    def takes(self, report: messages.Report) -> bool:
        """Return whether a report belongs to a trial, and act on it."""
        run = getattr(report, "run", None)
        if run is None or self._bay is None or run != self._bay.run:
            return False
        if isinstance(report, messages.TrialFailed):
            self._fail(_error(report.why))
        elif isinstance(report, messages.RunFinished):
            completion, self._completion = self._completion, None
            if completion is None:
                self.release(run)  # the caller has given up
            else:
                completion.set_result(TrialShot(run, self._bay, report))
        return True

    def release(self, run: str) -> None:
        """Free the memory of a pulse whose frames were copied."""
        if self._bay is not None and self._bay.run == run:
            self._bay = None
        self._memory.free(run)

    def abandon(self, completion: Future[TrialShot]) -> None:
        """Let no caller wait for a pulse any more: its memory is free with its end, which may have come meanwhile."""
        if completion is self._completion:
            self._completion = None
        elif completion.done() and completion.exception() is None:
            self.release(completion.result().run)

    def end(self) -> None:
        """Set the exposures of station.toml again. A pulse under way still ends by itself."""
        if math.isfinite(self._until_s):
            self._until_s = math.inf
            self._acquisition.send(messages.EndTrial())

    def tick(self) -> None:
        """End a trial whose time is over, or that an armed line has ended. Arming that was refused has ended none."""
        if (state := self._state()) in _ARMED:
            self._until_s = math.inf
        elif state is StationState.IDLE and self._bay is None and self._clock() >= self._until_s:
            self.end()

    def acquisition_ended(self, description: str) -> None:
        """Take back the memory, and refuse the caller that waits: the process has ended."""
        self._until_s = math.inf
        self._fail(DeviceError(f"{description[:1].upper()}{description[1:]}.", action="Try again in a moment."))

    def _fail(self, error: VaoiError) -> None:
        bay, self._bay = self._bay, None
        completion, self._completion = self._completion, None
        if bay is not None and bay.run is not None:
            self._memory.free(bay.run)
        if completion is not None:
            completion.set_exception(error)


def _error(why: messages.Trouble) -> VaoiError:
    """Return the refusal of the acquisition process as an error of the same kind."""
    kind = {StateError.code: StateError, InputError.code: InputError}.get(why.code, DeviceError)
    message = f"{why.message[:1].upper()}{why.message[1:]}"
    return kind(message, action=why.action, code=why.code)
