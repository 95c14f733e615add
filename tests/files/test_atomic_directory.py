"""A new directory appears complete, or not at all."""

from __future__ import annotations

import shutil
from pathlib import Path
from typing import Any

import pytest

from vaoi_station.errors import InputError
from vaoi_station.files.atomic_directory import new_directory, refuse_existing, remove_directory


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


def test_existing_directory_is_refused_and_unchanged(tmp_path: Path) -> None:
    (tmp_path / "kept").mkdir()
    with pytest.raises(InputError, match="exists already"), new_directory(tmp_path / "kept"):
        pass
    assert [path.name for path in tmp_path.iterdir()] == ["kept"]


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


def test_a_directory_goes_although_what_was_left_of_one_is_in_the_way(tmp_path: Path) -> None:
    for name in ("kept", ".kept.deleted"):
        (tmp_path / name).mkdir()
        (tmp_path / name / "file").write_text("whole")
    remove_directory(tmp_path / "kept")
    assert [path.name for path in tmp_path.iterdir()] == [".kept.deleted"]
