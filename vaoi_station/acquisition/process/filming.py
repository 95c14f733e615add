"""Film a number of runs with a station's devices, without the other parts of the station."""

from __future__ import annotations

import multiprocessing
import shutil
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from multiprocessing.connection import Connection
from pathlib import Path

from vaoi_station.acquisition.controller.filming_plan import filming_plan
from vaoi_station.acquisition.process.main_loop import run_acquisition
from vaoi_station.acquisition.process.messages import (
    Arm,
    Armed,
    BoardMissed,
    FireOne,
    Grant,
    Ready,
    RunFinished,
    Shutdown,
    Trouble,
)
from vaoi_station.acquisition.ring import Ring, RingLayout, ring_path
from vaoi_station.config import StationConfig
from vaoi_station.errors import DeviceError, InputError
from vaoi_station.files import Recording, open_recording, write_recording
from vaoi_station.files.directories import new_directory
from vaoi_station.files.images import Image
from vaoi_station.model import RecordingHead


def export_run(
    directory: Path, finished: RunFinished, ring: Ring, generation: int, copies: Mapping[str, Path] | None = None
) -> Recording:
    """Write a finished run as the recording `directory`, which must not exist yet."""
    with new_directory(directory) as draft:
        for name, source in (copies or {}).items():
            shutil.copyfile(source, draft / name)
        write_recording(draft, recording_head(finished), _frames(finished, ring, generation))
    return open_recording(directory)


def recording_head(finished: RunFinished) -> RecordingHead:
    """Return the head of the recording of a finished run."""
    document = finished.head.model_dump(mode="json", exclude_none=True)
    document["x_run"] = finished.run
    document["x_ended"] = finished.reason
    document["x_verdicts"] = [
        {"camera": f.camera, "row": f.row, "verdict": str(f.verdict), "cause": f.cause}
        for f in finished.frames
        if not f.usable
    ]
    if finished.proof is not None:
        document["x_proof"] = finished.proof.model_dump(mode="json")
    return RecordingHead.model_validate(document)


def _frames(finished: RunFinished, ring: Ring, generation: int) -> Iterator[tuple[int, int, Image]]:
    for frame in finished.frames:
        if frame.usable and frame.slot is not None:
            yield frame.camera, frame.row, ring.snapshot(frame.slot, generation)


STOP_S = 5.0
"""Time for the acquisition process to close its devices before it is terminated, s."""


@dataclass(frozen=True)
class FilmingHandlers:
    """The functions that filming calls to report. They are always called in the caller's thread."""

    run_finished: Callable[[RunFinished, Ring, int], None]
    """Called with a finished run, the ring and the generation of the run's bay. The bay is reused after the return."""
    notice: Callable[[str], None]


def film(config: StationConfig, runs: int, handlers: FilmingHandlers) -> None:
    """Film a number of boards in a separate acquisition process; block until all are filmed."""
    _check_supply(config, runs)
    with _filming_process(config, handlers) as process:
        _film_boards(config, process, runs)


def film_pulses(config: StationConfig, pulses: int, rate_hz: float, handlers: FilmingHandlers) -> None:
    """Fire a number of pulses without the light barrier, each a run of one row; block until all are filmed."""
    with _filming_process(config, handlers) as process:
        fire_steadily(process, pulses, 1 / rate_hz)


