"""`GET /metrics`: figures for Prometheus, in its text format (docs/internals/metrics.md lists them)."""

from __future__ import annotations

import itertools
import os
import time
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import NamedTuple

from fastapi import APIRouter, Response

from vaoi_station.api.http_caching import LIVE
from vaoi_station.api.parameters import rest_router
from vaoi_station.api.routes.services import Services
from vaoi_station.push.publisher import Publisher
from vaoi_station.runs.archive.finished_runs import LATENCY_BOUNDS_S, RunFigures
from vaoi_station.runs.archive.storage_watch import StorageFigures
from vaoi_station.runs.states.schemas import ArchiveStatus, StationSnapshot
from vaoi_station.runs.states.tables import StationState
from vaoi_station.store.storage_trouble import CODES

MEDIA_TYPE = "text/plain; version=0.0.4; charset=utf-8"
_PAGE_BYTES = os.sysconf("SC_PAGE_SIZE")
Labels = Mapping[str, str]


class Metric(NamedTuple):
    """A metric: its name, type and description, and its samples, each with a suffix of the name, labels and a value."""

    name: str
    kind: str
    help: str
    samples: tuple[tuple[str, Labels, float], ...]


def router(services: Services) -> APIRouter:
    """Create the route for metrics."""
    routes = rest_router(base="")
    coordinator, ask = services.coordinator, services.commands.ask

    # Not part of the REST document: the format is that of Prometheus, and generated clients cannot use it.
    @routes.get("/metrics", include_in_schema=False)
    async def get_metrics() -> Response:
        snapshot = await ask(coordinator.snapshot)
        text = await ask(
            lambda: as_text(
                (
                    *metrics_of(snapshot, coordinator.run_figures(), services.publisher),
                    *_storage(coordinator.storage.figures()),
                )
            )
        )
        return Response(text, media_type=MEDIA_TYPE, headers={"Cache-Control": LIVE})

    return routes


def metrics_of(
    snapshot: StationSnapshot, figures: RunFigures, publisher: Publisher | None = None
) -> tuple[Metric, ...]:
    """Return all metrics of the station."""
    free = sum(bay.use == "free" for bay in snapshot.ring.bays)
    return (
        _metric("vaoi_info", "gauge", "Always 1; the labels name station and version.",
                ({"station": snapshot.name, "version": snapshot.versions.station}, 1)),
        _metric("vaoi_state", "gauge", "1 for the present state of the station, 0 for all others.",
                *(({"state": str(state)}, state is snapshot.state) for state in StationState)),
        _metric("vaoi_reasons", "gauge", "Number of reasons for the present state.", ({}, len(snapshot.reasons))),
        _metric("vaoi_warnings", "gauge", "Number of conditions that need attention.", ({}, len(snapshot.warnings))),
        _metric("vaoi_runs_total", "counter", "Runs that ended since the start, by verdict.",
                *(({"verdict": v}, figures.verdicts.get(v, 0)) for v in ("ok", "degraded", "failed", "none"))),
        _metric("vaoi_frames_total", "counter", "Frames of ended runs since the start, by verdict.",
                *(({"verdict": v}, n) for v, n in figures.frames.items())),
        _latency(figures),
        _metric("vaoi_boards_missed_total", "counter", "Boards that passed without a run.",
                ({}, snapshot.boards_missed)),
        _metric("vaoi_line_ready", "gauge", "1 if the next board may come, 0 if it must wait.",
                ({}, snapshot.line_ready)),
        _metric("vaoi_line_blocked_total", "counter", "Times without memory for the next board, since the start.",
                ({}, snapshot.times_blocked)),
        _metric("vaoi_ring_bays", "gauge", "Runs for which the ring has memory.", ({}, len(snapshot.ring.bays))),
        _metric("vaoi_ring_bays_free", "gauge", "Runs for which the ring has memory that is free.", ({}, free)),
        _metric("vaoi_ring_bytes", "gauge", "Size of the ring in shared memory.", ({}, snapshot.ring.size_bytes)),
        _metric("vaoi_leases", "gauge", "Holds of callers on frames.", ({}, len(snapshot.ring.leases))),
        *_cameras(snapshot),
        *_processes(snapshot),
        *_publishing(publisher),
        *_archive(snapshot.retention.archive),
    )  # fmt: skip


