"""Heights as a worker measures them."""

from __future__ import annotations

import json
import pickle
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from tests.heights.conftest import make_film
from vaoi_station.heights.estimates import combine_parts
from vaoi_station.photometry.flat_fields import FlatFieldDocument, FlatFields, write_flat_fields
from vaoi_station.runs.workers import heights_job
from vaoi_station.runs.workers.heights_job import CombineHeightsJob, HeightsJob

PARTS = {"U1": ((0.0, 0.0, 3.0, 2.5), 1.0, 1.5), "U2": ((4.0, 0.0, 3.0, 2.5), 1.0, 0.8)}
SLOTS = {(0, 0): 7, (0, 1): 8}


def test_slices_and_their_combination_can_be_sent_to_a_worker(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(heights_job, "SLICE_S", -1.0)
    filmed = make_film(PARTS, rows=2)
    job = HeightsJob("r1", 0, 1, filmed.board_type, filmed.stitch, filmed.cameras, (), SLOTS)
    sent: HeightsJob = pickle.loads(pickle.dumps(job))
    assert str(sent) == "heights of components of run r1"
    first = sent.perform(lambda slot: filmed.frames[0, slot - 7])
    assert list(first) == ["U1"], "the time is over after one component"
    rest = filmed.board_type.model_copy(update={"components": filmed.board_type.components[1:]})
    second = HeightsJob("r1", 0, 1, rest, filmed.stitch, filmed.cameras, (), SLOTS)
    parts = {**first, **second.perform(lambda slot: filmed.frames[0, slot - 7])}
    combined = CombineHeightsJob("r1", 0, 1, filmed.board_type, filmed.stitch, parts)
    last: CombineHeightsJob = pickle.loads(pickle.dumps(combined))
    assert str(last) == "the table of heights of run r1"
    heights = json.loads(last.perform(lambda slot: filmed.frames[0, slot]))["heights"]
    assert heights["U1"]["height_mm"] == pytest.approx(1.5, abs=0.1)
    assert heights["U1"]["views"] == 2
    assert heights["U1"]["comparison"] == "agrees"
    assert set(heights) == {"U1", "U2"}


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


def test_a_slice_uses_the_frames_that_it_has_converted(monkeypatch: pytest.MonkeyPatch) -> None:
    """Else each slice would convert the frames again, and measure one component."""
    filmed, now_s = make_film(PARTS, rows=2), [0.0]
    monkeypatch.setattr(heights_job, "time", SimpleNamespace(monotonic=lambda: now_s[0]))
    read: list[int] = []

    def frame(slot: int) -> Any:
        read.append(slot)
        now_s[0] += 10 * heights_job.SLICE_S
        return filmed.frames[0, slot - 7]

    job = HeightsJob("r1", 0, 1, filmed.board_type, filmed.stitch, filmed.cameras, (), SLOTS)
    assert list(job.perform(frame)) == ["U1", "U2"]
    assert sorted(read) == [7, 8]
