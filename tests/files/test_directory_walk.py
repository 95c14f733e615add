"""Walks survive folders that are deleted meanwhile, and hide no other error."""

from __future__ import annotations

import os
import shutil
from collections.abc import Iterator
from pathlib import Path

import pytest

from vaoi_station.files.directory_walk import files_below, size_below


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


def test_regular_files_are_listed_in_order(tree: Path) -> None:
    assert names(files_below(tree), tree) == [".draft/4", "a/1", "a/b/2", "c/.5", "c/d/3"]
    assert names(files_below(tree, hidden=False), tree) == ["a/1", "a/b/2", "c/d/3"]
    assert size_below(tree) == sum(map(len, names(files_below(tree), tree)))
    assert list(files_below(tree / "absent")) == list(files_below(tree / "a" / "1")) == []


def test_what_is_deleted_during_the_walk_is_left_out(tree: Path) -> None:
    walk = files_below(tree, hidden=False)
    assert next(walk).name == "1"
    # Path.rglob of Python 3.11 raises FileNotFoundError here: it knows the folder, and finds it gone.
    shutil.rmtree(tree / "a")
    assert names(walk, tree) == ["c/d/3"]


def test_folders_that_cannot_be_read_are_errors(tree: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    scandir = os.scandir

    def refuse(path: str) -> Iterator[os.DirEntry[str]]:
        if Path(path).name == "c":
            raise PermissionError(13, "Permission denied", path)
        return scandir(path)

    monkeypatch.setattr(os, "scandir", refuse)
    with pytest.raises(PermissionError):
        list(files_below(tree))
