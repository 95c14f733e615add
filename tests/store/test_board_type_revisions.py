"""Versions of board types: kept before every change, bounded, and not driven out by a flood of changes."""

from __future__ import annotations

import errno
import os
from datetime import UTC, datetime, timedelta
from pathlib import Path

import pytest

from vaoi_station.errors import DeviceError, NotFoundError
from vaoi_station.model import BoardType, Fiducial
from vaoi_station.store import BoardTypeDirectory, board_type_revisions


@pytest.fixture
def directory(tmp_path: Path) -> BoardTypeDirectory:
    return BoardTypeDirectory(tmp_path / "board-types")


@pytest.fixture
def clock(monkeypatch: pytest.MonkeyPatch) -> None:
    """A wall clock that goes on by one second at each reading."""
    now = datetime(2030, 1, 1, tzinfo=UTC)

    class Clock(datetime):
        @classmethod
        def now(cls, tz: object = None) -> datetime:  # type: ignore[override]
            nonlocal now
            now += timedelta(seconds=1)
            return now

    monkeypatch.setattr(board_type_revisions, "datetime", Clock)


def board(x: float, name: str = "A 1/b") -> BoardType:
    return BoardType(name=name, fiducials=(Fiducial(name="F", x=x, y=0, diameter=1),))


def test_every_version_can_be_read_after_it_was_replaced_or_deleted(directory: BoardTypeDirectory, clock: None) -> None:
    for x in (1, 2):
        directory.put(board(x))
    assert directory.deleted() == ()
    directory.delete("A 1/b")
    newest, oldest = directory.revisions_of("A 1/b")
    assert newest.ended > oldest.ended
    assert directory.revision("A 1/b", newest.id) == board(2)
    assert directory.revision("A 1/b", oldest.id) == board(1)
    assert directory.deleted() == ("A 1/b",)
    assert directory.list() == []


def test_an_unchanged_board_type_makes_no_version(directory: BoardTypeDirectory) -> None:
    for _ in range(3):
        directory.put(board(1))
    assert directory.revisions_of("A 1/b") == ()


def test_a_file_that_cannot_be_used_is_kept_as_it_was(directory: BoardTypeDirectory) -> None:
    directory.put(board(1))
    directory.path_of("A 1/b").write_text("{half")
    directory.put(board(2))
    (kept,) = directory.revisions_of("A 1/b")
    assert kept.path.read_text() == "{half"


def test_unknown_names_and_versions_are_refused(directory: BoardTypeDirectory) -> None:
    with pytest.raises(NotFoundError, match="no board type 'x'"):
        directory.revisions_of("x")
    directory.put(board(1))
    for name in ("20300101T000000000Z-00000000", "../../A 1%2Fb"):
        with pytest.raises(NotFoundError) as refusal:
            directory.revision("A 1/b", name)
        assert refusal.value.code == "unknown-revision"


def test_a_flood_of_changes_does_not_drive_out_the_version_of_months(
    directory: BoardTypeDirectory, clock: None, monkeypatch: pytest.MonkeyPatch
) -> None:
    directory.put(board(0))
    old = datetime(2029, 1, 1, tzinfo=UTC).timestamp()
    os.utime(directory.path_of("A 1/b"), (old, old))
    for x in range(1, 60):
        directory.put(board(x))
        os.utime(directory.path_of("A 1/b"), (2e9, 2e9))  # later than the clock of the test: in force for 0 s
    kept = directory.revisions_of("A 1/b")
    assert len(kept) == board_type_revisions.MOST_OF_TYPE
    assert directory.revision("A 1/b", kept[-1].id) == board(0)
    assert directory.revision("A 1/b", kept[0].id) == board(58), "the newest one undoes the last change"


def test_many_names_are_bounded_in_number_and_size(
    directory: BoardTypeDirectory, clock: None, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(board_type_revisions, "MOST_REVISIONS", 5)
    for n in range(9):
        directory.put(board(n, f"type {n}"))
        directory.delete(f"type {n}")
    assert len(directory.deleted()) == 5
    assert "type 8" in directory.deleted()
    monkeypatch.setattr(board_type_revisions, "MOST_BYTES", 3 * directory.revisions_of("type 8")[0].size_bytes)
    directory.put(board(9, "type 9"))
    directory.delete("type 9")
    assert len(directory.deleted()) == 3


def test_without_room_for_the_version_nothing_is_changed(
    directory: BoardTypeDirectory, monkeypatch: pytest.MonkeyPatch
) -> None:
    directory.put(board(1))
    (directory.directory / ".revisions").write_text("a file where the folder belongs")
    with pytest.raises(DeviceError, match="nothing was changed") as refusal:
        directory.put(board(2))
    assert refusal.value.code == "revision-not-kept"
    with pytest.raises(DeviceError):
        directory.delete("A 1/b")
    assert directory.get("A 1/b") == board(1)


def test_a_file_system_without_links_gets_copies(
    directory: BoardTypeDirectory, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refuse(*_: object) -> None:
        raise OSError(errno.EPERM, "no links")

    monkeypatch.setattr(os, "link", refuse)
    for x in (1, 2):
        directory.put(board(x))
    (kept,) = directory.revisions_of("A 1/b")
    assert directory.revision("A 1/b", kept.id) == board(1)
