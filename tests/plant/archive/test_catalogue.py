"""Manifests are found without being read."""

from __future__ import annotations

import os
import threading
from pathlib import Path

from vaoi_station.plant.archive.catalogue import Place, places, runs
from vaoi_station.plant.archive.fault import ArchiveFault, ignore_fault
from vaoi_station.plant.archive.manifest import ArchivedRun
from vaoi_station.plant.archive.selection import RunSelection
from vaoi_station.plant.archive.storage import LocalStorage


def test_places_follow_from_names(tmp_path: Path) -> None:
    storage = LocalStorage(tmp_path)
    storage.write("runs/line 2%2Ftop/2026-03-01/r.json", b"")
    key = "runs/line 2%2Ftop/2026-03-01/r.json"
    assert list(places(storage)) == [Place(key, "line 2/top", "2026-03-01", "r")]


def test_folders_of_other_programs_are_reported_once_and_runs_are_read(tmp_path: Path) -> None:
    storage = LocalStorage(tmp_path)
    run = ArchivedRun(
        run="r", station="s", time="9999-12-31T23:00:00Z", board_type="t", pixels=8, documents={}, frames=()
    )
    storage.write(run.key, run.text().encode())
    for name in ("a.jpg", "b.jpg"):
        storage.write(f"runs/s/@eaDir/{name}", b"")
    faults: list[ArchiveFault] = []
    assert list(runs(storage, RunSelection(until="9999-12-31"), faults.append)) == [run]
    [fault] = faults
    assert "runs/s/@eaDir: is no day" in fault.what


def test_selected_runs_that_are_half_written_are_reported(tmp_path: Path) -> None:
    storage = LocalStorage(tmp_path)
    run = ArchivedRun(
        run="r", station="s", time="2026-03-01T08:00:00Z", board_type="t", pixels=8, documents={}, frames=()
    )
    storage.write(run.draft_key, run.text().encode())
    faults: list[ArchiveFault] = []
    assert not list(runs(storage, RunSelection(), faults.append))
    assert not faults, "its addition may be under way"
    os.utime(tmp_path / run.draft_key, (0, 0))
    assert not list(runs(storage, RunSelection(board_type="other"), faults.append))
    assert not faults, "it is of another board type"
    assert not list(runs(storage, RunSelection(), faults.append))
    assert "run s/r is half written: its addition began at 1970-01-01" in faults[0].what


def test_manifests_are_read_many_at_a_time_and_yielded_in_order(tmp_path: Path) -> None:
    class Slow(LocalStorage):
        """A storage whose reads end only when two have been in progress at once."""

        lock, inside, together = threading.Lock(), 0, threading.Event()

        def read(self, key: str) -> bytes:
            with self.lock:
                self.inside += 1
                if self.inside > 1:
                    self.together.set()
            assert self.together.wait(timeout=60)
            with self.lock:
                self.inside -= 1
            return super().read(key)

    storage = Slow(tmp_path)
    for n in range(200):
        run = ArchivedRun(
            run=f"r{n:03d}", station="s", time="2026-03-01T08:00:00Z", board_type="t", pixels=8, documents={}, frames=()
        )
        storage.write(run.key, run.text().encode())
    assert [run.run for run in runs(storage, RunSelection(), ignore_fault)] == [f"r{n:03d}" for n in range(200)]
