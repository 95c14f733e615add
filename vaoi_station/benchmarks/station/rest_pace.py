"""Measure what callers of the REST interface wait, and what they cost the next board."""

from __future__ import annotations

import math
import os
import random
import statistics
import threading
import time
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, replace
from datetime import datetime
from pathlib import Path
from typing import Any
from urllib.parse import quote

from vaoi_station.acquisition.ring.ring import ring_path
from vaoi_station.api import create_app
from vaoi_station.api.web_server import WebServer, open_listener
from vaoi_station.benchmarks.figure_formats import json_document
from vaoi_station.benchmarks.station.frame_sender import run_frame_sender
from vaoi_station.benchmarks.station.prerendered_run import PrerenderedRun
from vaoi_station.benchmarks.station.process_usage import ThreadMeter, private_memory_bytes
from vaoi_station.benchmarks.station.rest_client import Fetched, ReadBatch, callers, read_batch
from vaoi_station.benchmarks.station.sender_devices import Playback, acquisition_launcher
from vaoi_station.benchmarks.station.station_pace import PAUSE_S, READY_S, RUN_LIMIT_S, pace_config, wait_until_ready
from vaoi_station.errors import StateError
from vaoi_station.model import BoardType
from vaoi_station.runs.control.coordinator import StationCoordinator
from vaoi_station.runs.states.schemas import ComponentSummary, RunDetail
from vaoi_station.station import Station

LARGE_CALLERS, LARGE_PX_PER_MM = 8, 277
"""Callers of large pictures, and their resolution."""
_LARGEST_PX = 16_000_000
IDLE_S, TRIVIAL_S = 3.0, 1.0
"""Times for which pictures and trivial replies are fetched while nothing is filmed."""
TRIVIAL = "/healthz"
"""Address whose reply is trivial: what a picture takes longer is its own cost, not that of the connection."""
_PICTURES_PER_TRIVIAL = 3
_SERVING = ("api", "AnyIO worker thread")
"""Names of the threads of the station's process that serve requests."""
PICTURE_GOALS_MS = 4, 15
"""Goals of a single picture while a board is filmed: median and 99th percentile."""
FIRST_BYTE_GOAL_MS, BATCH_GOAL_S = 50, 3
"""Goals of all pictures of a run in one request."""
_BATCHES = ("format=raw", "format=raw", "format=jpeg", "format=jpeg")
_HOLDER = "vaoi bench"


@dataclass(frozen=True)
class ReplyTimes:
    """Times from requests to the last bytes of their replies."""

    count: int
    p50_ms: float
    p99_ms: float
    max_ms: float
    cpu_ms: float = math.nan
    """CPU time of the threads that serve requests, for each reply; NaN if it was not measured."""


@dataclass(frozen=True)
class BatchTimes:
    """All pictures of a run in one request."""

    query: str
    first_byte_ms: float
    total_s: float
    mbytes: float
    complete: bool
    memory_mb: dict[str, float]
    """Private memory of each process of the station afterwards."""


@dataclass(frozen=True)
class RestFigures:
    """What callers of the REST interface wait, and what they cost the next board. Times are wall time."""

    components: int
    idle: ReplyTimes
    """Single pictures of components, one after another over one connection, while nothing is filmed."""
    idle_trivial: ReplyTimes
    """Trivial replies in the same way."""
    picture: ReplyTimes
    """Single pictures of the board before, while a board is filmed."""
    trivial: ReplyTimes
    """Trivial replies among these pictures."""
    large: ReplyTimes
    """Large pictures of `LARGE_CALLERS` callers, while a board is filmed."""
    ready_ms: dict[str, float]
    """Time from the last frame to the matrices: of a board alone, one with a caller of pictures, one with callers of
    large pictures."""
    batches: tuple[BatchTimes, ...]
    memory_before_mb: dict[str, float]
    """Private memory of each process of the station before the batches."""
    load_before: float

    def document(self) -> dict[str, Any]:
        """Return all figures of the benchmark as a dictionary for JSON."""
        document: dict[str, Any] = json_document(asdict(self))
        return document

    def lines(self) -> list[str]:
        """Return the figures as lines of text, with their goals."""
        p50, p99 = PICTURE_GOALS_MS
        shown = [
            f"{name} p50 {t.p50_ms:.1f} ms, p99 {t.p99_ms:.1f} ms, max {t.max_ms:.1f} ms of {t.count}{more}"
            for name, t, more in (
                ("pictures while nothing is filmed", self.idle, f", {self.idle.cpu_ms:.2f} ms of CPU time each"),
                ("trivial replies                 ", self.idle_trivial, f", {self.idle_trivial.cpu_ms:.2f} ms each"),
                ("pictures while a board is filmed", self.picture, f" (goal {p50} ms, {p99} ms)"),
                ("trivial replies meanwhile       ", self.trivial, ""),
                ("large pictures meanwhile        ", self.large, ""),
            )
        ]
        alone = self.ready_ms["alone"]
        shown += [
            f"matrices {name:26s} {ms:.0f} ms after the last frame, {ms / alone:.2f} × alone"
            for name, ms in self.ready_ms.items()
        ]
        for b in self.batches:
            size = f"{b.mbytes:.1f} MB in {b.total_s:.2f} s{'' if b.complete else ', incomplete'}"
            grown = b.memory_mb["station"] - self.memory_before_mb["station"]
            goals = f"(goal {FIRST_BYTE_GOAL_MS} ms, {BATCH_GOAL_S} s)"
            memory = f"station {grown:+.0f} MB (goal flat)"
            shown.append(f"batch {b.query:14s} first byte {b.first_byte_ms:.0f} ms, {size} {goals}, {memory}")
        return [*shown, f"load before {self.load_before:.1f}"]


