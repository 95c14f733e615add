"""The audit log: order, size, faults of the disk."""

from __future__ import annotations

import threading
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from tests.soak.small_disk import SmallDisk
from vaoi_station.api import audit as module
from vaoi_station.api.audit import FILES_KEPT, AuditLog
from vaoi_station.supervised_thread import ThreadFault

PATIENCE_S = 30.0


def fault_of(audit: AuditLog) -> ThreadFault | None:
    """Wait until the thread of a log has a fault."""
    until_s = time.monotonic() + PATIENCE_S
    while (fault := audit.thread.fault()) is None and time.monotonic() < until_s:
        audit.thread.join(0.01)
    return fault


def written(audit: AuditLog, count: int) -> list[dict[str, Any]]:
    """Wait until a number of entries are in the file; return them, newest first."""
    until_s = time.monotonic() + PATIENCE_S
    while len(found := audit.newest(500)) < count and time.monotonic() < until_s:
        audit.thread.join(0.05)
    return found


def test_entries_are_read_newest_first_and_survive_a_damaged_line(tmp_path: Path) -> None:
    audit = AuditLog(tmp_path / "audit.jsonl")
    audit.add(path="/a")
    audit.add(path="/b")
    assert [e["path"] for e in audit.newest(5)] == ["/b", "/a"]
    with audit.path.open("a") as file:
        file.write('{"path": "/c"')
    assert [e["path"] for e in audit.newest(2)] == ["/b"]
    audit.close()


def test_the_log_takes_limited_space(tmp_path: Path) -> None:
    audit = AuditLog(tmp_path / "audit.jsonl", most_bytes=1000)
    for n in range(200):
        audit.add(path="/x" * 20, number=n)
    assert audit.newest(3)[0]["number"] == 199
    audit.close()
    files = list(tmp_path.iterdir())
    assert len(files) == FILES_KEPT + 1
    assert sum(f.stat().st_size for f in files) < 1200 * len(files)


def test_a_disk_that_refuses_does_not_end_the_log(tmp_path: Path) -> None:
    path = tmp_path / "audit.jsonl"
    path.mkdir()
    audit = AuditLog(path)
    audit.add(path="/a")
    assert audit.newest(1) == []
    path.rmdir()
    audit.add(path="/b")
    assert [entry["path"] for entry in written(audit, 2)] == ["/b", "/a"]
    audit.close()


def test_a_disk_that_hangs_is_a_fault_and_delays_neither_requests_nor_the_end(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(module, "WRITE_LIMIT_S", 0.01)
    monkeypatch.setattr(module, "READ_WAIT_S", 0.01)
    monkeypatch.setattr(module, "_MOST_WAITING", 2)
    released = threading.Event()
    monkeypatch.setattr(AuditLog, "_write", lambda *_: released.wait(PATIENCE_S))
    audit = AuditLog(tmp_path / "audit.jsonl")
    for _ in range(9):
        audit.add(path="/a")
    assert "hangs for" in str(fault_of(audit))
    assert audit.newest(5) == []
    audit.close()
    assert audit.thread.is_alive()
    released.set()


@pytest.fixture
def disk(tmp_path: Path) -> Iterator[SmallDisk]:
    made = SmallDisk(tmp_path / "disk")
    yield made
    made.close()


def test_what_came_while_the_disk_was_full_is_written_when_there_is_room(disk: SmallDisk) -> None:
    audit = AuditLog(disk.directory / "audit.jsonl")
    audit.add(number=0)
    assert len(audit.newest(5)) == 1
    disk.fill()
    for n in range(1, 200):  # more than the last page of the file has room for, so that a line is cut
        audit.add(number=n)
    assert len(audit.newest(500)) < 200
    disk.make_room()
    audit.add(number=200)
    assert [entry["number"] for entry in written(audit, 201)] == list(range(200, -1, -1))
    audit.close()


def test_a_line_that_a_power_failure_has_cut_costs_no_later_entry(tmp_path: Path) -> None:
    path = tmp_path / "audit.jsonl"
    path.write_text('{"path": "/a"}\n{"path": "/b"')
    audit = AuditLog(path)
    audit.add(path="/c")
    assert [entry["path"] for entry in audit.newest(5)] == ["/c", "/a"]
    audit.close()
