"""What is copied of a recording or reference is complete, or named as deleted."""

from __future__ import annotations

from pathlib import Path

import pytest

from vaoi_station.errors import GoneError
from vaoi_station.files.directories import remove_directory
from vaoi_station.transfer.live_directories import open_files


@pytest.fixture
def recording(tmp_path: Path) -> Path:
    for name in ("recording.json", "frames/c00_r000.tiff", "run.json"):
        (tmp_path / "r1" / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / "r1" / name).write_text(name)
    return tmp_path / "r1"


def test_the_head_is_the_last_of_all_files(recording: Path) -> None:
    found = [(name, content.read().decode()) for name, content in open_files(recording)]
    assert found == [(name, name) for name in ("run.json", "frames/c00_r000.tiff", "recording.json")]


@pytest.mark.parametrize("read", [0, 1, 2])
def test_a_deleted_directory_is_named(recording: Path, read: int) -> None:
    files = open_files(recording)
    assert len([next(files) for _ in range(read)]) == read
    remove_directory(recording)
    with pytest.raises(GoneError, match="r1: was deleted while it was read"):
        list(files)
