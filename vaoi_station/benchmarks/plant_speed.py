"""Speed of stitching archived runs on a local cluster: workers, overhead of Dask, killed workers, memory."""

from __future__ import annotations

import os
import signal
import tempfile
import time
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from vaoi_station.errors import InternalError
from vaoi_station.plant.archive import Archive, RunLabel
from vaoi_station.plant.restitch import ClusterOptions, Terms
from vaoi_station.plant.restitch.task import RunTask, read_outcome, restitch_run
from vaoi_station.plant.tables import write_tables
from vaoi_station.plant.workers.cluster import cluster_address
from vaoi_station.plant.workers.dispatch import Dispatch
from vaoi_station.plant.workers.software import software
from vaoi_station.stitching.recordings.offline import stitch_frames
from vaoi_station.stitching.recordings.opening import open_run

KILL_EVERY = 10
"""Number of runs after which a worker is killed in the kill test."""
_PATIENCE_S = 300.0
_TURN = 26
"""Number of runs in one turn of the ways that are compared.

It is even: of 25 runs one worker of two has one more than the other, which takes 4 % of the time. The speed of a
virtual machine changes by a third within minutes, so that turns are short."""


@dataclass(frozen=True)
class PlantFigures:
    """What was measured. Ratios are of measurements of one call; absolute times depend on the machine."""

    runs: int
    direct_s: float
    """Wall time of all runs in this process, without Dask."""
    one_worker_s: float
    two_workers_s: float
    task_cpu_s: tuple[float, float]
    """CPU time of one run, median: in the one worker, and in two that share caches and memory of the machine."""
    command_share: tuple[float, float]
    """Share of one processor that the command with its scheduler takes, beside one worker and beside two."""
    archive_kb: float
    """Size of one run in the archive."""
    ratio: float
    """Compression of its frames, of their pixels."""
    outcome_kb: float
    """Size of the file of one stitched run."""
    tables_kb: float
    """Size of its rows in the Parquet tables."""
    rss_mb: tuple[float, float]
    """Memory of a worker that has twice this number of runs: median of the second and of the last tenth of them."""
    kills: int
    lost: int
    """Number of runs without an outcome when workers were killed."""
    twice: int
    """Number of runs with two outcomes."""

    def document(self) -> dict[str, Any]:
        """Return the figures with their ratios, as JSON values."""
        return {
            **{name: list(v) if isinstance(v, tuple) else v for name, v in vars(self).items()},
            "two_against_one": round(self.one_worker_s / self.two_workers_s, 3),
            "overhead": round(self.one_worker_s / self.direct_s - 1, 4),
        }

    def lines(self) -> Iterator[str]:
        """Yield a table in Markdown: each figure with its goal."""
        early, late = self.rss_mb
        yield "| figure | measured | goal |"
        yield "|---|---|---|"
        yield f"| {self.runs} runs in one process, without Dask | {self.direct_s:.1f} s | |"
        overhead = 100 * (self.one_worker_s / self.direct_s - 1)
        yield f"| by one worker | {self.one_worker_s:.1f} s: {overhead:+.1f} % | at most +5 % |"
        ratio = self.one_worker_s / self.two_workers_s
        yield f"| by two workers | {self.two_workers_s:.1f} s: {ratio:.2f} times as fast | at least 1.8 times |"
        kills = f"{self.kills} workers killed, one after every {KILL_EVERY} runs: runs lost, twice"
        yield f"| {kills} | {self.lost}, {self.twice} | 0, 0 |"
        memory = f"{early:.0f}, {late:.0f} MB: {100 * (late / early - 1):+.1f} %"
        yield f"| memory of a worker over {2 * self.runs} runs: second tenth, last tenth | {memory} | flat |"
        alone_s, both_s = self.task_cpu_s
        yield f"| CPU per run: in one worker, in one of two | {alone_s:.2f}, {both_s:.2f} s | |"
        alone, both = (f"{100 * share:.0f}" for share in self.command_share)
        yield f"| share of a processor of the command and its scheduler: beside one worker, two | {alone}, {both} % | |"
        sizes = (
            f"{self.archive_kb / 1e3:.1f} MB ({self.ratio:.2f} : 1), {self.outcome_kb:.0f} kB, {self.tables_kb:.0f} kB"
        )
        yield f"| one run in the archive, its file, its tables | {sizes} | |"


@dataclass
class _Outcomes:
    """Collects what workers return."""

    directory: Path
    processes: list[int] = field(default_factory=list)
    rss_mb: dict[int, list[float]] = field(default_factory=dict)
    cpu_s: list[float] = field(default_factory=list)
    keys: Counter[str] = field(default_factory=Counter)
    size: int = 0

    def keep(self, task: RunTask, content: bytes) -> None:
        path = self.directory / "outcome.json.gz"
        path.write_bytes(content)
        cost = read_outcome(path)["cost"]
        self.keys[task.key] += 1
        self.processes.append(cost["process"])
        self.rss_mb.setdefault(cost["process"], []).append(cost["rss_mb"])
        self.cpu_s.append(cost["cpu_s"])
        self.size = len(content)


