"""A whole station in real time: prerendered boards, the sender, the figures."""

from __future__ import annotations

import json
import math
import multiprocessing
from collections.abc import Iterator
from dataclasses import replace
from multiprocessing.connection import Connection
from pathlib import Path
from queue import SimpleQueue
from typing import TYPE_CHECKING, Any, cast

import numpy as np
import pytest

from vaoi_station.acquisition.cameras.interface import Arrival, CameraEvent, Slot
from vaoi_station.acquisition.clocks import DeviceClock
from vaoi_station.acquisition.controller.interface import EventQueue, PulseFired, RunEnded, TriggerPlan
from vaoi_station.acquisition.ring import FrameShape, Ring, RingLayout
from vaoi_station.benchmarks.station_pace import (
    BoardFigures,
    FillRequest,
    PrerenderedRun,
    RateFigures,
    SenderCamera,
    SenderConnection,
    StationUsage,
    board_figures,
    measure_station_pace,
    process_table,
    rate_figures,
    run_frame_sender,
    sender_devices,
    station_table,
)
from vaoi_station.config import StationConfig
from vaoi_station.runs.states.schemas import RunDetail, TaskTiming, Timeline, Timings, VerdictCounts
from vaoi_station.simulation import Scenario, Twin

if TYPE_CHECKING:
    Pipe = Connection[Any, Any]


def test_frames_and_documents_are_those_of_the_twin(small_run: PrerenderedRun, scenario: Scenario) -> None:
    passage, frames = Twin(scenario).passage(0), small_run.map()
    assert frames.shape == (passage.rows, 2, 480, 640)
    for camera, row in ((0, 0), (1, 3)):
        assert np.array_equal(frames[row, camera], passage.frame(camera, row))
    assert small_run.head == passage.head()
    assert small_run.line == passage.twin.line
    assert small_run.board_type == passage.twin.board_type
    assert len(small_run.calibration.cameras(small_run.head.cameras)) == 2


def test_requested_slots_are_filled_and_the_requests_returned(small_run: PrerenderedRun, tmp_path: Path) -> None:
    layout = RingLayout(1, 3, (FrameShape(640, 480, "Mono8"), FrameShape(640, 480, "Mono8")))
    path, frames = tmp_path / "vaoi-test.ring", small_run.map()
    with Ring.create(path, layout) as ring:
        with run_frame_sender(small_run) as (pid, sender):
            sender.send(str(path))
            requests = [FillRequest(camera, row, ring.slot(0, camera, 2 - row)) for camera in (0, 1) for row in (0, 2)]
            for request in requests:
                sender.send(request)
            assert [sender.recv() for _ in requests] == requests
            assert Path(f"/proc/{pid}").exists()
        assert not Path(f"/proc/{pid}").exists(), "the process ends with its pipe"
        for r in requests:
            assert np.array_equal(ring.frame(r.slot), frames[r.row, r.camera])
        assert not ring.frame(ring.slot(0, 0, 1)).any(), "other slots are not written"


TIMEOUT_S = 20.0


@pytest.fixture
def pipe() -> Iterator[tuple[Pipe, Pipe]]:
    """Return the end of the devices and that of the sender."""
    here, there = multiprocessing.Pipe()
    yield here, there
    there.close()


@pytest.fixture
def arrivals() -> SimpleQueue[CameraEvent]:
    return SimpleQueue()


def slot(number: int) -> Slot:
    return Slot(number, np.zeros(4, np.uint8))


def test_frame_arrives_when_the_sender_returns_its_request(
    pipe: tuple[Pipe, Pipe], arrivals: SimpleQueue[CameraEvent]
) -> None:
    camera = SenderCamera(3, DeviceClock(), SenderConnection(pipe[0]))
    camera.start(arrivals)
    camera.queue(slot(17))
    camera.trigger(5, 1.25)
    request = pipe[1].recv()
    assert request == FillRequest(camera=3, row=5, slot=17)
    assert arrivals.empty()
    pipe[1].send(request)
    arrival = arrivals.get(timeout=TIMEOUT_S)
    assert isinstance(arrival, Arrival)
    assert (arrival.camera, arrival.slot, arrival.complete) == (3, 17, True)
    assert (arrival.frame_id, arrival.time_s) == (1, 1.25)
    assert camera.health().delivered == 1


