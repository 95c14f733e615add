"""Runs come back from an archive as they were, or their damage is named."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from vaoi_station.errors import InputError, NotFoundError
from vaoi_station.files import open_recording
from vaoi_station.plant.archive import Archive


def test_a_run_comes_back_as_it_was(tmp_path: Path, recording: Path) -> None:
    archive = Archive.create(tmp_path / "archive")
    run = archive.add(recording)
    back = archive.extract(run.run, tmp_path / "back")
    for name in ("recording.json", "calibration.json", "board.json"):
        assert (back / name).read_bytes() == (recording / name).read_bytes()
    there, here = open_recording(recording), open_recording(back)
    for at in ((0, 0), (0, 1), (1, 0)):
        assert np.array_equal(there.frame(*at), here.frame(*at))  # type: ignore[arg-type]


def test_a_flipped_bit_is_named_and_nothing_is_written(tmp_path: Path, recording: Path) -> None:
    archive = Archive.create(tmp_path / "archive")
    run = archive.add(recording)
    content = bytearray(archive.storage.read(run.frames[1].key))
    content[len(content) // 2] ^= 4
    archive.storage.write(run.frames[1].key, bytes(content))
    with pytest.raises(InputError, match=rf"run {run.run}: blob {run.frames[1].sha256} is damaged"):
        archive.extract(run, tmp_path / "back")
    assert not (tmp_path / "back").exists()


def test_a_missing_blob_is_named(tmp_path: Path, recording: Path) -> None:
    archive = Archive.create(tmp_path / "archive")
    run = archive.add(recording)
    archive.storage.delete(run.documents["calibration"].key)
    with pytest.raises(NotFoundError, match=rf"run {run.run}: blob .* is missing"):
        archive.extract(run, tmp_path / "back")