def measure_rest(
    run: PrerenderedRun, workers: int, folder: Path, ring: Path, report: Callable[[str], None] = lambda _: None
) -> RestFigures:
    """Run a station with its REST service and callers in other processes, and measure them.

    Args:
        run: the board, its array and its line.
        workers: number of worker processes.
        folder: folder for the station's files, which are not deleted.
        ring: directory for the file of the ring.
        report: receives a line before each step.
    """
    config, load = pace_config(run, 1.0, workers, folder, ring), os.getloadavg()[0]
    playback = Playback(run, 1.0, PAUSE_S)
    with run_frame_sender(run) as sender:
        launch = acquisition_launcher(config, ring_path(config), playback, sender.connection)
        with Station(config, launch) as station, open_listener("127.0.0.1", 0, "vaoi bench") as listener:
            wait_until_ready(station.coordinator, READY_S)
            server = WebServer(create_app(station.coordinator), listener, lambda: None)
            server.start()
            try:
                return _measured(station.coordinator, run, listener.getsockname()[1], load, report)
            finally:
                server.stop()


def _measured(
    coordinator: StationCoordinator, run: PrerenderedRun, port: int, load: float, report: Callable[[str], None]
) -> RestFigures:
    parts = run.board_type.components
    report("A board passes alone.")
    coordinator.arm(run.board_type.name, runs=1)
    first = _next_run(coordinator, None)
    coordinator.hold(first.id, _HOLDER, "measures callers")
    base = f"/api/v1/runs/{first.id}"
    pictures, crops = picture_paths(base, coordinator.components(first.id), run.board_type)
    # Board types list their large parts first: in their order, the pictures that are fetched in a few seconds would be
    # many times as large as those of the whole board.
    random.Random(0).shuffle(pictures)
    report(f"A caller fetches some of {len(pictures)} pictures one by one, while nothing is filmed.")
    idle, idle_trivial = _while_idle(port, pictures, IDLE_S), _while_idle(port, [TRIVIAL], TRIVIAL_S)
    report("A board passes while a caller fetches these pictures.")
    second, fetched = _with_callers(coordinator, first, port, _with_trivial(pictures), 1)
    single = reply_times([f.ms for f in fetched if f.path != TRIVIAL])
    trivial = reply_times([f.ms for f in fetched if f.path == TRIVIAL])
    report(f"A board passes while {LARGE_CALLERS} callers fetch pictures of {LARGE_PX_PER_MM} px/mm.")
    third, large = _with_callers(coordinator, second, port, crops, LARGE_CALLERS)
    pids = {"station": os.getpid()} | {p.name: p.pid for p in coordinator.snapshot().processes if p.pid is not None}
    before = _memory_mb(pids)
    batches = []
    for query in _BATCHES:
        report(f"All pictures of a run are read in one request ({query}).")
        found = read_batch(port, f"{base}/images?container=tar&{query}")
        batches.append(BatchTimes(query, *_rounded(found), found.complete, _memory_mb(pids)))
    return RestFigures(
        components=len(parts),
        idle=idle,
        idle_trivial=idle_trivial,
        picture=single,
        trivial=trivial,
        large=reply_times([f.ms for f in large]),
        ready_ms={
            "alone": _ready_ms(first),
            "with pictures": _ready_ms(second),
            "with large pictures": _ready_ms(third),
        },
        batches=tuple(batches),
        memory_before_mb=before,
        load_before=round(load, 2),
    )


