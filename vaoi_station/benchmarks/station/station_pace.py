"""Measure a whole station in real time: frames arrive as on a line, and figures show whether the station keeps up."""

from __future__ import annotations

import math
import os
import statistics
import time
from collections.abc import Iterable, Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from vaoi_station.acquisition.ring.ring import ring_path
from vaoi_station.benchmarks.figure_formats import json_document
from vaoi_station.benchmarks.station.frame_sender import run_frame_sender
from vaoi_station.benchmarks.station.prerendered_run import PrerenderedRun
from vaoi_station.benchmarks.station.process_usage import CpuMeter, private_memory_bytes
from vaoi_station.benchmarks.station.sender_devices import Playback, acquisition_launcher
from vaoi_station.config import CameraConfig, ReplayConfig, RingConfig, StationConfig
from vaoi_station.errors import StateError
from vaoi_station.files import write_board_type, write_calibration
from vaoi_station.line_config import Line
from vaoi_station.model import RecordingHead
from vaoi_station.runs.control.coordinator import StationCoordinator
from vaoi_station.runs.states.schemas import RunDetail
from vaoi_station.runs.states.timeline_schemas import Timeline
from vaoi_station.station import Station

PAUSE_S = 1.0
"""Pause between two boards at rate 1. At a higher rate the pause is divided by the rate."""
READY_S = 300.0
"""Time limit until the station is ready: processes start, workers compile and warm up."""
RUN_LIMIT_S = 180.0
"""Time limit for one run to end; after it the benchmark does not wait for further runs."""


@dataclass(frozen=True)
class BoardFigures:
    """The measured values for the run of one board."""

    state: str
    status: str
    frames: int
    lost: int
    ready_after_last_frame_ms: float
    conclude_ms: float
    links_open_at_last_frame: int
    """Links that were possible but not computed when the last frame arrived, without those of the last row."""
    lag_first_half_ms: float
    """Time from the arrival of the later of two frames to their link, median over the rows of the first half."""
    lag_second_half_ms: float
    """The same as `lag_first_half_ms` for the second half of the rows. If it is larger, the station falls behind."""


@dataclass(frozen=True)
class RateFigures:
    """Figures of all boards at one rate. Times are wall time unless the name contains `cpu`.

    A figure without any board, frame or task to compute it from is NaN, and None in the document.
    """

    rate: float
    """Factor on the trigger rate of the prerendered run."""
    frames_per_s: float
    """Frame rate of each camera."""
    mbit_per_s: float
    """Data rate of all cameras while a board passes."""
    boards: int
    boards_missed: int
    """Boards for which no bay was free, because earlier boards were still being stitched."""
    frames_lost: int
    kept_up: bool
    """Whether the station kept up with the line.

    No board or frame was lost, and when a board's last frame arrived, at most the links of one row were not computed
    yet."""
    ready_after_last_frame_ms: dict[str, float]
    conclude_ms: float
    lag_first_half_ms: float
    lag_second_half_ms: float
    links_open_at_last_frame: float
    cpu_ms_per_frame: dict[str, float]
    """Process name → CPU time per frame. `sender` replaces cameras and network cards and is not part of the station."""
    cores: float
    """CPU time of the station's processes over the time in which boards pass, without the gaps between them."""
    sender_cores: float
    """CPU time of the sender process over the time in which boards pass."""
    memory_mb: dict[str, float]
    """Private memory of each process after the last board; the ring is not counted."""
    statuses: dict[str, int]
    """Number of boards by verdict."""
    load_before: float
    """Load average of the machine over the minute before: other programs may have used part of the CPU."""
    each: tuple[BoardFigures, ...]

    def document(self) -> dict[str, Any]:
        """Return all figures of the benchmark as a dictionary for JSON."""
        document: dict[str, Any] = json_document(asdict(self))
        return document


class StationUsage(NamedTuple):
    """The use of the computer while the boards passed. The keys of the mappings are names of processes."""

    load_before: float
    boards_missed: int
    cpu_s: Mapping[str, float]
    memory_mb: dict[str, float]


