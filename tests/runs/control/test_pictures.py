"""Pixels of a run: frames are found by camera and row and read under a lease; small pictures need no worker."""

from __future__ import annotations

import gc
import math
import weakref
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from vaoi_station.errors import DeviceError, GoneError, NotFoundError, StateError
from vaoi_station.files.documents import write_json
from vaoi_station.runs.control import pictures
from vaoi_station.runs.control.pictures import frame_record
from vaoi_station.runs.host import processes
from vaoi_station.runs.mosaics.opened_mosaics import PictureName
from vaoi_station.runs.workers.evidence_log import EvidenceLog, shared_memory
from vaoi_station.runs.workers.jobs import Numbered, Reply
from vaoi_station.runs.workers.picture_jobs import RenderJob
from vaoi_station.runs.workers.worker import WorkerRuntime


def test_a_frame_that_may_still_arrive_is_refused_differently_from_one_that_cannot(rig: Any) -> None:
    grant = rig.arm()
    rig.begin(grant)
    records = rig.row(grant, 0)
    rig.wait_run(grant.run, lambda run: run.counts.ok == 2, "two frames")
    under_way = rig.coordinator.run(grant.run)
    assert frame_record(under_way, 1, 0) == records[1]
    with pytest.raises(StateError, match=r"Camera 1, row 5 of run .* has not arrived yet"):
        frame_record(under_way, 1, 5)
    for camera, row in ((2, 0), (0, -1)):
        with pytest.raises(NotFoundError, match="2 cameras"):
            frame_record(under_way, camera, row)
    rig.finish(grant, records)
    finished = rig.result_of(grant.run)
    with pytest.raises(NotFoundError, match=r"2 cameras and 1 rows.* Take camera and row from the frames in the doc"):
        frame_record(finished, 1, 5)


def test_a_lease_ends_with_its_use_and_unknown_runs_are_not_gone_ones(rig: Any) -> None:
    grant = rig.arm()
    rig.board(grant)
    rig.result_of(grant.run)
    frames = rig.coordinator._frames
    with frames.lease(grant.run, "a test") as bay:
        assert bay.run == grant.run
        [lease] = rig.coordinator.snapshot().ring.leases
        assert (lease.run, lease.purpose) == (grant.run, "a test")
    assert rig.coordinator.snapshot().ring.leases == ()
    with pytest.raises(NotFoundError, match="no run 'never'"):
        frames.take_lease("never", "me", "a test")


class Knot:
    """An object that refers to itself, so that only the collector frees it."""

    def __init__(self) -> None:
        self.itself = self


def fetch_frame(coordinator: Any, run: str) -> None:
    coordinator.frame(run, 0, 0)


def fetch_tile(coordinator: Any, run: str) -> None:
    with pytest.raises(ValueError, match="unpack"):  # the workers of the rig make no plans
        coordinator.mosaics.tile(run, PictureName(), 1, (0, 0, 8, 8), "jpg")


@pytest.mark.parametrize("fetch", [fetch_frame, fetch_tile])
def test_no_full_garbage_collection_delays_a_caller_who_fetches(
    rig: Any, monkeypatch: pytest.MonkeyPatch, fetch: Callable[[Any, str], None]
) -> None:
    monkeypatch.setattr(processes, "IDLE_S", 0.0)
    monkeypatch.setattr(pictures, "FETCHING_S", math.inf)
    grant = rig.arm()
    rig.board(grant)
    rig.result_of(grant.run)
    fetch(rig.coordinator, grant.run)
    tied = Knot()
    gc.collect(1)
    gc.collect(1)  # now only a full collection finds it
    knot = weakref.ref(tied)
    del tied
    rig.coordinator._inbox.ask(rig.coordinator._tick)
    assert knot() is not None
    monkeypatch.setattr(pictures, "FETCHING_S", 0.0)
    rig.coordinator._inbox.ask(rig.coordinator._tick)
    assert knot() is None


# --- small pictures


