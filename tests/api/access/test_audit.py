"""The audit log: order, size, faults of the disk."""

from __future__ import annotations

from pathlib import Path

from vaoi_station.api.access.audit import FILES_KEPT, AuditLog


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
