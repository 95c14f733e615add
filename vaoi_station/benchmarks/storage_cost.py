"""What it costs to keep a run on the disk: commits that survive a power failure, CPU time, and space."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path
from statistics import median
from typing import Any

from vaoi_station.store import Database, RunRow, Store
from vaoi_station.store.schema import packed, unpacked


@dataclass(frozen=True)
class StorageFigures:
    """Figures of one disk and one result."""

    runs: int
    run_ms: dict[str, float]
    """Wall time from a finished run to its result on the disk: median and maximum, ms."""
    run_cpu_ms: float
    """CPU time of this process per run."""
    commit_ms: dict[str, float]
    """Median wall time of a commit of one small row: `durable` (FULL) or not (NORMAL), ms."""
    result_kb: float
    """Size of the result as text, kB."""
    packed_kb: float
    """Size of the packed result, kB."""
    pack_cpu_ms: float
    unpack_cpu_ms: float
    database_kb_per_run: float
    """Growth of the database per run, kB, with indexes."""

    def document(self) -> dict[str, Any]:
        """Return the figures for JSON."""
        return asdict(self)


def measure_storage(directory: Path, result: str, detail: str, runs: int = 100) -> StorageFigures:
    """Write runs with a result and a detail document into a new database in a directory of the disk to measure."""
    database = Database(directory / "bench.db")
    try:
        return _measure(database, result, detail, runs)
    finally:
        database.close()


def _measure(database: Database, result: str, detail: str, runs: int) -> StorageFigures:
    store = Store(database)
    digest = store.keep_document("board-type", "{}", "")
    rows = [RunRow(f"r{n:06d}", "ready", n + 1, digest, digest, "{}", detail, "{}") for n in range(runs)]
    before_bytes, before_cpu_s = store.retention.used_bytes(), time.process_time()
    each_ms = [_wall_ms(partial(_save, store, row, result)) for row in rows]
    cpu_ms = (time.process_time() - before_cpu_s) * 1e3 / runs
    grown = (store.retention.used_bytes() - before_bytes) / runs
    commits = {
        name: median(_commit_ms(database, durable=durable) for _ in range(runs))
        for name, durable in (("durable", True), ("not durable", False))
    }
    text, content = packed(result)
    return StorageFigures(
        runs=runs,
        run_ms={"median": median(each_ms), "max": max(each_ms)},
        run_cpu_ms=cpu_ms,
        commit_ms=commits,
        result_kb=len(result.encode()) / 1e3,
        packed_kb=len(content or text) / 1e3,
        pack_cpu_ms=_cpu_ms(lambda: packed(result)),
        unpack_cpu_ms=_cpu_ms(lambda: unpacked(text, content)),
        database_kb_per_run=grown / 1e3,
    )


def _save(store: Store, row: RunRow, result: str) -> None:
    store.save_run(row, "{}", result).result()


def _commit_ms(database: Database, *, durable: bool) -> float:
    query = "INSERT OR REPLACE INTO standing VALUES ('bench', '{}')"
    return _wall_ms(lambda: database.write(lambda c: c.execute(query), durable=durable).result())


def _wall_ms(work: Callable[[], object]) -> float:
    begun_s = time.perf_counter()
    work()
    return (time.perf_counter() - begun_s) * 1e3


def _cpu_ms(work: Callable[[], object], repetitions: int = 20) -> float:
    begun_s = time.thread_time()
    for _ in range(repetitions):
        work()
    return (time.thread_time() - begun_s) * 1e3 / repetitions