def measure_station_pace(
    run: PrerenderedRun, rate: float, boards: int, workers: int, folder: Path, ring: Path
) -> RateFigures:
    """Run a station with the prerendered board at a multiple of its trigger rate, and measure it.

    Args:
        run: the board, its array and its line.
        rate: factor on belt velocity and trigger rate. Both grow together, so that the frames stay the same.
        boards: number of boards that pass.
        workers: number of worker processes.
        folder: folder for the station's files, which are not deleted.
        ring: directory for the file of the ring.
    """
    config, load = pace_config(run, rate, workers, folder, ring), os.getloadavg()[0]
    playback = Playback(run, rate, PAUSE_S / rate)
    with run_frame_sender(run) as sender:
        launch = acquisition_launcher(config, ring_path(config), playback, sender.connection)
        with Station(config, launch) as station:
            coordinator = station.coordinator
            # Compilation and warm-up happen once per start of the station and would count as CPU time per frame.
            wait_until_ready(coordinator, READY_S)
            pids = {"station": os.getpid(), "sender": sender.pid}
            pids |= {p.name: p.pid for p in coordinator.snapshot().processes if p.pid is not None}
            meter = CpuMeter(pids)
            coordinator.arm(run.board_type.name, runs=boards)
            details = _follow(coordinator, boards)
            missed = coordinator.snapshot().boards_missed
            # This comes before the timelines are read, because their transfer is not part of the work per frame.
            cpu = meter.read()
            memory = {name: round(private_memory_bytes(pid) / 1e6, 1) for name, pid in pids.items()}
            each = tuple(board_figures(d, coordinator.timeline(d.id)) for d in details)
    return rate_figures(run.head, rate, each, StationUsage(load, missed, cpu, memory))


def pace_config(run: PrerenderedRun, rate: float, workers: int, folder: Path, ring: Path) -> StationConfig:
    """Return the configuration of a station with the run's array over a line that is `rate` times as fast."""
    head = run.head
    write_calibration(folder / "calibration.json", run.calibration)
    write_board_type(folder / "board-types" / f"{run.board_type.name}.json", run.board_type)
    return StationConfig(
        name=f"vaoi-bench-{os.getpid()}",
        calibration=folder / "calibration.json",
        board_types=folder / "board-types",
        data=folder / f"data-{rate:g}",
        workers=workers,
        line=_faster(run.line, rate),
        cameras=tuple(
            CameraConfig(
                name=f"camera {n}", backend="replay", width=c.width, height=c.height, exposure_us=c.exposure_us
            )
            for n, c in enumerate(head.cameras)
        ),
        controller={"backend": "replay"},
        replay=ReplayConfig(recordings=(run.directory,)),
        ring=RingConfig(directory=ring, runs=3, keep_s=0.1),
    )  # fmt: skip


def _faster(line: Line, rate: float) -> Line:
    # All times are reduced together, so that each pulse meets the board at the same place as in the prerendered run.
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


def wait_until_ready(coordinator: StationCoordinator, limit_s: float) -> None:
    """Wait until all processes of the station are ready; raise StateError after `limit_s` seconds."""
    deadline, seen = time.monotonic() + limit_s, 0
    while not _all_ready(coordinator):
        if time.monotonic() > deadline:
            raise StateError(f"The station was not ready within {limit_s:.0f} s: {coordinator.snapshot().reasons}.")
        # Workers become ready without an event, so the condition is also checked twice a second.
        records = coordinator.events(seen, 0.5)
        seen = records[-1].number if records else seen


def _follow(coordinator: StationCoordinator, boards: int) -> list[RunDetail]:
    """Return the details of the runs in the order in which they end; fewer than `boards` if a run takes too long."""
    runs: list[RunDetail] = []
    while len(runs) < boards:
        run = _next(coordinator, runs[-1].id if runs else None)
        if run is None:
            break
        runs.append(run)
    if not runs:
        raise StateError(f"No run ended within {RUN_LIMIT_S:.0f} s.", action="See the log.")
    return runs