def _storage(figures: StorageFigures) -> Iterable[Metric]:
    """Yield the metrics of the data disk; what is not known has no value."""
    sizes = (
        ("vaoi_data_free_bytes", "Free space of the data disk.", figures.free_bytes),
        ("vaoi_database_bytes", "Size of the database without its free pages.", figures.database_bytes),
    )
    for name, text, size in sizes:
        yield _metric(name, "gauge", text, *(() if size is None else (({}, float(size)),)))
    yield _metric("vaoi_runs_unstored", "gauge", "Finished runs that are in memory only.", ({}, figures.unstored))
    yield _metric("vaoi_storage_trouble", "gauge", "1 for the present trouble of the storage, 0 for all others.",
                  *(({"code": code}, code == figures.trouble) for code in sorted(CODES)))  # fmt: skip


def _archive(status: ArchiveStatus | None) -> Iterable[Metric]:
    """Yield the metrics of the archive; without one they have no values."""
    there = () if status is None else (status,)
    outcomes = [(name, getattr(one, name)) for one in there for name in ("added", "dropped", "refused")]
    yield _metric(
        "vaoi_archive_up",
        "gauge",
        "1 if the archive takes runs, 0 if runs wait for it.",
        *(({}, not one.problem) for one in there),
    )
    yield _metric(
        "vaoi_archive_waiting", "gauge", "Runs that wait for the archive.", *(({}, one.waiting) for one in there)
    )
    yield _metric("vaoi_archive_runs_total", "counter", "Runs for the archive since the start, by outcome.",
                  *(({"outcome": name}, count) for name, count in outcomes))  # fmt: skip


def _latency(figures: RunFigures) -> Metric:
    bounds = [*(f"{bound:g}" for bound in LATENCY_BOUNDS_S), "+Inf"]
    counts = itertools.accumulate(figures.latencies)  # a class of Prometheus also counts all smaller values
    buckets: tuple[tuple[str, Labels, float], ...] = tuple(
        ("_bucket", {"le": bound}, float(count)) for bound, count in zip(bounds, counts, strict=True)
    )
    ends: tuple[tuple[str, Labels, float], ...] = (
        ("_sum", {}, figures.latency_sum_s),
        ("_count", {}, float(sum(figures.latencies))),
    )
    return Metric(
        "vaoi_result_latency_seconds", "histogram", "Time from the last frame to the result.", (*buckets, *ends)
    )


def _cameras(snapshot: StationSnapshot) -> Iterable[Metric]:
    cameras = [({"camera": camera.name}, camera) for camera in snapshot.cameras]
    yield _metric("vaoi_camera_connected", "gauge", "Whether the camera is connected.",
                  *((label, c.connected) for label, c in cameras))  # fmt: skip
    yield _metric("vaoi_camera_frames_total", "counter", "Frames that the camera delivered.",
                  *((label, c.delivered) for label, c in cameras))  # fmt: skip
    yield _metric("vaoi_camera_incomplete_frames_total", "counter", "Frames that arrived with gaps.",
                  *((label, c.incomplete) for label, c in cameras))  # fmt: skip
    yield _metric("vaoi_camera_temperature_celsius", "gauge", "Temperature that the camera reports.",
                  *((label, c.temperature_c) for label, c in cameras if c.temperature_c is not None))  # fmt: skip


