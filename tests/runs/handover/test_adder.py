"""The adder waits for its turns, and says whether run or archive are at fault."""

from __future__ import annotations

import threading
from multiprocessing import Pipe
from pathlib import Path

from vaoi_station.plant.archive import Archive
from vaoi_station.runs.handover.adder import Addition, Failed, Turn, serve

ROOT = Path(__file__).parents[3]


def outcome(wanted: Addition) -> tuple[object, int]:
    """Return how an addition ended, and the number of turns that it took."""
    ours, its = Pipe()
    thread = threading.Thread(target=serve, args=(its,))
    thread.start()
    ours.send(wanted)
    turns = 0
    while isinstance(reply := ours.recv(), Turn):
        ours.send(True)
        turns += 1
    ours.close()
    thread.join()
    return reply, turns


def test_an_absent_archive_is_not_the_fault_of_the_run(tmp_path: Path) -> None:
    failed, turns = outcome(Addition(str(tmp_path / "archive"), tmp_path, "one"))
    assert isinstance(failed, Failed)
    assert (failed.of_run, turns) == (False, 0)
    assert "is no archive" in failed.error.message


def test_a_damaged_recording_is_the_fault_of_the_run(tmp_path: Path) -> None:
    Archive.create(tmp_path / "archive")
    failed, _ = outcome(Addition(str(tmp_path / "archive"), tmp_path, "one"))
    assert isinstance(failed, Failed)
    assert failed.of_run
    assert "recording.json" in failed.error.message
