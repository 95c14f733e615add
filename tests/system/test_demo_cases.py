"""The service replays a real board at its recorded pace, over HTTP: results, delays and use of resources."""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.needs import LONG
from tests.system.real_board import BAYS, station_of
from vaoi_station.config import StationConfig, read_config
from vaoi_station.demo.client import Client
from vaoi_station.demo.service import Service
from vaoi_station.demo.station_files import to_toml
from vaoi_station.demo.waiting import wait_for_run, wait_until_idle
from vaoi_station.files import Recording, open_recording, read_board_type, read_calibration
from vaoi_station.geometry import apply
from vaoi_station.model import Stitch
from vaoi_station.stitching.expectation import expectation_of
from vaoi_station.stitching.work import StitchSetup, stitch_frames

RUNS, WARM = (20, 7) if LONG else (8, 4)
"""Number of runs, and of those after which memory and open files may no longer grow."""
SANE_MS = 5000.0
"""Limit for the delay on a machine with other load; the measured figure is printed."""


def station_toml(case: Path, directory: Path) -> Path:
    path = directory / "station.toml"
    config = station_of(case, directory, pace="original", pause_s=0.2, runs=RUNS)
    path.write_text(to_toml(config), encoding="utf-8")
    return path


def offline(config: StationConfig, case: Path) -> Stitch:
    """Return the offline result of the same frames with the same prior knowledge."""
    recording, board_type = open_recording(case), read_board_type(case / "board.json")
    setup = StitchSetup(
        cameras=read_calibration(config.calibration, len(config.cameras)).cameras(recording.head.cameras),
        conveyor_mm_s=config.line.conveyor_mm_s,
        trigger_period_s=config.line.trigger_period_s,
        board_type=board_type,
        expectation=expectation_of(config.line, board_type),
    )
    return stitch_frames(setup, recording.head, recording.frame)


@pytest.mark.cases
def test_boards_at_the_recorded_pace_give_the_offline_result_in_time(
    cases: Callable[[str], Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    case = cases("ulx3s-top")
    path = station_toml(case, tmp_path)
    expected, recording = offline(read_config(path), case), open_recording(case)
    waits_ms: list[float] = []
    held: list[dict[str, int]] = []
    with Service(path) as service:
        client = Client(service.address)
        wait_until_idle(client)
        [board_type] = client.get("/board-types")["board_types"]
        client.post("/station/arm", board_type=board_type["name"], runs=RUNS)
        after = None
        for _ in range(RUNS):
            run = wait_for_run(client, after)
            after = run["id"]
            assert (run["verdict"], run["counts"]["ok"]) == (expected.status, 18), run["reasons"]
            assert apart_px(client.get(f"/runs/{after}/matrices"), expected, recording) <= 1e-6
            waits_ms.append(run["timings"]["ready_after_last_frame_ms"])
            held.append(resources(client, service.pid, tmp_path / "shm"))
        assert client.get("/station")["boards_missed"] == 0
        # The frames of the last runs stay in memory, as no board follows. A client that fetched the frames of each run
        # would have to be faster than the line, which no machine with other load guarantees.
        held_runs = [run["id"] for run in client.get("/runs")["runs"] if run["frames_available"]]
        assert len(held_runs) == BAYS
        for run in held_runs:
            check_frames(client, run, recording)
    with capsys.disabled():
        print(f"\nmatrices after the last frame: median {np.median(waits_ms):.0f} ms, "
              f"p99 {np.percentile(waits_ms, 99):.0f} ms, first {waits_ms[0]:.0f} ms")  # fmt: skip
    assert np.percentile(waits_ms, 99) < SANE_MS
    assert held[-1]["shared"] == held[WARM]["shared"]
    assert held[-1]["descriptors"] <= held[WARM]["descriptors"] + 2
    assert held[-1]["resident"] <= held[WARM]["resident"] + 40 * 2**20, "station and children together"
    assert list((tmp_path / "shm").iterdir()) == []


def apart_px(document: dict[str, Any], expected: Stitch, recording: Recording) -> float:
    """Return the largest difference between two results at the corners of the frames, px."""
    worst = 0.0
    for camera, (ours, theirs) in enumerate(zip(document["image_matrices"], expected.image_matrices, strict=True)):
        head = recording.head.cameras[camera]
        w, h = head.width - 1, head.height - 1
        corners = np.array([[0, 0], [w, 0], [w, h], [0, h]], dtype=np.float64)
        for a, b in zip(ours, theirs, strict=True):
            assert b is not None
            worst = max(worst, float(np.abs(apply(np.array(a) @ np.linalg.inv(b), corners) - corners).max()))
    return worst


def check_frames(client: Client, run: str, recording: Recording) -> None:
    """Check that each frame of the run is that of the recording."""
    client.act("PUT", f"/runs/{run}/hold", holder="test")
    for camera, head in enumerate(recording.head.cameras):
        for row in range(recording.head.rows):
            raw = client.content(f"/runs/{run}/frames/{camera}/{row}", format="raw")
            filmed = recording.frame(camera, row)
            assert filmed is not None
            assert np.array_equal(np.frombuffer(raw, filmed.dtype).reshape(head.height, head.width), filmed)
    client.post(f"/runs/{run}/release?holder=test")


def resources(client: Client, pid: int, shared: Path) -> dict[str, int]:
    """Return the shared memory, open files and resident memory of all processes of the service."""
    pids = [pid, *(p["pid"] for p in client.get("/station")["processes"])]
    sizes = [[int(v) for v in Path(f"/proc/{p}/statm").read_text().split()] for p in pids]
    return {
        "shared": sum(path.stat().st_size for path in shared.iterdir()),
        "descriptors": sum(len(list(Path(f"/proc/{p}/fd").iterdir())) for p in pids),
        "resident": sum(size[1] - size[2] for size in sizes) * os.sysconf("SC_PAGE_SIZE"),
    }