def measure_plant(case: Path, runs: int, report: Callable[[str], None]) -> PlantFigures:
    """Measure on copies of a recording under different ids."""
    with tempfile.TemporaryDirectory(prefix="vaoi-plant-") as scratch:
        folder = Path(scratch)
        archive, tasks = _archive(case, folder, runs)
        (direct_s, one_s, two_s), own_s, one, two = _in_turns(folder, tasks, report)
        report(f"two workers, one is killed after every {KILL_EVERY} runs")
        kills, killed = _killed(folder, tasks)
        write_tables(folder / "tables", [read_outcome(folder / "outcome.json.gz")["tables"]])
        stored = archive.run("r0")
        return PlantFigures(
            runs=runs,
            direct_s=round(direct_s, 3),
            one_worker_s=round(one_s, 3),
            two_workers_s=round(two_s, 3),
            task_cpu_s=(round(float(np.median(one.cpu_s[:runs])), 4), round(float(np.median(two.cpu_s)), 4)),
            command_share=(round(own_s[0] / one_s, 4), round(own_s[1] / two_s, 4)),
            archive_kb=round(stored.bytes / 1e3, 1),
            ratio=round(_frame_bytes(case) / sum(frame.bytes for frame in stored.frames), 3),
            outcome_kb=round(one.size / 1e3, 1),
            tables_kb=round(sum(p.stat().st_size for p in (folder / "tables").rglob("*.parquet")) / 1e3, 1),
            rss_mb=_tenths(max(one.rss_mb.values(), key=len)),
            kills=kills,
            lost=runs - len(killed.keys),
            twice=sum(count > 1 for count in killed.keys.values()),
        )


def _archive(case: Path, folder: Path, runs: int) -> tuple[Archive, list[RunTask]]:
    """Archive a recording under several ids, with its result."""
    from vaoi_station.files import write_stitch

    opened = open_run(case)
    write_stitch(folder / "result.json", stitch_frames(opened.setup, opened.recording.head, opened.recording.frame))
    archive = Archive.create(folder / "archive")
    terms = Terms(software())
    tasks = []
    for n in range(runs):
        label = RunLabel(run=f"r{n}", time="2026-01-01T00:00:00Z")
        run = archive.add(case, result=folder / "result.json", station="bench", label=label)
        tasks.append(RunTask(archive.url, run.key, run.digest, terms))
    return archive, tasks


def _in_turns(
    folder: Path, tasks: list[RunTask], report: Callable[[str], None]
) -> tuple[list[float], list[float], _Outcomes, _Outcomes]:
    """Return wall times of all runs in this process, by one worker and by two, and with these this process's CPU times.

    After them come the outcomes of the one worker and of the two.

    The three take turns: the speed of a virtual machine changes by a third within minutes.
    """
    restitch_run(tasks[0])  # imports and compiles
    times_s, own_s, one, two = np.zeros(3), np.zeros(2), _Outcomes(folder), _Outcomes(folder)
    with (
        cluster_address(ClusterOptions(workers=1)) as alone,
        cluster_address(ClusterOptions(workers=2)) as both,
    ):

        def work(address: str, outcomes: _Outcomes, of: list[RunTask]) -> tuple[float, float]:
            began_s, own_began_s = time.perf_counter(), time.process_time()
            _dispatch(outcomes).work(address, of, [of[0].archive], _PATIENCE_S)
            return time.perf_counter() - began_s, time.process_time() - own_began_s

        for address, workers in ((alone, 1), (both, 2)):  # imports, and the machine code of each process
            work(address, _Outcomes(folder), tasks[: 4 * workers])
        for n, first in enumerate(range(0, len(tasks), _TURN), 1):
            turn = tasks[first : first + _TURN]
            report(f"turn {n}: {len(turn)} runs in this process, by one worker, by two")
            began_s = time.perf_counter()
            for task in turn:
                restitch_run(task)
            direct_s = time.perf_counter() - began_s
            (one_s, own_one_s), (two_s, own_two_s) = work(alone, one, turn), work(both, two, turn)
            times_s += direct_s, one_s, two_s
            own_s += own_one_s, own_two_s
        report("one worker once more, for its memory")
        work(alone, one, tasks)
    return times_s.tolist(), own_s.tolist(), one, two


def _frame_bytes(case: Path) -> int:
    """Return the size of all pixels of a recording."""
    recording = open_run(case).recording
    frames = (recording.frame(i, j) for i in range(len(recording.head.cameras)) for j in range(recording.head.rows))
    return sum(frame.nbytes for frame in frames if frame is not None)


def _killed(folder: Path, tasks: list[RunTask]) -> tuple[int, _Outcomes]:
    """Kill the worker of every tenth outcome while it works on its next run."""
    outcomes, kills = _Outcomes(folder), 0

    def kill() -> None:
        nonlocal kills
        if len(outcomes.processes) % KILL_EVERY == 0:
            # Its last outcome may be received after its end.
            with suppress(ProcessLookupError):
                os.kill(outcomes.processes[-1], signal.SIGKILL)
                kills += 1

    with cluster_address(ClusterOptions(workers=2)) as address:
        _dispatch(outcomes, kill).work(address, tasks, [tasks[0].archive], _PATIENCE_S)
    return kills, outcomes


def _dispatch(outcomes: _Outcomes, then: Callable[[], None] = lambda: None) -> Dispatch[RunTask]:
    def keep(task: RunTask, content: bytes) -> None:
        outcomes.keep(task, content)
        then()

    def fail(_: RunTask, text: str) -> None:
        raise InternalError(f"vaoi bench --plant: {text}")

    return Dispatch(software(), restitch_run, keep, fail, lambda _: None)


def _tenths(values: list[float]) -> tuple[float, float]:
    """Return the medians of the second and of the last tenth."""
    tenth = max(1, len(values) // 10)
    return float(np.median(values[tenth : 2 * tenth] or values)), float(np.median(values[-tenth:]))
