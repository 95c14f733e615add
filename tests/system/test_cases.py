"""A station that replays the recording of a real board without pauses."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from tests.needs import LONG
from tests.system.real_board import station_of
from vaoi_station.config import StationConfig
from vaoi_station.files import open_recording
from vaoi_station.geometry import apply
from vaoi_station.runs.control.coordinator import StationCoordinator
from vaoi_station.stitching.work import stitch_frames

TIMEOUT_S = 150.0
RUNS = 20 if LONG else 6
"""Each bay of the ring is used twice."""


@pytest.mark.cases
def test_results_equal_the_offline_result_and_no_frame_is_in_a_wrong_row(
    cases: Callable[[str], Path],
    tmp_path: Path,
    run_station: Callable[[StationConfig], StationCoordinator],
) -> None:
    directory = cases("ulx3s-top")
    coordinator = run_station(station_of(directory, tmp_path, pace="fast", pause_s=0.01, runs=RUNS))
    recording, board_type = open_recording(directory), coordinator.board_types()[0].name
    setup = coordinator._make_order(coordinator.board_type(board_type), None, None).setup
    expected = stitch_frames(setup, recording.head, recording.frame)
    recorded = {
        (camera, row): recording.frame(camera, row)
        for camera in range(len(recording.head.cameras))
        for row in range(recording.head.rows)
    }
    before = coordinator.snapshot().last_event
    coordinator.arm(board_type, runs=RUNS)
    seen: list[str] = []
    while len(seen) < RUNS:
        records = coordinator.events(before, TIMEOUT_S)
        assert records, coordinator.snapshot()
        before = records[-1].number
        for run in [r.run for r in records if r.kind == "run" and r.state in ("ready", "degraded", "failed") and r.run]:
            seen.append(run)
            stitch = coordinator.stitch(run)
            assert stitch.status == expected.status
            for n, rows in enumerate(expected.image_matrices):
                camera = recording.head.cameras[n]
                corners = np.array([[0, 0], [camera.width - 1, 0], [camera.width - 1, camera.height - 1]], dtype=float)
                for j, matrix in enumerate(rows):
                    ours = stitch.image_matrices[n][j]
                    assert matrix is not None
                    assert ours is not None
                    assert np.abs(apply(ours @ np.linalg.inv(matrix), corners) - corners).max() <= 1e-6
            check_frames(coordinator, run, recorded)
    assert coordinator.snapshot().boards_missed == 0


def check_frames(coordinator: StationCoordinator, run: str, recorded: dict[tuple[int, int], np.ndarray | None]) -> None:
    """Check that each frame still in memory is that of the recording."""
    from vaoi_station.errors import GoneError

    for (camera, row), pixels in recorded.items():
        try:
            ours, record = coordinator.frame(run, camera, row)
        except GoneError:
            return
        assert (record.camera, record.row) == (camera, row)
        assert pixels is not None
        assert np.array_equal(ours, pixels)
