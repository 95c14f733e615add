"""A whole station in real time: prerendered boards, the sender, the figures."""

from __future__ import annotations

import math
import multiprocessing
from collections.abc import Iterator
from dataclasses import replace
from multiprocessing.connection import Connection
from queue import SimpleQueue
from typing import TYPE_CHECKING, Any, cast

import numpy as np
import pytest

from vaoi_station.acquisition.cameras.interface import CameraEvent, Slot
from vaoi_station.acquisition.controller.interface import EventQueue, PulseFired, RunEnded, TriggerPlan
from vaoi_station.benchmarks.station_pace import (
    BoardFigures,
    PrerenderedRun,
    RateFigures,
    StationUsage,
    measure_station_pace,
    rate_figures,
    sender_devices,
)
from vaoi_station.config import StationConfig

if TYPE_CHECKING:
    Pipe = Connection[Any, Any]


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
