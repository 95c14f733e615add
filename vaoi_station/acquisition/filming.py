"""Film a number of runs with a station's devices and nothing else of the station."""

from __future__ import annotations

import multiprocessing
from collections.abc import Callable
from multiprocessing.connection import Connection

from vaoi_station.acquisition.controller.interface import TriggerPlan
from vaoi_station.acquisition.messages import (
    Arm,
    Armed,
    BoardMissed,
    FrameSettled,
    Grant,
    Ready,
    RunFinished,
    Shutdown,
    Trouble,
)
from vaoi_station.acquisition.process import run_acquisition
from vaoi_station.acquisition.ring import Ring, RingLayout, ring_path
from vaoi_station.config import StationConfig
from vaoi_station.errors import DeviceError, InputError
from vaoi_station.model import Verdict

STOP_S = 5.0
"""How long the acquisition process may take to close its devices."""


def film(
    config: StationConfig,
    runs: int,
    finished: Callable[[RunFinished, Ring, int], None],
    notice: Callable[[str], None],
    settled: Callable[[FrameSettled, Ring, int], None] | None = None,
) -> None:
    """Film so many boards in a process of its own; blocks until done.

    Args:
        config: the station.
        runs: boards to film.
        finished: called with each run, the ring and the run's generation; its memory is free afterwards.
        notice: called with a sentence for whatever the operator should see.
        settled: called with each whole frame as soon as it is there, the ring and the generation of its bay.
    """
    _check_supply(config, runs)
    context = multiprocessing.get_context("spawn")
    ours, theirs = context.Pipe()
    with Ring.create(ring_path(config), RingLayout.of(config)) as ring:
        if ring.lock_note:
            notice(ring.lock_note)
        process = context.Process(target=run_acquisition, args=(config, ring.path, theirs), name="acquisition")
        process.start()
        theirs.close()
        try:
            _Director(config, ring, ours, finished, notice, settled).film(runs)
        finally:
            _stop(process, ours)


class _Director:
    def __init__(
        self,
        config: StationConfig,
        ring: Ring,
        connection: Connection,
        finished: Callable[[RunFinished, Ring, int], None],
        notice: Callable[[str], None],
        settled: Callable[[FrameSettled, Ring, int], None] | None,
    ) -> None:
        self._config, self._ring, self._connection = config, ring, connection
        self._finished, self._notice, self._settled = finished, notice, settled
        self._generations: dict[int, int] = {}
        self._granted = 0

    def film(self, runs: int) -> None:
        """Grant memory, arm, take what comes."""
        armed, done = False, 0
        while done < runs:
            report = self._receive()
            if isinstance(report, Ready):
                for bay in range(min(runs, self._ring.layout.bays)):
                    self._grant(bay)
                self._connection.send(Arm(TriggerPlan.of(self._config.line)))
            elif isinstance(report, Armed):
                armed = True
                self._notice("Armed: waiting for a board.")
            elif isinstance(report, FrameSettled):
                self._hand_on(report)
            elif isinstance(report, RunFinished):
                self._finished(report, self._ring, self._generations[report.bay])
                done += 1
                if self._granted < runs:
                    self._grant(report.bay)
            elif isinstance(report, BoardMissed):
                self._notice(f"A board was missed: {report.reason}.")
            elif isinstance(report, Trouble):
                if not armed:
                    raise DeviceError(report.message, action=report.action, code=report.code)
                self._notice(f"{report.message} {report.action}")

    def _hand_on(self, report: FrameSettled) -> None:
        slot = report.frame.slot
        if self._settled is not None and slot is not None and report.frame.verdict is Verdict.OK:
            self._settled(report, self._ring, self._generations[self._ring.layout.place(slot)[0]])

    def _grant(self, bay: int) -> None:
        self._generations[bay] = self._ring.claim(bay)
        self._granted += 1
        self._connection.send(Grant(f"{self._granted:03d}", bay))

    def _receive(self) -> object:
        try:
            return self._connection.recv()
        except (EOFError, ConnectionResetError) as error:
            what = "the acquisition process has ended before all boards were filmed."
            raise DeviceError(what, action="Look at what it printed.") from error


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
