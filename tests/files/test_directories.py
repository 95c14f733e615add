"""Files and names on the disk. tests/power cuts the power; here: what is synced, in which order."""

from __future__ import annotations

import os
import shutil
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from vaoi_station.errors import InputError
from vaoi_station.files.directories import (
    files_below,
    make_directories,
    new_directory,
    refuse_existing,
    remove_directory,
    sync_directory,
    sync_file,
    sync_tree,
)


@pytest.fixture
def synced(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """The names of everything that is synced, in order."""
    names: list[str] = []
    monkeypatch.setattr(os, "fsync", lambda fd: names.append(Path(f"/proc/self/fd/{fd}").readlink().name))
    return names


def test_a_tree_is_synced_with_files_and_folders(tmp_path: Path, synced: list[str]) -> None:
    (tmp_path / "tree" / "inner").mkdir(parents=True)
    for name in ("a", "inner/b"):
        (tmp_path / "tree" / name).write_text("x")
    sync_tree(tmp_path / "tree")
    assert synced == ["a", "tree", "b", "inner"]


def test_new_directories_are_synced_with_their_parents(tmp_path: Path, synced: list[str]) -> None:
    make_directories(tmp_path / "one" / "two")
    assert (tmp_path / "one" / "two").is_dir()
    assert synced == ["one", tmp_path.name]
    make_directories(tmp_path / "one" / "two")
    assert len(synced) == 2, "there was nothing to create"


def test_a_file_system_that_cannot_sync_directories_is_accepted(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refuse(fd: int) -> None:
        raise OSError(22, "Invalid argument")

    monkeypatch.setattr(os, "fsync", refuse)
    sync_directory(tmp_path)
    (tmp_path / "file").write_text("x")
    with pytest.raises(OSError, match="Invalid argument"):
        sync_file(tmp_path / "file")


def test_directory_appears_complete(tmp_path: Path) -> None:
    directory = tmp_path / "deep" / "kept"
    with new_directory(directory) as draft:
        (draft / "file").write_text("whole")
        assert not directory.exists()
    assert (directory / "file").read_text() == "whole"
    assert directory.stat().st_mode & 0o777 == 0o755, "other users may read it"
    assert [path.name for path in directory.parent.iterdir()] == ["kept"]


@pytest.mark.parametrize("error", [OSError, KeyboardInterrupt])
def test_nothing_remains_after_an_exception(tmp_path: Path, error: type[BaseException]) -> None:
    def write_half() -> None:
        with new_directory(tmp_path / "kept") as draft:
            (draft / "file").write_text("half")
            raise error

    with pytest.raises(error):
        write_half()
    assert list(tmp_path.iterdir()) == []


def test_existing_targets_of_any_kind_are_refused_as_input(tmp_path: Path) -> None:
    refuse_existing(tmp_path / "new", tmp_path / "newer")
    (tmp_path / "file").touch()
    (tmp_path / "link").symlink_to(tmp_path / "absent")
    for name in ("file", "link"):
        with pytest.raises(InputError, match=f"{name}: exists already. Choose another"):
            refuse_existing(tmp_path / "new", tmp_path / name)


def test_the_name_of_a_directory_goes_before_its_content(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    seen, remove = list[list[str]](), shutil.rmtree

    def look(path: Path, **options: Any) -> None:
        seen.append([p.relative_to(tmp_path).as_posix() for p in sorted(tmp_path.rglob("*"))])
        remove(path, **options)

    monkeypatch.setattr(shutil, "rmtree", look)
    (tmp_path / "kept").mkdir()
    (tmp_path / "kept" / "file").write_text("whole")
    remove_directory(tmp_path / "kept")
    assert seen == [[".kept.deleted", ".kept.deleted/file"]]
    assert list(tmp_path.iterdir()) == []
    remove_directory(tmp_path / "kept")  # absent


@pytest.fixture
def tree(tmp_path: Path) -> Path:
    for name in ("a/1", "a/b/2", "c/d/3", ".draft/4", "c/.5"):
        path = tmp_path / "tree" / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(name)
    (tmp_path / "tree" / "c" / "gone").symlink_to("absent")
    return tmp_path / "tree"


def names(found: Iterator[Path], tree: Path) -> list[str]:
    return [path.relative_to(tree).as_posix() for path in found]


def test_folders_that_cannot_be_read_are_errors(tree: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    scandir = os.scandir

    def refuse(path: str) -> Iterator[os.DirEntry[str]]:
        if Path(path).name == "c":
            raise PermissionError(13, "Permission denied", path)
        return scandir(path)

    monkeypatch.setattr(os, "scandir", refuse)
    with pytest.raises(PermissionError):
        list(files_below(tree))