def test_controller_repeats_the_run_at_the_requested_rate(pipe: tuple[Pipe, Pipe], small_run: PrerenderedRun) -> None:
    rate, rows = 8.0, small_run.head.rows
    devices = sender_devices(small_run, rate, pipe[0], cast("StationConfig", None))
    arrivals: SimpleQueue[CameraEvent] = SimpleQueue()
    for n, camera in enumerate(devices.cameras):
        camera.start(arrivals)
        for k in range(2 * rows):
            camera.queue(slot(100 * n + k))
    events: EventQueue = SimpleQueue()
    devices.controller.start(events)
    devices.controller.arm(TriggerPlan(0.01, 0.02, 0.01, rows, 0.005))
    seen: list[object] = []
    try:
        while sum(isinstance(e, RunEnded) for e in seen) < 2:
            seen.append(events.get(timeout=TIMEOUT_S))
    finally:
        devices.controller.close()
    requests = []
    while pipe[1].poll():
        requests.append(pipe[1].recv())
    assert [(r.row, r.camera) for r in requests[: 4 * rows]] == [(j, i) for j in range(rows) for i in (0, 1)] * 2
    times_s = np.array([e.time_s for e in seen if isinstance(e, PulseFired)])
    expected_s = small_run.head.row_times_s() / rate
    for run in (times_s[:rows], times_s[rows : 2 * rows]):
        assert run - run[0] == pytest.approx(expected_s - expected_s[0], abs=1e-6)


BOARDS, RATE = 2, 2.0
BOARD = BoardFigures("finished", "ok", 12, 0, 40.0, 25.0, 1, 10.0, 11.0)
USAGE = StationUsage(0.5, 0, {"station": 0.2, "worker 0": 1.0, "sender": 0.3}, {"station": 80.0})


def run_detail(rows: int, timings: Timings, counts: VerdictCounts) -> RunDetail:
    """Return the part of a run's details from which figures are computed."""
    part: dict[str, Any] = {"state": "finished", "verdict": "ok", "rows": rows, "counts": counts, "timings": timings}
    return RunDetail.model_construct(**part)


def task(row: int, other_row: int | None, ready_s: float, done_s: float) -> TaskTiming:
    other_camera = None if other_row is None else 0
    return TaskTiming(
        kind="links",
        camera=0,
        row=row,
        other_camera=other_camera,
        other_row=other_row,
        ready_s=ready_s,
        done_s=done_s,
        worker_ms=1,
    )


def timings(ready_ms: float | None) -> Timings:
    return Timings(
        filming_s=1, ready_after_last_frame_ms=ready_ms, links_ms=4, conclude_ms=7.126, links=4, links_while_filming=2
    )


def test_figures_of_a_board_come_from_the_times_of_its_tasks() -> None:
    tasks = (
        task(0, None, 0.1, 0.11),
        task(0, 1, 0.2, 0.23),
        task(1, 2, 0.3, 0.38),
        task(2, 3, 0.4, 0.50),
        task(1, None, 0.2, 0.42),
    )
    timeline = Timeline(frames_settled_s=(), tasks=tasks, last_frame_s=0.4, ready_s=0.55)
    counts = VerdictCounts.model_construct(ok=7, missing=2, incomplete=1)
    figures = board_figures(run_detail(4, timings(52.0), counts), timeline)
    assert (figures.frames, figures.lost, figures.status) == (7, 3, "ok")
    assert (figures.ready_after_last_frame_ms, figures.conclude_ms) == (52.0, 7.13)
    assert figures.links_open_at_last_frame == 1, "tasks of the last row do not count"
    assert figures.lag_first_half_ms == pytest.approx(30.0), "10, 30 and 220 ms"
    assert figures.lag_second_half_ms == pytest.approx(90.0), "80 and 100 ms"


