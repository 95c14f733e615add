"""The board on which a benchmark runs: a board of the twin, or a recording. All frames are in memory."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
from numpy.typing import NDArray

from vaoi_station.files import open_recording, read_board_type, read_calibration
from vaoi_station.model import BoardType, Calibration, RecordingHead
from vaoi_station.simulation import Twin, find_scenario, read_scenario
from vaoi_station.stitching.expectation import expected_in
from vaoi_station.stitching.work import StitchSetup


@dataclass(frozen=True, eq=False)
class BenchmarkBoard:
    """Frames of one board by (camera, row), with its calibration and CAD data; the truth only if the twin made it."""

    name: str
    head: RecordingHead
    calibration: Calibration
    board_type: BoardType
    frames: dict[tuple[int, int], NDArray[Any]]
    truth: dict[str, Any] | None

    def frame(self, camera: int, row: int) -> NDArray[Any] | None:
        """Return the pixels of a frame; None if it is missing."""
        return self.frames.get((camera, row))

    @property
    def setup(self) -> StitchSetup:
        """The data that stitching has before the first frame: cameras, belt, trigger period, board type, lights."""
        return StitchSetup(
            self.calibration.cameras(self.head.cameras),
            self.head.conveyor_mm_s,
            self.head.trigger_period_s,
            self.board_type,
            expected_in(self.head),
            lights=self.head.lights or (),
        )


def board_from_twin(scenario: str = "demo", board: int = 0) -> BenchmarkBoard:
    """Render all frames of a board of a scenario, given as the name of a shipped one or as a file."""
    twin = Twin(read_scenario(find_scenario(scenario)))
    passage = twin.passage(board)
    frames = passage.render_all()
    return BenchmarkBoard(
        Path(scenario).stem, passage.head(), twin.calibration, twin.board_type, frames, passage.truth()
    )


def board_from_recording(directory: Path) -> BenchmarkBoard:
    """Read all frames of a recording, with its calibration and board type."""
    recording = open_recording(directory)
    head = recording.head
    calibration = read_calibration(directory / "calibration.json", head.cameras)
    # Frames are decoded here, once: benchmarks measure computation, not reading of files.
    cells = ((i, j) for i in range(len(head.cameras)) for j in range(head.rows))
    frames = {cell: pixels for cell in cells if (pixels := recording.frame(*cell)) is not None}
    return BenchmarkBoard(directory.name, head, calibration, read_board_type(directory / "board.json"), frames, None)


@contextmanager
def one_thread() -> Iterator[None]:
    """Let OpenCV compute in one thread, because ratios compare algorithms."""
    threads = cv2.getNumThreads()
    cv2.setNumThreads(1)
    try:
        yield
    finally:
        cv2.setNumThreads(threads)


def cpu_ms(work: Callable[[], Any]) -> float:
    """Return the CPU time of a call: the machine may be busy with other work."""
    start = time.process_time()
    work()
    return (time.process_time() - start) * 1e3
