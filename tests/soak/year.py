"""Time the start of a station with the history of a year: `python -m tests.soak.year --data FOLDER`.

A station films one board. Its record is multiplied into a database of a year, with as many whole runs as [keep] allows
and results of a given size. Then the station is started on it, with the file outside and inside the kernel's cache.
"""

from __future__ import annotations

import argparse
import json
import os
import random
import sqlite3
import statistics
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Iterator
from contextlib import closing
from dataclasses import dataclass
from functools import partial
from pathlib import Path

from tests.soak.line_files import Pace, write_line_files
from tests.soak.service import ROOT, Service, ask, wait_until
from vaoi_station.config import KeepConfig, read_config
from vaoi_station.demo.station_files import to_toml
from vaoi_station.runs.states.run_ids import earliest_id
from vaoi_station.store.documents import EVENTS_KEPT
from vaoi_station.store.schema import packed, unpacked

BOARD_S = 20.0
YEAR_S = 365 * 86_400.0
DATABASE = "station.db"
BATCH = 10_000


@dataclass(frozen=True)
class Extent:
    """How much a generated history contains."""

    runs: int
    whole: int
    """Number of the newest runs with verdict ok that are whole."""
    doubtful: int
    """Number of whole runs with another verdict, spread evenly."""
    result_kb: float
    """Size of a packed result in the file."""
    events: int = EVENTS_KEPT


def make_history(database: Path, extent: Extent, now_s: float) -> None:
    """Multiply the latest run that is ok into the history that `extent` describes. Other runs are deleted."""
    with closing(sqlite3.connect(database, isolation_level=None)) as connection:
        connection.row_factory = sqlite3.Row
        # Nothing of a generated file has to survive a power cut.
        connection.execute("PRAGMA journal_mode = OFF")
        connection.execute("PRAGMA synchronous = OFF")
        model = dict(
            connection.execute(
                "SELECT * FROM runs WHERE json_extract(summary, '$.verdict') = 'ok' ORDER BY id DESC LIMIT 1"
            ).fetchone()
        )
        result = connection.execute("SELECT * FROM results WHERE run = ?", (model["id"],)).fetchone()
        for table in ("calibration_checks", "results", "whole_runs", "pins", "runs", "events"):
            connection.execute(f"DELETE FROM {table}")
        padded = packed(_padded(unpacked(result["document"], result["packed"]), extent.result_kb))
        detail = unpacked(model["detail"], model["packed_detail"])
        columns = ", ".join(model)
        insert = f"INSERT INTO runs ({columns}) VALUES ({', '.join('?' * len(model))})"
        rows = _rows(model, detail, extent, now_s)
        while batch := [row for row, _ in zip(rows, range(BATCH), strict=False)]:
            connection.execute("BEGIN")
            connection.executemany(insert, ([row[name] for name in model] for row in batch))
            whole = [row["id"] for row in batch if row["detail"]]
            connection.executemany("INSERT INTO results VALUES (?, ?, ?)", ((run, *padded) for run in whole))
            summaries = ((row["id"],) for row in batch if not row["detail"])
            connection.executemany("DELETE FROM whole_runs WHERE run = ?", summaries)
            connection.execute("COMMIT")
        event = json.dumps({"time": "2026-01-01T00:00:00.000Z", "kind": "run", "state": "ready", "message": "x" * 80})
        connection.execute("BEGIN")
        for number in range(1, extent.events + 1):
            document = event.replace("{", f'{{"number": {number}, ', 1)
            connection.execute("INSERT INTO events VALUES (?, ?)", (number, document))
        connection.execute("COMMIT")


