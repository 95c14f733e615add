"""A whole station against the clock: frames come at a line's pace, and the figures say whether it kept up."""

from __future__ import annotations

import os
import statistics
import time
from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from vaoi_station.acquisition.ring.ring import ring_path
from vaoi_station.benchmarks.feed import launched
from vaoi_station.benchmarks.film import Film
from vaoi_station.benchmarks.sender import sender
from vaoi_station.benchmarks.usage import Meter, own_memory_bytes
from vaoi_station.config import CameraConfig, Line, ReplayConfig, RingConfig, StationConfig
from vaoi_station.errors import StateError
from vaoi_station.files import write_board_type, write_calibration
from vaoi_station.runs.control.coordinator import StationCoordinator
from vaoi_station.runs.states.schemas import RunDetail, Timeline
from vaoi_station.station import Station

PAUSE_S = 1.0
"""Between two boards at the film's own rate; less in proportion where it is played faster."""
READY_S = 120.0
"""Processes start, workers compile and warm up."""
SILENCE_S = 180.0
"""A run that takes longer than this to come is none."""


@dataclass(frozen=True)
class BoardFigures:
    """One run."""

    state: str
    status: str
    frames: int
    lost: int
    ready_after_last_frame_ms: float
    conclude_ms: float
    links_open_at_last_frame: int
    """Links that were possible and not done when the last frame had come, but for those of the last row."""
    lag_first_half_ms: float
    """From the arrival of the later of its frames to a link being done, median, rows of the first half."""
    lag_second_half_ms: float


@dataclass(frozen=True)
class RateFigures:
    """Boards at one rate; times are wall time unless they say CPU."""

    rate: float
    """So many times the film's own."""
    frames_per_s: float
    """Of each camera."""
    mbit_per_s: float
    """While a board passes."""
    boards: int
    boards_missed: int
    """Boards for which there was no memory, because earlier ones were still being stitched."""
    frames_lost: int
    kept_up: bool
    """No board or frame lost, and whenever the last frame came no more links were open than one row has."""
    ready_after_last_frame_ms: dict[str, float]
    conclude_ms: float
    lag_first_half_ms: float
    lag_second_half_ms: float
    links_open_at_last_frame: float
    cpu_ms_per_frame: dict[str, float]
    """By process; `sender` stands in for cameras and network card and is not of the station."""
    cores: float
    """CPU time of the station's processes over the time the cameras filmed, the gaps between boards left out."""
    sender_cores: float
    """The same of the sender."""
    memory_mb: dict[str, float]
    """Held by each process alone after the last board, the ring not counted."""
    statuses: dict[str, int]
    load_before: float
    """Of the machine over the last minute: others may have had their share."""
    each: tuple[BoardFigures, ...]

    def document(self) -> dict[str, Any]:
        """For JSON."""
        return asdict(self)


def paced(film: Film, rate: float, boards: int, workers: int, folder: Path, ring: Path) -> RateFigures:
    """Let boards pass a station of the film's array at so many times the film's pace.

    Args:
        film: the board.
        rate: 2 means a line twice as fast, triggered twice as often.
        boards: how many pass.
        workers: the station's worker processes.
        folder: for the station's data; the results stay there.
        ring: directory for the ring.
    """
    config, load = _config(film, rate, workers, folder, ring), os.getloadavg()[0]
    pause_s = PAUSE_S / rate
    with sender(film) as source:
        launch = launched(config, ring_path(config), film, rate, pause_s, source.connection)
        with Station(config, launch) as station:
            coordinator = station.coordinator
            _wait_until(coordinator, lambda: _all_ready(coordinator), READY_S)
            pids = {"station": os.getpid(), "sender": source.pid}
            pids |= {p.name: p.pid for p in coordinator.snapshot().processes if p.pid is not None}
            meter = Meter(pids)
            coordinator.arm(film.board_type.name, runs=boards)
            runs = _follow(coordinator, boards)
            missed = coordinator.snapshot().boards_missed
            cpu = meter.read()
            memory = {name: round(own_memory_bytes(pid) / 1e6, 1) for name, pid in pids.items()}
            each = tuple(_board(run, coordinator.timeline(run.id)) for run in runs)
    return _rate(film, rate, load, each, missed, cpu, memory)


def _config(film: Film, rate: float, workers: int, folder: Path, ring: Path) -> StationConfig:
    """The film's array over a line so many times as fast."""
    head = film.head
    write_calibration(folder / "calibration.json", film.calibration)
    write_board_type(folder / "board-types" / f"{film.board_type.name}.json", film.board_type)
    return StationConfig(
        name=f"vaoi-bench-{os.getpid()}",
        calibration=folder / "calibration.json",
        board_types=folder / "board-types",
        data=folder / f"data-{rate:g}",
        workers=workers,
        line=_faster(film.line, rate),
        cameras=tuple(
            CameraConfig(
                name=f"camera {n}", backend="replay", width=c.width, height=c.height, exposure_us=c.exposure_us
            )
            for n, c in enumerate(head.cameras)
        ),
        controller={"backend": "replay"},
        replay=ReplayConfig(recordings=(film.directory,)),
        ring=RingConfig(directory=ring, runs=3),
    )  # fmt: skip