@dataclass
class FilmingProcess:
    """A running acquisition process as the station sees it: its pipe, the ring, and the handlers of its reports."""

    ring: Ring
    connection: Connection
    handlers: FilmingHandlers
    granted: int = 0
    generations: dict[int, int] = field(default_factory=dict)

    def grant(self, bay: int) -> None:
        """Claim a bay, and give the acquisition process the right to use it for one more run."""
        self.generations[bay] = self.ring.claim(bay)
        self.granted += 1
        self.connection.send(Grant(f"{self.granted:03d}", bay))

    def receive(self, wait_s: float | None = None) -> object:
        """Return the next report; None if no report comes within `wait_s`."""
        try:
            return self.connection.recv() if self.connection.poll(wait_s) else None
        except (EOFError, ConnectionResetError, BrokenPipeError) as error:
            what = "the acquisition process ended before all boards were filmed."
            raise DeviceError(what, action="Read its output above; then start again.") from error

    def dispatch(self, report: object, *, fatal: bool) -> None:
        """Call the handler of a report. If `fatal`, raise an error for a reported fault instead."""
        if isinstance(report, RunFinished):
            if report.reason == "max-rows":
                self.handlers.notice("The run ended before the board had left: it is too long, or it was stopped.")
            if (times := len(report.interruptions)) > 1:
                self.handlers.notice(f"The barrier was interrupted {times} times: by cut-outs, or by several boards.")
            self.handlers.run_finished(report, self.ring, self.generations[report.bay])
        elif isinstance(report, BoardMissed):
            self.handlers.notice(f"A board was missed: {report.reason}.")
        elif isinstance(report, Trouble):
            if fatal:
                raise DeviceError(report.message, action=report.action, code=report.code)
            self.handlers.notice(f"{report.message} {report.action}")


def _film_boards(config: StationConfig, process: FilmingProcess, runs: int) -> None:
    armed, done = False, 0
    while done < runs:
        report = process.receive()
        if isinstance(report, Ready):
            for bay in range(min(runs, process.ring.layout.bays)):
                process.grant(bay)
            process.connection.send(Arm(filming_plan(config)))
        elif isinstance(report, Armed):
            armed = True
            process.handlers.notice("Armed: waiting for a board.")
        # A fault before arming means that the line will not be armed. Later faults only cost frames.
        process.dispatch(report, fatal=not armed)
        if isinstance(report, RunFinished):
            done += 1
            if process.granted < runs:
                process.grant(report.bay)


def fire_steadily(process: FilmingProcess, pulses: int, period_s: float) -> None:
    """Fire pulses one after another, each in its own bay. If a pulse is refused, request it again."""
    done, due_s = 0, float("inf")
    waiting = False
    while done < pulses:
        now_s = time.monotonic()
        if now_s >= due_s and not waiting:
            # A refused pulse has not used its grant: the next attempt uses it.
            if process.granted == done:
                process.grant(0)
            process.connection.send(FireOne())
            waiting, due_s = True, now_s + period_s
        report = process.receive(None if waiting or due_s == float("inf") else due_s - now_s)
        if isinstance(report, Ready):
            due_s = time.monotonic()
        process.dispatch(report, fatal=not done)
        waiting = waiting and not isinstance(report, RunFinished | Trouble)
        done += isinstance(report, RunFinished)


@contextmanager
def _filming_process(config: StationConfig, handlers: FilmingHandlers) -> Iterator[FilmingProcess]:
    context = multiprocessing.get_context("spawn")
    ours, theirs = context.Pipe()
    with Ring.create(ring_path(config), RingLayout.of(config)) as ring:
        if ring.lock_note:
            handlers.notice(ring.lock_note)
        process = context.Process(target=run_acquisition, args=(config, ring.path, theirs), name="acquisition")
        process.start()
        # The copy of the process's end is closed here, so that the pipe ends when the process dies, and reading does
        # not block.
        theirs.close()
        try:
            yield FilmingProcess(ring, ours, handlers)
        finally:
            _stop(process, ours)


def _stop(process: multiprocessing.process.BaseProcess, connection: Connection) -> None:
    try:
        connection.send(Shutdown())
    except OSError:
        pass  # the process has ended already
    finally:
        connection.close()
    process.join(STOP_S)
    if process.is_alive():
        process.terminate()
        process.join()


def _check_supply(config: StationConfig, runs: int) -> None:
    if config.simulation is not None and 0 < config.simulation.boards < runs:
        raise InputError.field("station.toml", "simulation.boards", config.simulation.boards, f"0 or at least {runs}")
    if config.replay is not None and 0 < config.replay.runs < runs:
        raise InputError.field("station.toml", "replay.runs", config.replay.runs, f"0 or at least {runs}")
