"""Measure how CPU time and memory of stitching grow with the length of the board. Each length runs in a new process."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Sequence
from concurrent.futures import ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import numpy as np

from vaoi_station.benchmarks.process_usage import private_memory_bytes
from vaoi_station.benchmarks.station_pace import PrerenderedRun, prerender
from vaoi_station.benchmarks.tables import table
from vaoi_station.errors import InternalError
from vaoi_station.runs.host.processes import set_up_process
from vaoi_station.simulation import Scenario

_CAMERAS, _BOARD_WIDTH_MM = 3, 90.0
_OVERLAP = 1.15
"""Width of a camera's view divided by the pitch of the cameras, so that neighbours overlap despite mounting errors."""
_SAMPLE_S = 0.005


@dataclass(frozen=True)
class ScalingFigures:
    """CPU time and memory for stitching one board of a given length. Times are of one thread, without compilation."""

    frames: int
    rows: int
    board_mm: tuple[float, float]
    components: int
    links_ms_per_frame: float
    conclude_ms_per_frame: float
    own_memory_mb: float
    """Increase of the private memory during stitching, at its peak. Frames are mapped files and do not count."""
    frames_mb: float
    status: str
    reasons: tuple[str, ...]


def measure_scaling(
    scenario: Scenario, folder: Path, rows: tuple[int, ...], report: Callable[[str], None]
) -> list[ScalingFigures]:
    """Stitch boards like that of a scenario, each as long as the given number of rows needs; keep them in `folder`."""
    # Each board needs a new process: the allocator keeps freed memory, so a large peak would hide a later smaller one.
    with ProcessPoolExecutor(1, get_context("spawn"), max_tasks_per_child=1) as processes:
        boards = (prerender(long_board(scenario, count), folder / f"{count}", report) for count in rows)
        try:
            return [processes.submit(_stitch, board).result() for board in boards]
        except BrokenProcessPool as end:
            raise InternalError("a process that stitched a board has ended, perhaps because memory was full.") from end


def long_board(scenario: Scenario, rows: int) -> Scenario:
    """Return the scenario with three cameras and a board that takes this number of rows."""
    line, belt = scenario.line, scenario.belt
    # Half a period less than `rows` periods: the board ends safely between two pulses.
    passing_s = (rows - 0.5) * line.period_s + line.start_delay_s - line.tail_s
    length_mm = round(passing_s * belt.speed_mm_s * (1 + belt.speed_error), 1)
    changes: dict[str, dict[str, Any]] = {
        "array": {"cameras": _CAMERAS, "overlap": _OVERLAP},
        "board": {"name": f"long-{rows}", "width_mm": _BOARD_WIDTH_MM, "length_mm": length_mm},
        "line": {"longest_board_mm": length_mm + 2 * line.period_s * belt.speed_mm_s},
    }
    plain = scenario.model_dump()
    return Scenario.model_validate(plain | {name: plain[name] | section for name, section in changes.items()})


def _stitch(board: PrerenderedRun) -> ScalingFigures:
    set_up_process(one_thread=True)
    # Imported after `set_up_process`, because numeric libraries read their number of threads at import.
    import cv2

    from vaoi_station.runs.workers.warmup import warm_up
    from vaoi_station.stitching.expectation import expectation_of
    from vaoi_station.stitching.work import StitchSetup, TaskRunner, all_tasks

    cv2.setNumThreads(1)
    head, frames, board_type = board.head, board.map(), board.board_type
    cameras = board.calibration.cameras(head.cameras)
    expected = expectation_of(board.line, board_type)
    setup = StitchSetup(cameras, head.conveyor_mm_s, head.trigger_period_s, board_type, expected)
    times_s = head.row_times_s()
    present = [(camera, row) for row in range(head.rows) for camera in range(len(cameras))]
    tasks = all_tasks(present, dict(enumerate(times_s)), setup)
    # Compiled functions are loaded before the measurement, because loading would dominate the figures of short boards.
    warm_up()
    with _PeakMemory() as peak:
        runner = TaskRunner(setup, lambda i, j: frames[j, i])
        began_s = time.process_time()
        evidence = [runner.perform(t) for t in tasks]
        linked_s = time.process_time()
        stitch = runner.conclude(times_s, present, evidence)
        ended_s = time.process_time()
    width_mm, length_mm = np.ptp(board_type.extent(), axis=0) * board_type.mm_per_unit
    return ScalingFigures(
        frames=len(present),
        rows=head.rows,
        board_mm=(round(float(width_mm), 1), round(float(length_mm), 1)),
        components=len(board_type.components),
        links_ms_per_frame=round((linked_s - began_s) * 1e3 / len(present), 3),
        conclude_ms_per_frame=round((ended_s - linked_s) * 1e3 / len(present), 3),
        own_memory_mb=round(peak.bytes / 1e6, 1),
        frames_mb=round(frames.nbytes / 1e6, 1),
        status=str(stitch.status),
        reasons=stitch.reasons,
    )


class _PeakMemory:
    """Sampler, in a thread, of this process's private memory. It keeps the largest increase since its start."""

    def __init__(self) -> None:
        self.bytes = 0
        self._ended = threading.Event()
        self._thread = threading.Thread(target=self._watch, name="memory", daemon=True)

    def __enter__(self) -> _PeakMemory:
        self._before = private_memory_bytes()
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._ended.set()
        self._thread.join()

    def _watch(self) -> None:
        # The kernel's own peak (VmHWM) also counts the mapped frames, so the private part is sampled.
        while True:
            self.bytes = max(self.bytes, private_memory_bytes() - self._before)
            if self._ended.wait(_SAMPLE_S):
                return


def scaling_table(figures: Sequence[ScalingFigures]) -> str:
    """Return a table of the scaling figures, with one row per board."""
    head = ("frames", "rows", "board mm", "components", "links ms/frame", "conclude ms/frame", "own MB", "frames MB")
    return table(
        head,
        [
            (
                *(f.frames, f.rows, f"{f.board_mm[0]:.0f} × {f.board_mm[1]:.0f}", f.components),
                *(f"{f.links_ms_per_frame:.2f}", f"{f.conclude_ms_per_frame:.2f}"),
                *(f"{f.own_memory_mb:.1f}", f"{f.frames_mb:.0f}"),
            )
            for f in figures
        ],
    )
