"""Film a number of runs with a station's devices and nothing else of the station."""

from __future__ import annotations

import multiprocessing
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from multiprocessing.connection import Connection

from vaoi_station.acquisition.controller.interface import TriggerPlan
from vaoi_station.acquisition.process.main_loop import run_acquisition
from vaoi_station.acquisition.process.messages import (
    Arm,
    Armed,
    BoardMissed,
    FireOne,
    FrameSettled,
    Grant,
    Ready,
    RunFinished,
    Shutdown,
    Trouble,
)
from vaoi_station.acquisition.ring.ring import Ring, RingLayout, ring_path
from vaoi_station.config import StationConfig
from vaoi_station.errors import DeviceError, InputError
from vaoi_station.model import Verdict

STOP_S = 5.0
"""How long the acquisition process may take to close its devices."""


Finish = Callable[[RunFinished, Ring, int], None]
"""Called with a run, the ring and the run's generation; its memory is free afterwards."""
Settle = Callable[[FrameSettled, Ring, int], None]
"""Called with a whole frame as soon as it is there, the ring and the generation of its bay."""
Notice = Callable[[str], None]
"""Called with a sentence for whatever the operator should see."""


def film(config: StationConfig, runs: int, finished: Finish, notice: Notice, settled: Settle | None = None) -> None:
    """Film so many boards in a process of its own; blocks until done.

    Raises:
        InputError: so many boards will never come.
        DeviceError: a device does not do what it should.
    """
    _check_supply(config, runs)
    with _studio(config, finished, notice, settled) as studio:
        _film_boards(config, studio, runs)


def film_pulses(
    config: StationConfig, pulses: int, rate_hz: float, finished: Finish, notice: Notice, settled: Settle | None = None
) -> None:
    """Fire so many pulses without the light barrier, each of them a run of one row; blocks until done.

    Args:
        config: the station.
        pulses: how many.
        rate_hz: so many a second; a pulse waits until the one before has all its frames, or they are given up.
        finished: as for `film`.
        notice: as for `film`.
        settled: as for `film`.

    Raises:
        DeviceError: a device does not do what it should, or cannot fire without a board.
    """
    with _studio(config, finished, notice, settled) as studio:
        _fire_steadily(studio, pulses, 1 / rate_hz)


@dataclass
class _Studio:
    """An acquisition process at the other end of a pipe, its ring, and who is told of its reports."""

    ring: Ring
    connection: Connection
    finished: Finish
    notice: Notice
    settled: Settle | None
    granted: int = 0
    generations: dict[int, int] = field(default_factory=dict)

    def grant(self, bay: int) -> None:
        """Memory for one more run."""
        self.generations[bay] = self.ring.claim(bay)
        self.granted += 1
        self.connection.send(Grant(f"{self.granted:03d}", bay))

    def receive(self, wait_s: float | None = None) -> object:
        """The next report; None if none comes in time."""
        try:
            return self.connection.recv() if self.connection.poll(wait_s) else None
        except (EOFError, ConnectionResetError, BrokenPipeError) as error:
            what = "the acquisition process has ended before all boards were filmed."
            raise DeviceError(what, action="Look at what it printed.") from error

    def take(self, report: object, *, fatal: bool) -> None:
        """What is handed on however it was filmed; `fatal`: trouble now means that it will not work at all."""
        if isinstance(report, FrameSettled):
            slot = report.frame.slot
            if self.settled is not None and slot is not None and report.frame.verdict is Verdict.OK:
                self.settled(report, self.ring, self.generations[self.ring.layout.place(slot)[0]])
        elif isinstance(report, RunFinished):
            self.finished(report, self.ring, self.generations[report.bay])
        elif isinstance(report, BoardMissed):
            self.notice(f"A board was missed: {report.reason}.")
        elif isinstance(report, Trouble):
            if fatal:
                raise DeviceError(report.message, action=report.action, code=report.code)
            self.notice(f"{report.message} {report.action}")


def _film_boards(config: StationConfig, studio: _Studio, runs: int) -> None:
    """Grant memory, arm, take what comes."""
    armed, done = False, 0
    while done < runs:
        report = studio.receive()
        if isinstance(report, Ready):
            for bay in range(min(runs, studio.ring.layout.bays)):
                studio.grant(bay)
            studio.connection.send(Arm(TriggerPlan.of(config.line)))
        elif isinstance(report, Armed):
            armed = True
            studio.notice("Armed: waiting for a board.")
        studio.take(report, fatal=not armed)
        if isinstance(report, RunFinished):
            done += 1
            if studio.granted < runs:
                studio.grant(report.bay)


def _fire_steadily(studio: _Studio, pulses: int, period_s: float) -> None:
    """One pulse after another, each with memory of its own; one that was refused is asked for again."""
    done, due_s = 0, float("inf")
    waiting = False
    while done < pulses:
        now_s = time.monotonic()
        if now_s >= due_s and not waiting:
            if studio.granted == done:
                studio.grant(0)
            studio.connection.send(FireOne())
            waiting, due_s = True, now_s + period_s
        report = studio.receive(None if waiting or due_s == float("inf") else due_s - now_s)
        if isinstance(report, Ready):
            due_s = time.monotonic()
        studio.take(report, fatal=not done)
        waiting = waiting and not isinstance(report, RunFinished | Trouble)
        done += isinstance(report, RunFinished)


@contextmanager
def _studio(config: StationConfig, finished: Finish, notice: Notice, settled: Settle | None) -> Iterator[_Studio]:
    """A process that films, and its ring; both are gone afterwards."""
    context = multiprocessing.get_context("spawn")
    ours, theirs = context.Pipe()
    with Ring.create(ring_path(config), RingLayout.of(config)) as ring:
        if ring.lock_note:
            notice(ring.lock_note)
        process = context.Process(target=run_acquisition, args=(config, ring.path, theirs), name="acquisition")
        process.start()
        theirs.close()
        try:
            yield _Studio(ring, ours, finished, notice, settled)
        finally:
            _stop(process, ours)


def _stop(process: multiprocessing.process.BaseProcess, connection: Connection) -> None:
    try:
        connection.send(Shutdown())
    except OSError:
        pass  # it has gone already
    finally:
        connection.close()
    process.join(STOP_S)
    if process.is_alive():
        process.terminate()
        process.join()


def _check_supply(config: StationConfig, runs: int) -> None:
    """Refuse to wait for boards that will never come."""
    if config.simulation is not None and 0 < config.simulation.boards < runs:
        raise InputError.field("station.toml", "simulation.boards", config.simulation.boards, f"0 or at least {runs}")
    if config.replay is not None and 0 < config.replay.runs < runs:
        raise InputError.field("station.toml", "replay.runs", config.replay.runs, f"0 or at least {runs}")
