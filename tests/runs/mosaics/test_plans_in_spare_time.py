"""Callers of a mosaic whose plan is made in spare time join it and hasten it, or have their own made if it fails."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

from tests.mosaic.conftest import Filmed, board, film
from tests.runs.mosaics.test_mosaics import mosaics_of, spare
from vaoi_station.runs.mosaics.opened_mosaics import PictureName
from vaoi_station.runs.workers.jobs import Priority
from vaoi_station.runs.workers.picture_jobs import PlanJob

__all__ = ["board", "film"]


def test_a_caller_joins_the_plan_in_spare_time_and_hastens_it(board: Filmed) -> None:
    """Otherwise the caller waits for a second one, which a worker makes from the beginning."""
    jobs: list[Any] = []
    begun, may_go = threading.Event(), threading.Event()

    class Noted(list[Any]):
        def append(self, job: Any) -> None:
            jobs.append(job)
            begun.set()

    @contextmanager
    def hastened(kind: Any, run: str) -> Iterator[None]:
        assert [(type(job), job.run) for job in jobs] == [(kind, run)]
        may_go.set()  # only a caller who hastens the plan lets it be made
        yield

    mosaics = mosaics_of(board, Noted(), may_go, hastened=hastened)
    small = threading.Thread(target=mosaics.small, args=("r1", 20_000, spare))
    small.start()
    assert begun.wait(30)
    mosaics.tile("r1", PictureName(), 1, (0, 0, 16, 16), "jpg")
    small.join(60)
    assert [job.priority for job in jobs if isinstance(job, PlanJob)] == [Priority.OVERVIEW]
