"""Files and names on the disk. tests/power cuts the power; here: what is synced, in which order."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from vaoi_station.files.durability import make_directories, sync_directory, sync_file, sync_tree


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