def _next(coordinator: StationCoordinator, after: str | None) -> RunDetail | None:
    """Return the run that ends next after the run `after` (None: the first run); None after the time limit."""
    if after is not None:
        return coordinator.next_run(after, RUN_LIMIT_S)
    deadline, seen = time.monotonic() + RUN_LIMIT_S, 0
    while (first := coordinator.latest()) is None and time.monotonic() < deadline:
        records = coordinator.events(seen, 1.0)
        seen = records[-1].number if records else seen
    return first


def board_figures(run: RunDetail, timeline: Timeline) -> BoardFigures:
    """Compute the figures of one run from its details and the times of its tasks."""
    last_row = run.rows - 1
    # A link of the last row becomes possible only with the last frame, so it shows nothing about a backlog.
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
        lag_first_half_ms=_median(lag[~late]),
        lag_second_half_ms=_median(lag[late]),
    )


def rate_figures(head: RecordingHead, rate: float, each: tuple[BoardFigures, ...], usage: StationUsage) -> RateFigures:
    """Combine the figures of all boards at one rate."""
    frames = sum(b.frames for b in each)
    ready = [b.ready_after_last_frame_ms for b in each]
    lost = sum(b.lost for b in each)
    per_s = rate / head.trigger_period_s
    # Each frame is linked with its predecessor and at most one neighbour.
    links_of_a_row = 2 * len(head.cameras)
    # Computed from the number of frames, because a clock would include the pauses between boards, with little load.
    passing_s = frames / (per_s * len(head.cameras))
    station_cpu_s = sum(s for name, s in usage.cpu_s.items() if name != "sender")
    return RateFigures(
        rate=rate,
        frames_per_s=round(per_s, 2),
        mbit_per_s=round(sum(c.width * c.height for c in head.cameras) * 8 * per_s * 1e-6, 1),
        boards=len(each),
        boards_missed=usage.boards_missed,
        frames_lost=lost,
        kept_up=not usage.boards_missed
        and not lost
        # Without a frame, nothing shows that the station keeps up.
        and frames > 0
        and max(b.links_open_at_last_frame for b in each) <= links_of_a_row,
        ready_after_last_frame_ms={
            "median": _median(ready),
            # The nearest rank that 99 % do not exceed: a measured value, and not one interpolated between two boards.
            "p99": sorted(ready)[math.ceil(0.99 * (len(ready) - 1))] if ready else math.nan,
            "max": max(ready, default=math.nan),
        },
        conclude_ms=_median([b.conclude_ms for b in each]),
        lag_first_half_ms=_median([b.lag_first_half_ms for b in each]),
        lag_second_half_ms=_median([b.lag_second_half_ms for b in each]),
        links_open_at_last_frame=_median([b.links_open_at_last_frame for b in each]),
        cpu_ms_per_frame={name: _quotient(s * 1e3, frames) for name, s in usage.cpu_s.items()},
        cores=_quotient(station_cpu_s, passing_s),
        sender_cores=_quotient(usage.cpu_s.get("sender", 0.0), passing_s),
        memory_mb=usage.memory_mb,
        statuses={status: sum(b.status == status for b in each) for status in sorted({b.status for b in each})},
        load_before=round(usage.load_before, 2),
        each=each,
    )


def _median(values: Iterable[float]) -> float:
    """Compute the median of the values that exist, rounded to 2 decimals; NaN if there is none."""
    # A board of one row has no lag of its second half. Infinity, for a run without a result, is included.
    known = [float(v) for v in values if not math.isnan(v)]
    return round(statistics.median(known), 2) if known else math.nan


def _quotient(part: float, whole: float) -> float:
    return round(part / whole, 3) if whole else math.nan


def _ms(value: Any) -> float:
    # A run without a result has no times. With infinity it counts as the slowest run in medians.
    return round(float(value), 2) if value is not None else float("inf")