def picture_paths(
    base: str, components: Sequence[ComponentSummary], board_type: BoardType
) -> tuple[list[str], list[str]]:
    """Return the addresses of the best picture of every component that is seen, and of the largest as large pictures.

    Args:
        base: address of the run.
        components: the components of the run; each call of the coordinator computes them anew.
        board_type: the type of the board.
    """
    seen = [c.address for c in components if c.views]
    mm = board_type.mm_per_unit
    px = {c.address: c.width * c.height * (mm * LARGE_PX_PER_MM) ** 2 for c in board_type.components}
    # A tenth more, because a picture has whole pixels all around.
    large = sorted((a for a in seen if px[a] * 1.1 < _LARGEST_PX), key=lambda a: -px[a])[:LARGE_CALLERS]
    address = f"{base}/components/{{}}/images/0".format
    return (
        [address(quote(a)) for a in seen],
        [f"{address(quote(a))}?px_per_mm={LARGE_PX_PER_MM}" for a in large],
    )


def _with_trivial(pictures: Sequence[str]) -> list[str]:
    """Return addresses of pictures with that of a trivial reply after every few of them."""
    groups = (pictures[n : n + _PICTURES_PER_TRIVIAL] for n in range(0, len(pictures), _PICTURES_PER_TRIVIAL))
    return [path for group in groups for path in (*group, TRIVIAL)]


def _while_idle(port: int, paths: Sequence[str], duration_s: float) -> ReplyTimes:
    """Let one caller fetch from addresses for some time; return the times, with the CPU time of each reply."""
    with callers(port, paths, 1) as fetched:
        meter = ThreadMeter(_SERVING)
        threading.Event().wait(duration_s)
    cpu_ms = round(meter.read() * 1e3 / len(fetched), 3) if fetched else math.nan
    return replace(reply_times([f.ms for f in fetched]), cpu_ms=cpu_ms)


def _with_callers(
    coordinator: StationCoordinator, before: RunDetail, port: int, paths: Sequence[str], count: int
) -> tuple[RunDetail, list[Fetched]]:
    """Let callers fetch pictures while the next board passes; return its run, and what came while it was filmed."""
    with callers(port, paths, count) as fetched:
        # Armed only now: the process of the callers may take longer to load than a board takes to pass.
        coordinator.arm(before.board_type, runs=1)
        found = _next_run(coordinator, before.id)
    utc_of_host_s = time.time() - time.monotonic()
    began_s = datetime.fromisoformat(found.started).timestamp() - utc_of_host_s
    ended_s = began_s + coordinator.timeline(found.id).last_frame_s
    return found, [f for f in fetched if began_s <= f.sent_s <= ended_s]


def reply_times(times_ms: Sequence[float]) -> ReplyTimes:
    """Return the percentiles of times; NaN if there is none."""
    if not times_ms:
        return ReplyTimes(0, math.nan, math.nan, math.nan)
    ordered = sorted(times_ms)
    # The nearest rank, a measured value and not one interpolated between two pictures.
    p99 = ordered[math.ceil(0.99 * (len(ordered) - 1))]
    return ReplyTimes(len(ordered), *(round(ms, 2) for ms in (statistics.median(ordered), p99, ordered[-1])))


def _next_run(coordinator: StationCoordinator, after: str | None) -> RunDetail:
    deadline = time.monotonic() + RUN_LIMIT_S
    while time.monotonic() < deadline:
        found = coordinator.latest() if after is None else coordinator.next_run(after, 1.0)
        if found is not None:
            return found
        coordinator.events(coordinator.snapshot().last_event, 1.0)
    raise StateError(f"No run ended within {RUN_LIMIT_S:.0f} s.", action="See the log.")


def _ready_ms(run: RunDetail) -> float:
    ready_ms = None if run.timings is None else run.timings.ready_after_last_frame_ms
    return math.inf if ready_ms is None else round(float(ready_ms), 1)


def _memory_mb(pids: dict[str, int]) -> dict[str, float]:
    return {name: round(private_memory_bytes(pid) / 1e6, 1) for name, pid in pids.items()}


def _rounded(batch: ReadBatch) -> tuple[float, float, float]:
    return round(batch.first_byte_ms, 1), round(batch.total_s, 3), round(batch.mbytes, 1)
