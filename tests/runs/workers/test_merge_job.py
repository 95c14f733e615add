from __future__ import annotations

import io
import pickle
from pathlib import Path

import numpy as np
import pytest

from tests.api.held_station import BOARD, HeldStation
from tests.hdr.exposed_views import FRAME, SIZE, view
from tests.runs.merging.finished_board import Merging, even_fields
from vaoi_station.errors import NotFoundError
from vaoi_station.files.images import write_image
from vaoi_station.model import BoardType
from vaoi_station.photometry import Taken
from vaoi_station.runs.merging.row_brightness import level_frames
from vaoi_station.runs.workers import merge_job
from vaoi_station.runs.workers.merge_job import MergedFrame, MergeJob, RowLevelsJob, merge


def job(**options: object) -> MergeJob:
    shown = view(0, 0, (12.0, 9.0))
    frames = tuple(MergedFrame(shown, Taken(exposure), FRAME, slot) for slot, exposure in enumerate((100.0, 10.0)))
    return MergeJob("r1", 0, 1, 0, shown, "npy", frames=frames, **options)  # type: ignore[arg-type]


def test_frames_of_the_ring_are_merged() -> None:
    pixels = {0: np.full(FRAME[::-1], 255, np.uint8), 1: np.full(FRAME[::-1], 60, np.uint8)}
    merged = pickle.loads(pickle.dumps(job()))
    value = np.load(io.BytesIO(merge(merged, pixels.__getitem__)))
    assert value.shape == SIZE[::-1]
    np.testing.assert_allclose(value, 6.0, rtol=1e-5)
    sigma = np.load(io.BytesIO(merge(job(sigma=True), pixels.__getitem__)))
    assert 0 < sigma.max() < 1


def test_frames_of_a_recording_are_read_from_their_files(tmp_path: Path) -> None:
    write_image(tmp_path / "a.png", np.full(FRAME[::-1], 40, np.uint8))
    frames = tuple(f._replace(file=tmp_path / "a.png", taken=Taken(10.0)) for f in job().frames)
    merged = MergeJob("r1", 0, 0, 0, job().view, "npy", frames=frames, file=tmp_path / "a.png")
    np.testing.assert_allclose(np.load(io.BytesIO(merge(merged, lambda _: np.zeros(0)))), 4.0, rtol=1e-5)


def test_absent_flat_fields_are_named(tmp_path: Path) -> None:
    with pytest.raises(NotFoundError, match=r"flatfield\.json: there is no such file"):
        merge(job(flat_fields=tmp_path / "none"), lambda _: np.zeros(FRAME[::-1], np.uint8))


def test_levels_follow_from_the_ring_and_from_files(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The lamp's level of each row, up to one factor per light, since their mean is 1."""
    station = HeldStation()
    fields = even_fields(tmp_path / "fields", station.cameras)
    board_type = BoardType.model_validate(BOARD)
    made = Merging(board_type, station.stitch(station.film()), station.cameras, fields, 0.08)
    rows, finished = len(made.levels), made.finished
    frames = level_frames(finished.detail.frames)
    job = RowLevelsJob("r1", 1, 7, frames, board_type, finished.stitch, station.cameras, fields)
    found = pickle.loads(pickle.dumps(job)).perform(made.pixels.__getitem__)
    for light in (0, 1):
        mine, true = found[light::2], made.levels[light::2]
        np.testing.assert_allclose(mine / np.exp(np.log(mine).mean()), true / np.exp(np.log(true).mean()), atol=0.012)
    for slot, pixels in made.pixels.items():
        write_image(tmp_path / f"{slot}.png", pixels)
    filed = tuple(f._replace(file=tmp_path / f"{f.camera * rows + f.row}.png") for f in frames)
    recorded = RowLevelsJob("r1", 0, 0, filed, board_type, finished.stitch, station.cameras, fields, recorded=True)
    np.testing.assert_array_equal(recorded.perform(lambda _: np.zeros(0)), found)
    monkeypatch.setattr(merge_job, "MOST_DECODED", 1000)
    np.testing.assert_array_equal(recorded.perform(lambda _: np.zeros(0)), 1.0)
    np.testing.assert_array_equal(job.perform(made.pixels.__getitem__), found)
    assert str(job) == "the brightness of the rows of run r1"
