"""The sender process fills slots of the ring."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from vaoi_station.acquisition.ring.ring import Ring
from vaoi_station.acquisition.ring.ring_layout import FrameShape, RingLayout
from vaoi_station.benchmarks.station.frame_sender import FillRequest, run_frame_sender
from vaoi_station.benchmarks.station.prerendered_run import PrerenderedRun


def test_requested_slots_are_filled_and_the_requests_returned(small_run: PrerenderedRun, tmp_path: Path) -> None:
    layout = RingLayout(1, 3, (FrameShape(640, 480, "Mono8"), FrameShape(640, 480, "Mono8")))
    path, frames = tmp_path / "vaoi-test.ring", small_run.map()
    with Ring.create(path, layout) as ring:
        with run_frame_sender(small_run) as sender:
            sender.connection.send(str(path))
            requests = [FillRequest(camera, row, ring.slot(0, camera, 2 - row)) for camera in (0, 1) for row in (0, 2)]
            for request in requests:
                sender.connection.send(request)
            assert [sender.connection.recv() for _ in requests] == requests
            assert Path(f"/proc/{sender.pid}").exists()
        assert not Path(f"/proc/{sender.pid}").exists(), "the process ends with its pipe"
        for r in requests:
            assert np.array_equal(ring.frame(r.slot), frames[r.row, r.camera])
        assert not ring.frame(ring.slot(0, 0, 1)).any(), "other slots are not written"


def test_sender_without_a_ring_ends_with_its_pipe(small_run: PrerenderedRun) -> None:
    with run_frame_sender(small_run) as sender:
        pid = sender.pid
    assert not Path(f"/proc/{pid}").exists()
