"""Board types are files of one directory."""

from __future__ import annotations

import errno
import os
from datetime import UTC, datetime, timedelta
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from vaoi_station.errors import DeviceError, InputError, NotFoundError, StateError
from vaoi_station.model import BoardType, Fiducial
from vaoi_station.store import BoardTypeDirectory, board_types


@pytest.fixture
def directory(tmp_path: Path) -> BoardTypeDirectory:
    return BoardTypeDirectory(tmp_path / "board-types")


def board(name: str) -> BoardType:
    return BoardType(name=name, fiducials=(Fiducial(name="F", x=0, y=0, diameter=1),))


def test_a_board_type_is_written_read_replaced_and_deleted(directory: BoardTypeDirectory) -> None:
    assert directory.list() == []
    assert directory.put(board("A 1")) is True
    changed = board("A 1").model_copy(update={"side": "bottom"})
    assert directory.put(changed) is False
    assert directory.get("A 1") == changed
    assert (directory.directory / "A 1.json").is_file()
    directory.delete("A 1")
    with pytest.raises(NotFoundError, match="known board types: none yet"):
        directory.get("A 1")
    with pytest.raises(NotFoundError):
        directory.delete("A 1")


@settings(max_examples=60)
@given(st.text(min_size=1, max_size=40).filter(lambda s: s.isprintable()))
def test_every_name_has_a_separate_file_inside_the_directory(name: str) -> None:
    directory = BoardTypeDirectory(Path("/somewhere"))
    path = directory.path_of(name)
    assert path.parent == Path("/somewhere")
    assert not path.name.startswith(".")
    assert path.name.isascii()
    assert directory.path_of(name + "x") != path


def test_unusable_files_are_listed_with_their_fault(directory: BoardTypeDirectory) -> None:
    directory.put(board("good"))
    (directory.directory / "good.json").rename(directory.directory / "renamed.json")
    directory.put(board("good"))
    (directory.directory / "broken.json").write_text('{"name": "broken", "nmae": 1}')
    faults = {entry.path.stem: entry.fault.message if entry.fault else None for entry in directory.list()}
    assert faults["good"] is None
    assert "holds the board type 'good'" in str(faults["renamed"])
    assert "unknown key(s) 'nmae'" in str(faults["broken"])
    with pytest.raises(InputError, match="nmae"):
        directory.get("broken")


def test_board_types_without_end_are_refused(directory: BoardTypeDirectory, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(board_types, "MOST_FILES", 2)
    assert [directory.put(board(n)) for n in ("a", "b")] == [True, True]
    with pytest.raises(StateError, match="2 board types are stored, the limit is 2") as refusal:
        directory.put(board("c"))
    assert refusal.value.code == "too-many-board-types"
    assert not directory.put(board("a"))


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

    monkeypatch.setattr(board_types, "datetime", Clock)


def version_of(x: float, name: str = "A 1/b") -> BoardType:
    return BoardType(name=name, fiducials=(Fiducial(name="F", x=x, y=0, diameter=1),))


def test_every_version_can_be_read_after_it_was_replaced_or_deleted(directory: BoardTypeDirectory, clock: None) -> None:
    for x in (1, 2):
        directory.put(version_of(x))
    assert directory.deleted() == ()
    directory.delete("A 1/b")
    newest, oldest = directory.revisions_of("A 1/b")
    assert newest.ended > oldest.ended
    assert directory.revision("A 1/b", newest.id) == version_of(2)
    assert directory.revision("A 1/b", oldest.id) == version_of(1)
    assert directory.deleted() == ("A 1/b",)
    assert directory.list() == []


def test_unknown_names_and_versions_are_refused(directory: BoardTypeDirectory) -> None:
    with pytest.raises(NotFoundError, match="no board type 'x'"):
        directory.revisions_of("x")
    directory.put(version_of(1))
    for name in ("20300101T000000000Z-00000000", "../../A 1%2Fb"):
        with pytest.raises(NotFoundError) as refusal:
            directory.revision("A 1/b", name)
        assert refusal.value.code == "unknown-revision"


def test_a_flood_of_changes_does_not_drive_out_the_version_of_months(
    directory: BoardTypeDirectory, clock: None, monkeypatch: pytest.MonkeyPatch
) -> None:
    directory.put(version_of(0))
    old = datetime(2029, 1, 1, tzinfo=UTC).timestamp()
    os.utime(directory.path_of("A 1/b"), (old, old))
    for x in range(1, 60):
        directory.put(version_of(x))
        os.utime(directory.path_of("A 1/b"), (2e9, 2e9))  # later than the clock of the test: in force for 0 s
    kept = directory.revisions_of("A 1/b")
    assert len(kept) == board_types.MOST_OF_TYPE
    assert directory.revision("A 1/b", kept[-1].id) == version_of(0)
    assert directory.revision("A 1/b", kept[0].id) == version_of(58), "the newest one undoes the last change"


def test_many_names_are_bounded_in_number_and_size(
    directory: BoardTypeDirectory, clock: None, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(board_types, "MOST_REVISIONS", 5)
    for n in range(9):
        directory.put(version_of(n, f"type {n}"))
        directory.delete(f"type {n}")
    assert len(directory.deleted()) == 5
    assert "type 8" in directory.deleted()
    monkeypatch.setattr(board_types, "MOST_REVISION_BYTES", 3 * directory.revisions_of("type 8")[0].size_bytes)
    directory.put(version_of(9, "type 9"))
    directory.delete("type 9")
    assert len(directory.deleted()) == 3


def test_without_room_for_the_version_nothing_is_changed(
    directory: BoardTypeDirectory, monkeypatch: pytest.MonkeyPatch
) -> None:
    directory.put(version_of(1))
    (directory.directory / ".revisions").write_text("a file where the folder belongs")
    with pytest.raises(DeviceError, match="nothing was changed") as refusal:
        directory.put(version_of(2))
    assert refusal.value.code == "revision-not-kept"
    with pytest.raises(DeviceError):
        directory.delete("A 1/b")
    assert directory.get("A 1/b") == version_of(1)


def test_a_file_system_without_links_gets_copies(
    directory: BoardTypeDirectory, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refuse(*_: object) -> None:
        raise OSError(errno.EPERM, "no links")

    monkeypatch.setattr(os, "link", refuse)
    for x in (1, 2):
        directory.put(version_of(x))
    (kept,) = directory.revisions_of("A 1/b")
    assert directory.revision("A 1/b", kept.id) == version_of(1)
