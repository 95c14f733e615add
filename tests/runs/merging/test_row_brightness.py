"""Rows that flicker are equally bright in merged pictures of a station with flat fields; they are compared once."""

from __future__ import annotations

import io
from pathlib import Path

import numpy as np
import pytest

from tests.api.held_station import BOARD, HeldStation
from tests.runs.merging.finished_board import RADIANCE, Merging, even_fields
from vaoi_station.errors import GoneError
from vaoi_station.files.images import write_image
from vaoi_station.model import BoardType
from vaoi_station.runs.merging.merged_pictures import MergeRequest

WANTED = MergeRequest(region=(5, 5, 45, 35), px_per_mm=2)


@pytest.fixture(scope="module")
def station() -> HeldStation:
    return HeldStation()


@pytest.fixture
def merging(station: HeldStation, tmp_path: Path) -> Merging:
    fields = even_fields(tmp_path / "fields", station.cameras)
    return Merging(BoardType.model_validate(BOARD), station.stitch(station.film()), station.cameras, fields, 0.08)


def spread(merging: Merging, pictures: int) -> float:
    """Return by how much the mean radiance differs between the merged pictures, as a share."""
    found = [np.load(io.BytesIO(merging.access.image("r1", WANTED, k, "npy"))) for k in range(pictures)]
    means = [float(np.nanmean(value)) for value in found]
    assert np.mean(means) == pytest.approx(RADIANCE, rel=0.06)
    return max(means) / min(means) - 1


def test_rows_that_flicker_are_equally_bright(merging: Merging) -> None:
    pictures = len(merging.access.pictures("r1", WANTED))
    assert pictures > 1
    assert spread(merging, pictures) < 0.01
    (job,) = merging.compared
    assert (job.bay, job.generation, job.recorded) == (1, 7, False)
    assert len(job.frames) == sum(f.usable for f in merging.finished.detail.frames)


def test_frames_of_a_recording_are_compared_by_their_files(
    merging: Merging, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    merging.gone = True
    with pytest.raises(GoneError):
        merging.access.image("r1", WANTED, None, "npy")
    rows = len(merging.levels)
    for slot, pixels in merging.pixels.items():
        write_image(tmp_path / f"{slot}.png", pixels)
    # The access binds the function that finds files when it is made.
    monkeypatch.setattr(merging, "recorded_in", tmp_path)
    value = np.load(io.BytesIO(merging.access.image("r1", WANTED, None, "npy")))
    assert np.nanstd(value) / np.nanmean(value) < 0.02
    (job,) = merging.compared
    assert job.recorded
    assert {frame.file for frame in job.frames} == {tmp_path / f"{f.camera * rows + f.row}.png" for f in job.frames}
