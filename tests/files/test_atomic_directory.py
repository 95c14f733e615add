"""A new directory appears complete, or not at all."""

from __future__ import annotations

from pathlib import Path

import pytest

from vaoi_station.errors import InputError
from vaoi_station.files.atomic_directory import new_directory, refuse_existing


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
