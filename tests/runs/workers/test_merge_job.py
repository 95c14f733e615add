from __future__ import annotations

import io
import pickle
from pathlib import Path

import numpy as np
import pytest

from tests.hdr.exposed_views import FRAME, SIZE, view
from vaoi_station.errors import NotFoundError
from vaoi_station.files.images import write_image
from vaoi_station.photometry import Taken
from vaoi_station.runs.workers.merge_job import MergedFrame, MergeJob, merge


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
