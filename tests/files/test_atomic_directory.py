"""A directory that is new_directory appears complete, or nothing does."""

from __future__ import annotations

from pathlib import Path

import pytest

from vaoi_station.errors import StateError
from vaoi_station.files.atomic_directory import new_directory


def test_it_appears_with_all_that_is_in_it(tmp_path: Path) -> None:
    directory = tmp_path / "deep" / "kept"
    with new_directory(directory) as draft:
        (draft / "file").write_text("whole")
        assert not directory.exists()
    assert (directory / "file").read_text() == "whole"
    assert directory.stat().st_mode & 0o777 == 0o755, "others than its writer may read it"
    assert [path.name for path in directory.parent.iterdir()] == ["kept"]


@pytest.mark.parametrize("trouble", [OSError, KeyboardInterrupt])
def test_nothing_is_left_of_one_that_went_wrong(tmp_path: Path, trouble: type[BaseException]) -> None:
    def write_half() -> None:
        with new_directory(tmp_path / "kept") as draft:
            (draft / "file").write_text("half")
            raise trouble

    with pytest.raises(trouble):
        write_half()
    assert list(tmp_path.iterdir()) == []


def test_what_exists_is_left_as_it_is(tmp_path: Path) -> None:
    (tmp_path / "kept").mkdir()
    with pytest.raises(StateError, match="exists already"), new_directory(tmp_path / "kept"):
        pass
    assert [path.name for path in tmp_path.iterdir()] == ["kept"]
