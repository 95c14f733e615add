"""Heights of finished runs: measured once each, refused before a worker is asked."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from types import SimpleNamespace
from typing import Any

import pytest

from tests.heights.conftest import Filmed, make_film
from vaoi_station.errors import StateError
from vaoi_station.runs.archive.measured_heights import MeasuredHeights


class Station:
    """Holds one run; the worker counts its jobs."""

    def __init__(self, filmed: Filmed) -> None:
        self.jobs: list[Any] = []
        frames = tuple(SimpleNamespace(camera=0, row=j, slot=j, usable=j != 1) for j in range(3))
        self.finished = SimpleNamespace(
            detail=SimpleNamespace(id="r1", frames=frames),
            board_type=filmed.board_type,
            cameras=filmed.cameras,
            stitch=filmed.stitch,
            head=SimpleNamespace(lights=("left", "right", "left")),
        )

    @contextmanager
    def lease(self, run: str, purpose: str) -> Iterator[Any]:
        yield SimpleNamespace(number=4, generation=2)

    def render(self, job: Any, name: str) -> bytes:
        self.jobs.append(job)
        return f"heights of {job.run}".encode()

    def heights(self) -> MeasuredHeights:
        archive: Any = SimpleNamespace(get=lambda run: self.finished)
        return MeasuredHeights(archive, self.lease, self.render)


def test_heights_are_measured_once_from_usable_frames() -> None:
    station = Station(make_film({"U1": ((0.0, 0.0, 3.0, 2.5), 1.0, 1.5)}, rows=2))
    heights = station.heights()
    assert heights.document("r1") == heights.document("r1") == b"heights of r1"
    [job] = station.jobs
    assert (job.bay, job.generation, job.lights) == (4, 2, ("left", "right", "left"))
    assert job.slots == {(0, 0): 0, (0, 2): 2}


def test_a_run_without_cad_mapping_occupies_no_worker() -> None:
    station = Station(make_film({"U1": ((0.0, 0.0, 3.0, 2.5), 1.0, 1.5)}, rows=2))
    station.finished.stitch = station.finished.stitch.model_copy(update={"cad_matrix": None})
    with pytest.raises(StateError, match="no CAD mapping"):
        station.heights().document("r1")
    assert not station.jobs