def _rows(model: dict[str, object], detail: str, extent: Extent, now_s: float) -> Iterator[dict[str, object]]:
    """Yield the rows of all runs, oldest first."""
    each = max(extent.runs // max(extent.doubtful, 1), 1)
    empty = {"detail": "", "head": None, "timeline": None, "packed_detail": None, "packed_timeline": None}
    summary, old = str(model["summary"]), str(model["id"])
    for k in range(extent.runs):
        run = f"{earliest_id(now_s - (extent.runs - k) * BOARD_S)}-000000"
        doubtful = extent.doubtful > 0 and k % each == 0
        row = model | {"id": run, "finish_number": k + 1, "state": "gone", "summary": summary.replace(old, run)}
        if doubtful:
            row["summary"] = str(row["summary"]).replace('"verdict":"ok"', '"verdict":"degraded"')
        if doubtful or k >= extent.runs - extent.whole:
            own = (
                packed(detail.replace(old, run)) if k == extent.runs - 1 else (model["detail"], model["packed_detail"])
            )
            row["detail"], row["packed_detail"] = own
        else:
            row |= empty
        yield row


def _padded(document: str, size_kb: float) -> str:
    """Return a result with a field that compresses as little as digits do, so that its packed form has a size."""
    missing = int(size_kb * 1000) - len(packed(document)[1] or document)
    # Random hex digits are packed to half their number.
    return document if missing <= 0 else document[:-1] + f',"x_pad":"{random.Random(1).randbytes(missing).hex()}"}}'


def time_start(config: Path, log: Path) -> tuple[float, float]:
    """Start the station; return the time until it may be armed, and that of a request for its state then, s."""
    began_s = time.monotonic()
    service = Service(config, log)
    try:
        wait_until(service, ["idle"])
        ready_s = time.monotonic() - began_s
        with service.client() as client:
            asked_s = time.monotonic()
            assert ask(client, "/station") is not None
            reply_s = time.monotonic() - asked_s
        return ready_s, reply_s
    finally:
        service.stop()


def time_opening(database: Path) -> tuple[float, float]:
    """Open a history as a start does, in a process of its own; return the time and that of the processor, s."""
    done = subprocess.run(
        [sys.executable, "-c", _OPEN, str(database)], cwd=ROOT, capture_output=True, text=True, check=True
    )
    wall_s, cpu_s = map(float, done.stdout.split())
    return wall_s, cpu_s


_OPEN = """
import sys, time
from pathlib import Path
from vaoi_station.runs.archive.event_log import EventLog
from vaoi_station.runs.archive.finished_runs import Archive
from vaoi_station.store import Database, Store
wall_s, cpu_s = time.monotonic(), time.process_time()
store = Store(Database(Path(sys.argv[1])))
archive = Archive(store, EventLog(store))
store.newest_run(), archive.latest(), store.retention.pins(), store.retention.whole(), archive.list(50, None)
print(time.monotonic() - wall_s, time.process_time() - cpu_s)
archive.close()
store.close()
"""
"""What of a start depends on the history."""


def drop_from_cache(path: Path) -> None:
    """Let the kernel forget the content of a file, as after a boot."""
    handle = os.open(path, os.O_RDONLY)
    try:
        os.fsync(handle)
        os.posix_fadvise(handle, 0, 0, os.POSIX_FADV_DONTNEED)
    finally:
        os.close(handle)


def film_one(config: Path, log: Path) -> None:
    """Let the station film one board."""
    service = Service(config, log)
    try:
        wait_until(service, ["idle"])
        with service.client() as client:
            client.post("/station/arm", json={"board_type": "tiny", "runs": 1}).raise_for_status()
            while ask(client, "/runs/latest") is None:
                threading.Event().wait(0.2)
    finally:
        service.stop()


def main() -> int:
    """Make the history of a year, and time starts of a station with and without it."""
    keep = KeepConfig()
    parser = argparse.ArgumentParser(prog="python -m tests.soak.year", description=__doc__)
    parser.add_argument("--data", type=Path, required=True, help="folder on the disk to measure; must not exist")
    parser.add_argument("--runs", type=int, default=int(YEAR_S / BOARD_S))
    parser.add_argument("--whole", type=int, default=keep.results)
    parser.add_argument("--doubtful", type=int, default=keep.doubtful_results)
    parser.add_argument("--result-kb", type=float, default=10.0)
    parser.add_argument("--repeat", type=int, default=5)
    chosen = parser.parse_args()
    chosen.data.mkdir(parents=True)
    with tempfile.TemporaryDirectory(prefix="vaoi-year-") as name:
        folder = Path(name)
        path = write_line_files(folder, chosen.data, Pace(1.0))
        path.write_text(to_toml(read_config(path).model_copy(update={"keep": keep})), encoding="utf-8")
        log, database = folder / "log.txt", chosen.data / DATABASE
        film_one(path, log)
        one = [time_start(path, log) for _ in range(chosen.repeat)]
        began_s = time.monotonic()
        make_history(database, Extent(chosen.runs, chosen.whole, chosen.doubtful, chosen.result_kb), time.time())
        print(f"{chosen.runs} runs, {database.stat().st_size / 1e9:.2f} GB, made in {time.monotonic() - began_s:.0f} s")
        starts = {"one run": one}
        opened: dict[str, list[tuple[float, float]]] = {}
        for what, forget in (("a year, not in the cache", True), ("a year, in the cache", False)):
            starts[what], opened[what] = [], []
            for _ in range(chosen.repeat):
                for times, timed in (
                    (opened[what], partial(time_opening, database)),
                    (starts[what], partial(time_start, path, log)),
                ):
                    if forget:
                        drop_from_cache(database)
                    times.append(timed())
    for what, times in starts.items():
        print(f"| {what} | until ready {_figures(times, 0)} | reply to GET station {_figures(times, 1)} |")
    for what, times in opened.items():
        print(f"| {what} | opened in {_figures(times, 0)} | of the processor {_figures(times, 1)} |")
    return 0


def _figures(times: list[tuple[float, float]], column: int) -> str:
    """Return the median of a column, with its smallest and largest value."""
    values = [row[column] for row in times]
    return f"{statistics.median(values):.3f} ({min(values):.3f} … {max(values):.3f}) s"


if __name__ == "__main__":
    raise SystemExit(main())
