"""Heights as a worker measures them."""

from __future__ import annotations

import json
import pickle
from types import SimpleNamespace
from typing import Any

import pytest

from tests.heights.conftest import make_film
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
