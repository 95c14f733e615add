"""A station that replays recordings: each run equals the offline result, and memory does not grow."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from tests.system.conftest import config_of, until_state
from vaoi_station.config import ReplayConfig, StationConfig
from vaoi_station.files import Recording, open_recording
from vaoi_station.geometry import apply
from vaoi_station.model import Stitch
from vaoi_station.rendering import Framing, ImageRequest
from vaoi_station.runs.control.coordinator import StationCoordinator
from vaoi_station.runs.states.schemas import RunDetail
from vaoi_station.simulation import Twin
from vaoi_station.station import Station
from vaoi_station.stitching.work import StitchSetup, stitch_frames

TIMEOUT_S = 150.0
RunStation = Callable[[StationConfig], StationCoordinator]


def offline(coordinator: StationCoordinator, recording: Recording) -> Stitch:
    """Return the offline result of the recording with the prior knowledge of the station."""
    order = coordinator._make_order(coordinator.board_type("small"), None, None)
    setup: StitchSetup = order.setup
    return stitch_frames(setup, recording.head, recording.frame)


def follow(coordinator: StationCoordinator, count: int) -> list[RunDetail]:
    """Return the next `count` runs, in the order in which they ended."""
    runs: list[RunDetail] = []
    after = None
    while len(runs) < count:
        run = coordinator.next_run(after, TIMEOUT_S)
        assert run is not None, coordinator.snapshot()
        runs.append(run)
        after = run.id
    return runs


def corners_apart_px(a: Stitch, b: Stitch, width: int, height: int) -> float:
    """Return the largest difference between two results at the corners of the frames, px."""
    corners = np.array([[0, 0], [width - 1, 0], [width - 1, height - 1], [0, height - 1]], dtype=float)
    worst = 0.0
    for row_a, row_b in zip(a.image_matrices, b.image_matrices, strict=True):
        for m_a, m_b in zip(row_a, row_b, strict=True):
            assert (m_a is None) == (m_b is None)
            if m_a is not None and m_b is not None:
                worst = max(worst, float(np.abs(apply(m_b @ np.linalg.inv(m_a), corners) - corners).max()))
    return worst


def test_every_run_equals_the_offline_result_and_memory_does_not_grow(
    replay_config: Callable[..., StationConfig],
    run_station: RunStation,
    recordings: tuple[Path, Path],
    twin: Twin,
) -> None:
    coordinator = run_station(replay_config(pace="fast", pause_s=0.01, runs=20))
    opened = [open_recording(path) for path in recordings]
    expected = [offline(coordinator, recording) for recording in opened]
    coordinator.arm("small", "board", "job", runs=20)
    array, resources = twin.scenario.array, []
    runs: list[RunDetail] = []
    after: str | None = None
    while len(runs) < 20:
        run = coordinator.next_run(after, TIMEOUT_S) if after else first_run(coordinator)
        assert run is not None, coordinator.snapshot()
        truth = expected[len(runs) % 2]
        stitch = coordinator.stitch(run.id)
        assert stitch.status == truth.status, stitch.reasons
        assert corners_apart_px(stitch, truth, array.width_px, array.height_px) <= 1e-6
        assert stitch.cad_matrix is not None
        assert truth.cad_matrix is not None
        assert np.allclose(stitch.cad_matrix, truth.cad_matrix, rtol=0, atol=1e-7)
        assert (run.board_id, run.job_id, run.counts.missing) == (
            "board",
            "job",
            len(opened[len(runs) % 2].head.missing),
        )
        runs.append(run)
        after = run.id
        resources.append(held(coordinator))
    assert [run.id for run in runs] == sorted(run.id for run in runs)
    early, late = resources[7], resources[-1]
    assert late["ring"] == early["ring"]
    assert late["descriptors"] <= early["descriptors"] + 2
    assert late["resident"] <= early["resident"] + 40 * 2**20, "station and children together"


def first_run(coordinator: StationCoordinator) -> RunDetail | None:
    """Wait for the first run; `next_run` needs the id of an earlier one."""
    seen = 0
    while coordinator.latest() is None:
        records = coordinator.events(seen, TIMEOUT_S)
        assert records
        seen = records[-1].number
    ids = [run.id for run in coordinator.runs(1000)]
    return coordinator.run(ids[-1])


def held(coordinator: StationCoordinator) -> dict[str, int]:
    """Return the shared memory, open files and resident memory of all processes of the station."""
    snapshot = coordinator.snapshot()
    pids = [os.getpid(), *(p.pid for p in snapshot.processes if p.pid)]
    pages = sum(int(Path(f"/proc/{pid}/statm").read_text().split()[1]) for pid in pids)
    shared = sum(int(Path(f"/proc/{pid}/statm").read_text().split()[2]) for pid in pids)
    return {
        "ring": sum(path.stat().st_size for path in Path(snapshot.ring.path).parent.iterdir()),
        "descriptors": sum(len(list(Path(f"/proc/{pid}/fd").iterdir())) for pid in pids),
        "resident": (pages - shared) * os.sysconf("SC_PAGE_SIZE"),
    }


@pytest.fixture(scope="module")
def filmed(
    twin: Twin, recordings: tuple[Path, Path], tmp_path_factory: pytest.TempPathFactory
) -> Iterator[tuple[StationCoordinator, RunDetail]]:
    """A station that has filmed two boards at the recorded pace, and its second run."""
    replay = ReplayConfig(recordings=recordings, pace="original", pause_s=0.2)
    with Station(config_of(twin, tmp_path_factory.mktemp("filmed"), "replay", replay=replay)) as station:
        until_state(station.coordinator, "idle")
        station.coordinator.arm("small", runs=2)
        warm_up, run = follow(station.coordinator, 2)
        assert warm_up.id < run.id
        yield station.coordinator, run


def test_links_of_all_earlier_rows_exist_when_the_last_row_arrives(
    filmed: tuple[StationCoordinator, RunDetail],
) -> None:
    coordinator, run = filmed
    timeline = coordinator.timeline(run.id)
    last = run.rows - 1
    last_row_s = max(at for _, row, at in timeline.frames_settled_s if row == last)
    earlier = [t for t in timeline.tasks if last not in (t.row, t.other_row)]
    assert {t.row for t in earlier} == set(range(last))
    late = [t for t in earlier if t.done_s >= last_row_s]
    assert not late, f"{len(late)} of {len(earlier)} links came after the last row at {last_row_s} s: {late[:3]}"
    assert run.timings is not None
    assert run.timings.links_while_filming >= len(earlier)


def test_frames_and_pictures_of_a_run(
    filmed: tuple[StationCoordinator, RunDetail], recordings: tuple[Path, Path]
) -> None:
    coordinator, run = filmed
    opened = [open_recording(path) for path in recordings]
    middle, _ = coordinator.frame(run.id, 0, run.rows // 2)
    [recording] = [r for r in opened if np.array_equal(recorded(r, 0, run.rows // 2), middle)]
    assert len(run.frames) == len(recording.head.cameras) * recording.head.rows
    [bay] = [b for b in coordinator.snapshot().ring.bays if b.run == run.id]
    assert (run.bay, run.generation) == (bay.bay, bay.generation)
    for frame in run.frames:
        pixels = recorded(recording, frame.camera, frame.row)
        assert np.array_equal(coordinator.frame(run.id, frame.camera, frame.row)[0], pixels)
        # A tester on the same PC finds them in shared memory by the numbers that REST gives.
        assert frame.slot is not None
        assert np.array_equal(in_memory(coordinator.snapshot().ring.path, run, frame.slot), pixels)
    seen: Any = [c for c in coordinator.components(run.id) if c.views]
    assert seen
    address = seen[0].address
    views = [choice.view for choice in coordinator.images(run.id, address).chosen]
    png = coordinator.image(run.id, address, 0)
    picture = decoded(png)
    assert picture.shape == (views[0].height, views[0].width)
    assert picture.std() > 1
    twice = coordinator.image(run.id, address, 0, ImageRequest(Framing(2 * views[0].px_per_mm)))
    assert decoded(twice).shape[1] == pytest.approx(2 * views[0].width, abs=1)


def in_memory(path: str, run: RunDetail, slot: int) -> NDArray[Any]:
    """Read a frame from the ring's file as docs/reference/ring.md describes it, with the check of the generation."""
    header = np.fromfile(path, "<u8", 13)
    size_bytes, bays, first = int(header[8]), int(header[10]), int(header[12])
    assert run.bay is not None
    generation = np.fromfile(path, "<u8", 1, offset=bays + 16 * run.bay)[0]
    assert generation == run.generation
    width, height = np.fromfile(path, "<u4", 2, offset=int(header[9]))
    return np.fromfile(path, np.uint8, width * height, offset=first + slot * size_bytes).reshape(height, width)


def recorded(recording: Recording, camera: int, row: int) -> NDArray[Any]:
    pixels = recording.frame(camera, row)
    assert pixels is not None
    return pixels


def decoded(png: bytes) -> NDArray[Any]:
    return np.asarray(cv2.imdecode(np.frombuffer(png, np.uint8), cv2.IMREAD_UNCHANGED))
