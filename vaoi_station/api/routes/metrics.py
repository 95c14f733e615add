"""`GET /metrics`: figures for Prometheus, text format 0.0.4 (docs/reference/metrics.md is made of it)."""

from __future__ import annotations

import itertools
import os
import time
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path

from fastapi import APIRouter, Response

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
Sample = tuple[Mapping[str, str], float | None]
"""Labels and value; a value that is not known is left out."""


def router(services: Services) -> APIRouter:
    """Create the route for metrics."""
    routes = rest_router(base="")
    coordinator, ask = services.coordinator, services.commands.ask

    def text() -> str:
        now, figures, storage = coordinator.snapshot(), coordinator.run_figures(), coordinator.storage.figures()
        return "\n".join(metrics(now, figures, services.publishers, storage)) + "\n"

    # Not part of the REST document: the format is that of Prometheus, and generated clients cannot use it.
    @routes.get("/metrics", include_in_schema=False)
    async def get_metrics() -> Response:
        return Response(await ask(text), media_type=MEDIA_TYPE)

    return routes


def metrics(
    now: StationSnapshot, figures: RunFigures, publishers: Iterable[Publisher], storage: StorageFigures
) -> Iterator[str]:
    """Yield the lines of all metrics."""
    yield from _station(now, figures)
    yield from _cameras(now)
    yield from _processes(now)
    yield from _publishing(publishers)
    yield from _archive(now.retention.archive)
    yield from _storage(storage)


def metric(name: str, text: str, *samples: Sample, kind: str = "") -> Iterator[str]:
    """Yield the lines of a metric. Names of counters end with `_total`."""
    full = f"vaoi_{name}"
    yield f"# HELP {full} {text}"
    yield f"# TYPE {full} {kind or ('counter' if name.endswith('_total') else 'gauge')}"
    for labels, value in samples:
        if value is not None:
            yield sample(full, labels, value)


def sample(name: str, labels: Mapping[str, str], value: float) -> str:
    """Return the line of one sample."""
    escaped = {key: text.replace("\\", "\\\\").replace('"', '\\"').replace("\n", "\\n") for key, text in labels.items()}
    inside = ",".join(f'{key}="{text}"' for key, text in escaped.items())
    return f"{name}{f'{{{inside}}}' if inside else ''} {float(value):.17g}"


def _by(label: str, values: Iterable[tuple[str, float | None]]) -> list[Sample]:
    return [({label: name}, value) for name, value in values]


def _station(now: StationSnapshot, figures: RunFigures) -> Iterator[str]:
    ring, verdicts = now.ring, ("ok", "degraded", "failed", "none")
    free = sum(bay.use == "free" for bay in ring.bays)
    info = {"station": now.name, "version": now.versions.station}
    yield from metric("info", "Always 1; the labels name station and version.", (info, 1))
    states = ((str(state), state is now.state) for state in StationState)
    yield from metric("state", "1 for the present state of the station, 0 for all others.", *_by("state", states))
    yield from metric("reasons", "Number of reasons for the present state.", ({}, len(now.reasons)))
    yield from metric("warnings", "Number of conditions that need attention.", ({}, len(now.warnings)))
    runs = _by("verdict", ((verdict, figures.verdicts.get(verdict, 0)) for verdict in verdicts))
    yield from metric("runs_total", "Runs that ended, by verdict.", *runs)
    frames = _by("verdict", figures.frames.items())
    yield from metric("frames_total", "Frames of ended runs, by verdict.", *frames)
    yield from _latency(figures)
    yield from metric("boards_missed_total", "Boards that passed without a run.", ({}, now.boards_missed))
    yield from metric("line_ready", "1 if the next board may come, 0 if it must wait.", ({}, now.line_ready))
    blocked = "Times without memory for the next board."
    yield from metric("line_blocked_total", blocked, ({}, now.times_blocked))
    yield from metric("ring_bays", "Runs for which the ring has memory.", ({}, len(ring.bays)))
    yield from metric("ring_bays_free", "Runs for which the ring has memory that is free.", ({}, free))
    yield from metric("ring_bytes", "Size of the ring in shared memory.", ({}, ring.size_bytes))
    yield from metric("leases", "Holds of callers on frames.", ({}, len(ring.leases)))


