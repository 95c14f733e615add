"""Codes as a worker reads them, in slices."""

from __future__ import annotations

import pickle
from dataclasses import replace

import pytest

from tests.identity.conftest import DATAMATRIX, film
from vaoi_station.runs.workers import identity_job
from vaoi_station.runs.workers.identity_job import IdentityJob, IdentitySlice
from vaoi_station.runs.workers.jobs import Priority


def test_slices_can_be_sent_to_a_worker_and_continue(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(identity_job, "SLICE_S", -1.0)
    filmed = film((DATAMATRIX,))
    numbers = {key: number for number, key in enumerate(filmed.frames)}
    frames = {number: filmed.frames[key] for key, number in numbers.items()}
    job = IdentityJob(
        "r1", 0, 1, filmed.with_identity(places=(), pattern="other{id}"), filmed.stitch, filmed.cameras, numbers
    )
    slices: list[IdentitySlice] = []
    while not slices or not slices[-1].progress.ended:
        sent: IdentityJob = pickle.loads(pickle.dumps(job))
        assert (str(sent), sent.priority) == ("the codes of run r1", Priority.IDENTITY)
        slices.append(pickle.loads(pickle.dumps(sent.perform(frames.__getitem__))))
        job = replace(job, progress=slices[-1].progress)
    assert len(slices) > 1
    assert [code.text for code in slices[-1].reading.codes] == list(filmed.texts)
    assert slices[-1].reading.complete
    assert slices[0].worker_s > 0


def test_a_frame_without_a_slot_is_missing() -> None:
    filmed = film((DATAMATRIX,))
    job = IdentityJob("r1", 0, 1, filmed.board_type, filmed.stitch, filmed.cameras, {})
    done = job.perform(lambda _slot: pytest.fail("no frame is there"))
    assert (done.reading.codes, len(done.reading.unread_places), done.progress.ended) == ((), 1, True)