@pytest.fixture
def run(rig: Any) -> str:
    """A finished run with pixels."""
    grant = rig.arm()
    rig.board(grant)
    rig.result_of(grant.run)
    random = np.random.default_rng(0)
    for frame in rig.coordinator.run(grant.run).frames:
        memory = rig.ring.memory(frame.slot)
        memory[:] = random.integers(0, 256, memory.shape)
    return str(grant.run)


def jobs(rig: Any) -> list[RenderJob]:
    return [job for job in rig.workers.done if isinstance(job, RenderJob)]


@pytest.mark.parametrize("format", ["png", "jpeg", "tiff", "npy"])
def test_the_bytes_are_those_of_a_worker(rig: Any, run: str, format: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    own = rig.coordinator.image(run, "U1", 0, format=format)
    assert jobs(rig) == []
    monkeypatch.setattr(pictures, "LARGEST_PX", 0)
    assert rig.coordinator.image(run, "U1", 0, format=format) == b"picture", "workers render what is large"
    [job] = jobs(rig)
    with WorkerRuntime(str(rig.ring.path), 0, [EvidenceLog(shared_memory(1), 0)]) as worker:
        reply = worker.reply(Numbered(1, job))
    assert isinstance(reply, Reply)
    assert reply.value == own


def test_the_flat_fields_of_the_station_balance_the_colours_of_pictures(
    rig: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    rig.archive._flat_fields = tmp_path
    grant = rig.arm()
    rig.board(grant)
    rig.result_of(grant.run)
    head = rig.archive.get(grant.run).head
    cameras = [{"width": c.width, "height": c.height, "dark": 2, "read": 1, "shot": 0.1} for c in head.cameras]
    fields = [
        {"camera": i, "light": light, "file": f"fields/{i}_{n}.tiff", "level": 1, "rows": 4, "white": [0.8, 1.2, 0.6]}
        for i in range(len(cameras))
        for n, light in enumerate(dict.fromkeys(head.lights or (None,)))
    ]
    write_json(
        tmp_path / "flatfield.json", {"format": "vaoi-flatfield", "version": 1, "cameras": cameras, "fields": fields}
    )
    monkeypatch.setattr(pictures, "LARGEST_PX", 0)
    rig.coordinator.image(grant.run, "U1", 0)
    [job] = jobs(rig)
    assert job.white_balance is not None
    assert job.white_balance.gains == pytest.approx((1.5, 1.0, 2.0))
    assert job.white_balance.dark == 2.0


def test_each_of_two_callers_gets_its_own_reply_whatever_their_order(
    rig: Any, run: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(pictures, "LARGEST_PX", 0)
    rig.workers.keep = True
    with ThreadPoolExecutor(2) as callers:
        waiting = [callers.submit(rig.coordinator.image, run, "U1", k) for k in (0, 0)]
        rig.wait_for(lambda: len(rig.workers.kept) == 2, "both jobs")
        for number, job in enumerate(reversed(rig.workers.kept)):
            rig.workers.answer(job, Reply(b"%d" % number, None, 0.0))
        assert {w.result(20) for w in waiting} == {b"0", b"1"}


def test_a_refusal_of_the_worker_is_raised_and_a_late_reply_ignored(
    rig: Any, run: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(pictures, "LARGEST_PX", 0)
    monkeypatch.setattr(rig.workers, "submit", lambda job, done: done(Reply.refused(GoneError("it is gone"))))
    with pytest.raises(GoneError, match="it is gone"):
        rig.coordinator.image(run, "U1", 0)
    late: list[Any] = []
    monkeypatch.setattr(rig.workers, "submit", lambda job, done: late.append(done))
    monkeypatch.setattr(pictures, "RENDER_LIMIT_S", 0.01)
    with pytest.raises(DeviceError, match="No worker rendered image U1/0"):
        rig.coordinator.image(run, "U1", 0)
    late[0](Reply(b"late", None, 0.0))