def _latency(figures: RunFigures) -> Iterator[str]:
    name = "result_latency_seconds"
    yield from metric(name, "Time from the last frame to the result.", kind="histogram")
    bounds = [*(f"{bound:g}" for bound in LATENCY_BOUNDS_S), "+Inf"]
    counts = itertools.accumulate(figures.latencies)  # a class of Prometheus also counts all smaller values
    for bound, count in zip(bounds, counts, strict=True):
        yield sample(f"vaoi_{name}_bucket", {"le": bound}, count)
    yield sample(f"vaoi_{name}_sum", {}, figures.latency_sum_s)
    yield sample(f"vaoi_{name}_count", {}, sum(figures.latencies))


def _cameras(now: StationSnapshot) -> Iterator[str]:
    for name, text, key in (
        ("connected", "Whether the camera is connected.", "connected"),
        ("frames_total", "Frames that the camera delivered.", "delivered"),
        ("incomplete_frames_total", "Frames that arrived with gaps.", "incomplete"),
        ("temperature_celsius", "Temperature that the camera reports.", "temperature_c"),
    ):
        yield from metric(f"camera_{name}", text, *_by("camera", ((c.name, getattr(c, key)) for c in now.cameras)))


def _processes(now: StationSnapshot) -> Iterator[str]:
    alive, restarts = ([(p.name, getattr(p, key)) for p in now.processes] for key in ("alive", "restarts"))
    yield from metric("process_up", "Whether the process runs.", *_by("process", alive))
    yield from metric("process_restarts_total", "Restarts of the process.", *_by("process", restarts))
    pids = {"station": os.getpid(), **{p.name: p.pid for p in now.processes if p.pid is not None}}
    used = [(name, usage) for name, pid in pids.items() if (usage := _usage(pid)) is not None]
    for index, (name, text) in enumerate(_USAGE):
        yield from metric(
            f"process_{name}", text, *_by("process", ((process, usage[index]) for process, usage in used))
        )


def _publishing(publishers: Iterable[Publisher]) -> Iterator[str]:
    values = {
        one.name: (not one.is_failing, one.waiting, one.state.delivered, one.state.failures, one.state.skipped)
        for one in publishers
    }
    texts = {
        "up": "1 if the broker accepts messages, 0 if it fails.",
        "waiting": "Events that have not had their turn at the broker.",
        "delivered_total": "Events that the broker has accepted, also before the start.",
        "failures_total": "Attempts to publish that failed, also before the start.",
        "skipped_total": "Events that were not sent because too many waited, also before the start.",
    }
    for index, (name, text) in enumerate(texts.items()):
        yield from metric(f"push_{name}", text, *_by("receiver", ((who, each[index]) for who, each in values.items())))


def _archive(status: ArchiveStatus | None) -> Iterator[str]:
    there = () if status is None else (status,)
    up = "1 if the archive takes runs, 0 if runs wait for it; no value without an archive."
    yield from metric("archive_up", up, *(({}, not one.problem) for one in there))
    yield from metric("archive_waiting", "Runs that wait for the archive.", *(({}, one.waiting) for one in there))
    outcomes = [(name, getattr(one, name)) for one in there for name in ("added", "dropped", "refused")]
    total = "Runs for the archive, by outcome: added, dropped, refused."
    yield from metric("archive_runs_total", total, *_by("outcome", outcomes))


def _storage(figures: StorageFigures) -> Iterator[str]:
    yield from metric("data_free_bytes", "Free space of the data disk.", ({}, figures.free_bytes))
    yield from metric(
        "database_bytes",
        "Size of the database without its free pages; no value while it cannot be read.",
        ({}, figures.database_bytes),
    )
    yield from metric("runs_unstored", "Finished runs that are in memory only.", ({}, figures.unstored))
    troubles = _by("code", ((code, code == figures.trouble) for code in sorted(CODES)))
    yield from metric("storage_trouble", "1 for the present trouble of the storage, 0 for all others.", *troubles)


_USAGE = (
    ("resident_bytes", "Resident memory of the process, shared memory included."),
    ("shared_bytes", "Shared part of the resident memory: the ring and mapped files."),
    ("cpu_seconds_total", "Processor time of the process."),
    ("open_fds", "Open file descriptors of the process."),
    ("threads", "Threads of the process."),
    ("age_seconds", "Time since the start of the process."),
)
"""Name and description of each metric that `_usage` returns, in the same order."""


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