def test_figures_of_a_rate_relate_cpu_time_to_frames_and_passing_time(small_run: PrerenderedRun) -> None:
    head = small_run.head
    slow = replace(BOARD, ready_after_last_frame_ms=90.0, status="degraded")
    figures = rate_figures(head, 2.0, (BOARD, BOARD, slow), USAGE)
    assert figures.frames_per_s == pytest.approx(2 / head.trigger_period_s, abs=0.01)
    assert figures.ready_after_last_frame_ms == {"median": 40.0, "p99": 90.0, "max": 90.0}
    assert figures.statuses == {"degraded": 1, "ok": 2}
    passing_s = 36 / (2 / head.trigger_period_s * 2)
    assert figures.cores == pytest.approx(1.2 / passing_s, abs=1e-3), "without the sender"
    assert figures.sender_cores == pytest.approx(0.3 / passing_s, abs=1e-3)
    assert figures.cpu_ms_per_frame["worker 0"] == pytest.approx(1000 / 36, abs=1e-3)
    assert figures.document()["each"][2]["status"] == "degraded"


@pytest.mark.parametrize(
    ("board", "missed", "kept_up"),
    [
        (BOARD, 0, True),
        (replace(BOARD, links_open_at_last_frame=4), 0, True),
        (replace(BOARD, links_open_at_last_frame=5), 0, False),
        (replace(BOARD, lost=1), 0, False),
        (BOARD, 1, False),
    ],
)
def test_station_keeps_up_without_losses_and_with_at_most_one_row_of_open_links(
    small_run: PrerenderedRun, board: BoardFigures, missed: int, kept_up: bool
) -> None:
    usage = USAGE._replace(boards_missed=missed)
    assert rate_figures(small_run.head, 1.0, (BOARD, board), usage).kept_up is kept_up


@pytest.mark.parametrize("boards", [(), (replace(BOARD, frames=0, lost=12),)])
def test_figures_without_boards_or_frames_are_absent_and_do_not_count_as_kept_up(
    small_run: PrerenderedRun, boards: tuple[BoardFigures, ...]
) -> None:
    usage = USAGE._replace(memory_mb=dict.fromkeys(USAGE.cpu_s, 80.0))
    figures = rate_figures(small_run.head, 1.0, boards, usage)
    assert not figures.kept_up
    assert math.isnan(figures.cores)
    document = figures.document()
    assert document["cpu_ms_per_frame"]["worker 0"] is None
    json.dumps(document, allow_nan=False)
    assert "nan" not in station_table([figures]) + process_table([figures])


@pytest.fixture(scope="module")
def figures(small_run: PrerenderedRun, tmp_path_factory: pytest.TempPathFactory) -> Iterator[RateFigures]:
    folder = tmp_path_factory.mktemp("station")
    yield measure_station_pace(small_run, RATE, BOARDS, 2, folder, folder)
    assert not list(folder.glob("*.ring")), "the ring is removed with the station"


def test_running_station_stitches_all_boards(figures: RateFigures) -> None:
    assert len(figures.each) == BOARDS
    for board in figures.each:
        assert (board.status, board.frames, board.lost) == ("ok", 12, 0)
        assert 0 < board.conclude_ms < board.ready_after_last_frame_ms
        assert board.lag_first_half_ms > 0
    assert figures.statuses == {"ok": BOARDS}
    assert figures.frames_lost == 0
    assert math.isfinite(figures.lag_second_half_ms)
    names = {"station", "sender", "acquisition", "fork server", "worker 0", "worker 1"}
    assert figures.cpu_ms_per_frame.keys() == figures.memory_mb.keys() == names
