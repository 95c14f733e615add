"""Jobs on the frames of a finished run, as a worker performs them: pickled to it, and performed there."""

from __future__ import annotations

import os
import pickle
import subprocess
from pathlib import Path

import numpy as np
import pytest

from tests.board_check.conftest import drawn_board, drawn_run
from tests.hdr.exposed_views import FRAME, view
from tests.heights.conftest import make_film
from tests.mosaic.conftest import board, film
from vaoi_station.files.images import decode
from vaoi_station.heights.estimates import combine_parts
from vaoi_station.photometry import Taken
from vaoi_station.photometry.flat_fields import FlatFieldDocument, FlatFields, write_flat_fields
from vaoi_station.runs.workers import second_compiler
from vaoi_station.runs.workers.jobs import Priority
from vaoi_station.runs.workers.picture_jobs import (
    BoardCheckJob,
    HeightsJob,
    MergedFrame,
    MergeJob,
)


def test_a_job_can_be_sent_and_yields_report_and_picture() -> None:
    board = drawn_board(count=12)
    run = drawn_run(board)
    job = BoardCheckJob("r1", 0, 1, {(0, 0): 5}, run.stitch, run.cameras, (), board, board)
    sent: BoardCheckJob = pickle.loads(pickle.dumps(job))
    assert sent.priority is Priority.HEIGHTS
    assert (sent.repeatable, sent.longest_s) == (False, 180.0)
    assert str(sent) == "the check of board type 'drawn' against run r1"
    slots: list[int] = []

    def frame(slot: int) -> np.ndarray:
        slots.append(slot)
        pixels = run.frame(0, 0)
        assert pixels is not None
        return pixels

    found = sent.perform(frame)
    assert set(slots) == {5}
    assert found.report.residual is not None
    assert found.report.proposal is None
    picture = decode(found.picture)
    assert picture is not None
    assert picture.ndim == 3


PARTS = {"U1": ((0.0, 0.0, 3.0, 2.5), 1.0, 1.5), "U2": ((4.0, 0.0, 3.0, 2.5), 1.0, 0.8)}
SLOTS = {(0, 0): 7, (0, 1): 8}


def test_frames_are_divided_by_the_flat_fields(tmp_path: Path) -> None:
    """A pattern that stays where it is in the frames hides how far the tops of bodies move."""
    filmed = make_film(PARTS, rows=2)
    (camera,) = filmed.cameras
    x, y = np.meshgrid(np.arange(camera.width_px), np.arange(camera.height_px))
    shade = (0.6 + 0.2 * np.sin(0.5 * x) + 0.2 * np.sin(0.7 * y)).astype(np.float32)
    document = {
        "format": "vaoi-flatfield",
        "version": 1,
        "cameras": [{"width": camera.width_px, "height": camera.height_px, "read": 1.0, "shot": 0.02}],
        "fields": [{"camera": 0, "file": "fields/0.tiff", "level": 1.0, "rows": 4}],
    }
    write_flat_fields(tmp_path, FlatFields(FlatFieldDocument.model_validate(document), {(0, None): shade}))
    shaded = [np.round(filmed.frames[0, row] * shade).astype(np.uint8) for row in range(2)]

    def measured(fields: Path | None) -> dict[str, float | None]:
        job = HeightsJob("r1", 0, 1, filmed.board_type, filmed.stitch, filmed.cameras, (), SLOTS, fields)
        parts = pickle.loads(pickle.dumps(job)).perform(lambda slot: shaded[slot - 7])
        return {ref: found.height_mm for ref, found in combine_parts(parts, filmed.stitch).items()}

    truth = {ref: height_mm for ref, (_, _, height_mm) in PARTS.items()}
    assert measured(tmp_path) == pytest.approx(truth, abs=0.1)
    assert measured(None) != pytest.approx(truth, abs=0.1)


def test_heights_and_mosaics_wait_without_keeping_a_worker_until_they_are_compiled(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """At a first start they are compiled after the first pictures; the worker links the next board meanwhile."""
    filmed = make_film(PARTS, rows=2)
    heights = HeightsJob("r1", 0, 1, filmed.board_type, filmed.stitch, filmed.cameras, (), SLOTS)
    with subprocess.Popen(["sleep", "60"]) as compiler:
        monkeypatch.setattr(second_compiler, "_pidfd", os.pidfd_open(compiler.pid))
        assert heights.perform(lambda slot: filmed.frames[0, slot - 7]) == {}
        compiler.kill()
        compiler.wait()
        assert heights.perform(lambda slot: filmed.frames[0, slot - 7])


def job(**options: object) -> MergeJob:
    shown = view(0, 0, (12.0, 9.0))
    frames = tuple(MergedFrame(shown, Taken(exposure), FRAME, slot) for slot, exposure in enumerate((100.0, 10.0)))
    return MergeJob("r1", 0, 1, 0, shown, "npy", frames=frames, **options)  # type: ignore[arg-type]


__all__ = ["board", "film"]