def _faster(line: Line, rate: float) -> Line:
    return line.model_copy(
        update={
            "conveyor_mm_s": tuple(v * rate for v in line.conveyor_mm_s),
            "start_delay_s": line.start_delay_s / rate,
            "trigger_period_s": line.trigger_period_s / rate,
            "tail_s": line.tail_s / rate,
        }
    )


def _all_ready(coordinator: StationCoordinator) -> bool:
    snapshot = coordinator.snapshot()
    return snapshot.state == "idle" and not any(p.doing == "starting" for p in snapshot.processes)


def _wait_until(coordinator: StationCoordinator, true: Callable[[], bool], limit_s: float) -> None:
    """Woken by events, and twice a second, as workers come up without one."""
    deadline, seen = time.monotonic() + limit_s, 0
    while not true():
        if time.monotonic() > deadline:
            raise StateError(f"The station was not ready within {limit_s:.0f} s: {coordinator.snapshot().reasons}.")
        records = coordinator.events(seen, 0.5)
        seen = records[-1].number if records else seen


def _follow(coordinator: StationCoordinator, boards: int) -> list[RunDetail]:
    """So many runs in the order they end."""
    runs: list[RunDetail] = []
    while len(runs) < boards:
        run = _next(coordinator, runs[-1].id if runs else None)
        if run is None:
            break
        runs.append(run)
    if not runs:
        raise StateError(f"No run came to its end within {SILENCE_S:.0f} s.", action="See the log.")
    return runs


def _next(coordinator: StationCoordinator, after: str | None) -> RunDetail | None:
    if after is not None:
        return coordinator.next_run(after, SILENCE_S)
    deadline, seen = time.monotonic() + SILENCE_S, 0
    while (first := coordinator.latest()) is None and time.monotonic() < deadline:
        records = coordinator.events(seen, 1.0)
        seen = records[-1].number if records else seen
    return first


def _board(run: RunDetail, timeline: Timeline) -> BoardFigures:
    last_row = run.rows - 1
    earlier = [t for t in timeline.tasks if max(t.row, t.other_row or 0) < last_row]
    lag = np.array([t.done_s - t.ready_s for t in timeline.tasks]) * 1e3
    late = np.array([max(t.row, t.other_row or 0) >= run.rows / 2 for t in timeline.tasks])
    timings = run.timings
    assert timings is not None
    return BoardFigures(
        state=run.state,
        status=str(run.verdict),
        frames=run.counts.ok,
        lost=run.counts.missing + run.counts.incomplete,
        ready_after_last_frame_ms=_ms(timings.ready_after_last_frame_ms),
        conclude_ms=_ms(timings.conclude_ms),
        links_open_at_last_frame=sum(t.done_s > timeline.last_frame_s for t in earlier),
        lag_first_half_ms=_ms(np.median(lag[~late])),
        lag_second_half_ms=_ms(np.median(lag[late])),
    )


def _rate(
    film: Film,
    rate: float,
    load: float,
    each: tuple[BoardFigures, ...],
    missed: int,
    cpu: dict[str, float],
    memory: dict[str, float],
) -> RateFigures:
    head, frames = film.head, sum(b.frames for b in each)
    ready = [b.ready_after_last_frame_ms for b in each]
    lost = sum(b.lost for b in each)
    per_s = rate / head.trigger_period_s
    links_of_a_row = 2 * len(head.cameras)
    filming_s = frames / (per_s * len(head.cameras))
    mine = {name: s for name, s in cpu.items() if name != "sender"}
    return RateFigures(
        rate=rate,
        frames_per_s=round(per_s, 2),
        mbit_per_s=round(sum(c.width * c.height for c in head.cameras) * 8 * per_s * 1e-6, 1),
        boards=len(each),
        boards_missed=missed,
        frames_lost=lost,
        kept_up=not missed and not lost and max(b.links_open_at_last_frame for b in each) <= links_of_a_row,
        ready_after_last_frame_ms={
            "median": _ms(statistics.median(ready)),
            "p99": _ms(np.percentile(ready, 99, method="higher")),
            "max": max(ready),
        },
        conclude_ms=_ms(statistics.median(b.conclude_ms for b in each)),
        lag_first_half_ms=_ms(statistics.median(b.lag_first_half_ms for b in each)),
        lag_second_half_ms=_ms(statistics.median(b.lag_second_half_ms for b in each)),
        links_open_at_last_frame=statistics.median(b.links_open_at_last_frame for b in each),
        cpu_ms_per_frame={name: round(s * 1e3 / frames, 3) for name, s in cpu.items()},
        cores=round(sum(mine.values()) / filming_s, 3),
        sender_cores=round(cpu["sender"] / filming_s, 3),
        memory_mb=memory,
        statuses={status: sum(b.status == status for b in each) for status in sorted({b.status for b in each})},
        load_before=round(load, 2),
        each=each,
    )


def _ms(value: Any) -> float:
    return round(float(value), 2) if value is not None else float("inf")
