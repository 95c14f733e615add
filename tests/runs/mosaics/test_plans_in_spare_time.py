"""Callers of a mosaic whose plan is made in spare time join it and hasten it, or have their own made if it fails."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import pytest

from tests.mosaic.conftest import Filmed, board, film
from tests.runs.mosaics.test_mosaics import mosaics_of, spare
from vaoi_station.errors import GoneError
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


def test_a_caller_has_a_plan_made_if_that_in_spare_time_fails(board: Filmed) -> None:
    jobs: list[Any] = []
    begun, may_fail = threading.Event(), threading.Event()

    @contextmanager
    def hastened(kind: Any, run: str) -> Iterator[None]:
        may_fail.set()
        yield

    mosaics = mosaics_of(board, jobs, hastened=hastened)
    render = mosaics._render

    def failing(job: Any, name: str) -> Any:
        if job.priority is not Priority.OVERVIEW:
            return render(job, name)
        begun.set()
        assert may_fail.wait(30)
        raise GoneError("The frames are no longer in memory.", code="frames-gone")

    mosaics._render = failing
    refusals: list[type[BaseException]] = []

    def small() -> None:
        with pytest.raises(GoneError) as refused:
            mosaics.small("r1", 20_000, spare)
        refusals.append(refused.type)

    thread = threading.Thread(target=small)
    thread.start()
    assert begun.wait(30)
    mosaics.tile("r1", PictureName(), 1, (0, 0, 16, 16), "jpg")
    thread.join(60)
    assert refusals == [GoneError]
    assert [job.priority for job in jobs if isinstance(job, PlanJob)] == [Priority.RENDER]