def _processes(snapshot: StationSnapshot) -> Iterable[Metric]:
    children = [({"process": p.name}, p) for p in snapshot.processes]
    yield _metric("vaoi_process_up", "gauge", "Whether the process runs.", *((label, p.alive) for label, p in children))
    yield _metric("vaoi_process_restarts_total", "counter", "Restarts of the process since the start.",
                  *((label, p.restarts) for label, p in children))  # fmt: skip
    pids = {"station": os.getpid(), **{p.name: p.pid for p in snapshot.processes if p.pid is not None}}
    used = {name: usage for name, pid in pids.items() if (usage := _usage(pid)) is not None}
    for index, (name, kind, text) in enumerate(_USAGE):
        yield _metric(name, kind, text, *(({"process": process}, usage[index]) for process, usage in used.items()))


def _publishing(publisher: Publisher | None) -> Iterable[Metric]:
    def metric(name: str, kind: str, text: str, value: Callable[[Publisher], float]) -> Metric:
        samples = () if publisher is None else (({"receiver": publisher.name}, value(publisher)),)
        return _metric(f"vaoi_push_{name}", kind, text, *samples)

    yield metric("up", "gauge", "1 if the broker accepts messages, 0 if it fails.", lambda p: not p.is_failing)
    yield metric("waiting", "gauge", "Events that have not had their turn at the broker.", lambda p: p.waiting)
    yield metric("delivered_total", "counter", "Messages that the broker has accepted.", lambda p: p.state.delivered)
    yield metric("failures_total", "counter", "Attempts to publish that failed.", lambda p: p.state.failures)
    yield metric(
        "skipped_total", "counter", "Events that were not sent because too many waited.", lambda p: p.state.skipped
    )


_USAGE = (
    ("vaoi_process_resident_bytes", "gauge", "Resident memory of the process, shared memory included."),
    ("vaoi_process_shared_bytes", "gauge", "Shared part of the resident memory: the ring and mapped files."),
    ("vaoi_process_cpu_seconds_total", "counter", "Processor time of the process."),
    ("vaoi_process_open_fds", "gauge", "Open file descriptors of the process."),
    ("vaoi_process_threads", "gauge", "Threads of the process."),
    ("vaoi_process_age_seconds", "gauge", "Time since the start of the process."),
)
"""Name, type and description of each metric that `_usage` returns, in the same order."""


def _usage(pid: int) -> tuple[float, ...] | None:
    """Read the resources that a process uses, for the metrics; None if the process has ended."""
    folder, ticks = Path("/proc") / str(pid), os.sysconf("SC_CLK_TCK")
    try:
        _, resident, shared = (int(n) * _PAGE_BYTES for n in (folder / "statm").read_text().split()[:3])
        # Field 2 is the name, which may contain spaces and brackets; the rest begins with field 3 (proc(5)).
        stat = (folder / "stat").read_text().rpartition(")")[2].split()
        descriptors = len(os.listdir(folder / "fd"))  # noqa: PTH208  (names only; a Path for each is slower)
    except (OSError, ValueError):
        return None
    cpu_s, threads, started_s = (int(stat[11]) + int(stat[12])) / ticks, int(stat[17]), int(stat[19]) / ticks
    return (resident, shared, cpu_s, descriptors, threads, time.clock_gettime(time.CLOCK_BOOTTIME) - started_s)


def _metric(name: str, kind: str, text: str, *samples: tuple[Labels, float]) -> Metric:
    return Metric(name, kind, text, tuple(("", labels, value) for labels, value in samples))


def as_text(metrics: Iterable[Metric]) -> str:
    """Format metrics in the text format of Prometheus, version 0.0.4."""
    lines = []
    for metric in metrics:
        lines += [f"# HELP {metric.name} {metric.help}", f"# TYPE {metric.name} {metric.kind}"]
        for suffix, labels, value in metric.samples:
            inside = ",".join(f'{key}="{_escaped(text)}"' for key, text in labels.items())
            lines.append(f"{metric.name}{suffix}{f'{{{inside}}}' if inside else ''} {float(value):.17g}")
    return "\n".join(lines) + "\n"


def _escaped(text: str) -> str:
    return text.replace("\\", "\\\\").replace('"', '\\"').replace("\n", "\\n")
