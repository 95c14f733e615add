"""Heights of finished runs: measured once each, stored, refused before a worker is asked."""

from __future__ import annotations

import json
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from tests.heights.conftest import Filmed, make_film
from tests.runs.finished import held_run
from vaoi_station.heights.estimates import PartMeasure
from vaoi_station.runs.archive.measured_heights import MeasuredHeights
from vaoi_station.runs.workers.jobs import Priority
from vaoi_station.runs.workers.picture_jobs import HeightsJob

PARTS = {"U1": ((0.0, 0.0, 3.0, 2.5), 1.0, 1.5), "U2": ((4.0, 0.0, 3.0, 2.5), 1.0, 0.8)}
CONTENT = json.dumps({"heights": {"U1": {"height_mm": 1.5, "sigma_mm": 0.02, "views": 2}, "U2": {"views": 1}}}).encode()


class Station:
    """Holds one run; the worker measures one component per slice and records its jobs."""

    def __init__(self, filmed: Filmed) -> None:
        self.jobs: list[Any] = []
        self.held = 0
        self.stored: dict[str, str] = {}
        self.saved, self.asked, self.free = threading.Event(), threading.Event(), threading.Event()
        self.free.set()
        self.fault: Exception | None = None
        self.events: list[dict[str, Any]] = []
        self.flat_fields: Path | None = None
        frames = tuple(SimpleNamespace(camera=0, row=j, slot=j, usable=j != 1) for j in range(3))
        self.finished = held_run(
            detail=SimpleNamespace(id="r1", frames=frames),
            board_type=filmed.board_type,
            cameras=filmed.cameras,
            stitch=filmed.stitch,
            head=SimpleNamespace(lights=("left", "right", "left")),
        )

    @contextmanager
    def lease(self, run: str, purpose: str) -> Iterator[Any]:
        self.held += 1
        yield self.bay_of(run)

    def bay_of(self, run: str) -> Any:
        return SimpleNamespace(number=4, generation=2)

    def render(self, job: Any, name: str) -> Any:
        self.jobs.append(job)
        self.asked.set()
        assert self.free.wait(20)
        if self.fault is not None:
            self.saved.set()
            raise self.fault
        if isinstance(job, HeightsJob):
            return {job.board_type.components[0].address: PartMeasure(2, None, ())}
        return CONTENT

    def save(self, run: str, document: str) -> None:
        self.stored[run] = document
        self.saved.set()

    def add(self, kind: str, message: str, **fields: Any) -> None:
        self.events.append({"message": message, **fields})

    def heights(self) -> MeasuredHeights:
        store = SimpleNamespace(heights=self.stored.get, save_heights=self.save)
        archive: Any = SimpleNamespace(get=lambda run: self.finished, store=store)
        events: Any = self
        return MeasuredHeights(archive, self.lease, self.render, self.bay_of, events, self.flat_fields)


@pytest.fixture
def station() -> Station:
    return Station(make_film(PARTS, rows=2))


def measured_after(station: Station) -> None:
    """Let one run end, and wait until its heights were stored or refused."""
    heights = station.heights()
    heights.queue.start()
    heights.queue.put(station.finished.detail.id)
    assert station.saved.wait(20)
    heights.queue.stop()
    assert heights.queue.thread.fault() is None


def test_heights_are_measured_once_from_usable_frames_under_a_lease(station: Station) -> None:
    heights = station.heights()
    assert heights.document("r1") == heights.document("r1") == CONTENT
    *slices, combined = station.jobs
    assert [s.board_type.components[0].address for s in slices] == ["U1", "U2"]
    assert (slices[0].bay, slices[0].generation, slices[0].lights) == (4, 2, ("left", "right", "left"))
    assert slices[0].slots == {(0, 0): 0, (0, 2): 2}
    assert {job.priority for job in station.jobs} == {Priority.RENDER}
    assert set(combined.parts) == {"U1", "U2"}
    assert station.held == 1


def test_after_a_run_its_heights_are_measured_at_the_lowest_priority_and_stored(station: Station) -> None:
    measured_after(station)
    assert station.stored == {"r1": CONTENT.decode()}
    assert {job.priority for job in station.jobs} == {Priority.HEIGHTS}
    assert station.held == 0, "the next board may take the frames"
