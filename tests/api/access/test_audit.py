"""The audit log: order, size, faults of the disk."""

from __future__ import annotations

import threading
import time
from pathlib import Path

import pytest

from tests.test_supervised_thread import kill
from vaoi_station.api.access import audit as module
from vaoi_station.api.access.audit import FILES_KEPT, AuditLog
from vaoi_station.supervised_thread import ThreadFault

PATIENCE_S = 30.0


def fault_of(audit: AuditLog) -> ThreadFault | None:
    """Wait until the thread of a log has a fault."""
    until_s = time.monotonic() + PATIENCE_S
    while (fault := audit.thread.fault()) is None and time.monotonic() < until_s:
        audit.thread.join(0.01)
    return fault


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
    assert audit.newest(1)[0]["path"] == "/b"
    audit.close()


def test_a_thread_that_ends_is_a_fault_and_no_reader_waits_for_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(module, "READ_WAIT_S", 0.01)
    audit = AuditLog(tmp_path / "audit.jsonl")
    kill(audit.thread)
    audit.add(path="/a")  # it waits for entries without a limit, so it ends when one comes
    assert str(fault_of(audit)) == "Thread 'audit' has ended (SystemExit)."
    audit.add(path="/b")
    assert "/b" not in [entry["path"] for entry in audit.newest(5)]
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
