"""A board that the twin rendered beforehand: all its frames in one flat file, to be mapped by several processes."""

from __future__ import annotations

import hashlib
import mmap
import os
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from vaoi_station.files import read_board_type, read_calibration, write_board_type, write_calibration
from vaoi_station.files.documents import parse, read_json, write_json
from vaoi_station.line_config import Line
from vaoi_station.model import BoardType, Calibration, RecordingHead
from vaoi_station.simulation import Passage, Scenario, Twin

_FRAMES, _HEAD, _LINE, _DIGEST = "frames.raw", "recording.json", "line.json", "scenario.sha256"


@dataclass(frozen=True)
class PrerenderedRun:
    """A directory with the frames of one passage and the documents that a station needs to stitch them.

    The object holds only the path of the directory, so that it can be sent to other processes.
    """

    directory: Path

    @property
    def head(self) -> RecordingHead:
        """The head of the recording: cameras, number of rows, trigger times."""
        return parse(RecordingHead, read_json(self.directory / _HEAD), self.directory / _HEAD)

    @property
    def calibration(self) -> Calibration:
        """Camera matrices N_i and lenses of the twin."""
        return read_calibration(self.directory / "calibration.json")

    @property
    def board_type(self) -> BoardType:
        """CAD data of the board that was rendered."""
        return read_board_type(self.directory / "board.json")

    @property
    def line(self) -> Line:
        """Speed, barrier, delays and trigger period of the simulated line."""
        return parse(Line, read_json(self.directory / _LINE), self.directory / _LINE)

    def map(self) -> NDArray[np.uint8]:
        """Return all frames, (rows, cameras, height, width) uint8, as a read-only memory map."""
        with (self.directory / _FRAMES).open("rb") as file:
            # The array keeps the mapping open after the file is closed; processes share its pages in the page cache.
            memory = mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ)
        return np.frombuffer(memory, np.uint8).reshape(_shape(self.head))


def prerender(scenario: Scenario, directory: Path, report: Callable[[str], None] = lambda _: None) -> PrerenderedRun:
    """Render the first board of a scenario on all cores, unless the directory already holds the same scenario.

    Args:
        scenario: the board and the line.
        directory: where the frames are kept.
        report: called with a sentence before each long step.
    """
    run, digest = PrerenderedRun(directory), hashlib.sha256(scenario.model_dump_json().encode()).hexdigest()
    note = directory / _DIGEST
    if note.is_file() and note.read_text() == digest:
        return run
    passage = Twin(scenario).passage(0)
    head = passage.head()
    report(f"Drawing a board of {scenario.board.width_mm:.0f} × {scenario.board.length_mm:.0f} mm.")
    # These cached properties are computed once here, because the threads below would each compute them.
    _ = passage.twin.scene, passage.placements
    directory.mkdir(parents=True, exist_ok=True)
    # The digest is deleted first and written last, so that an interrupted rendering does not count as complete.
    note.unlink(missing_ok=True)
    report(f"Rendering {head.rows} rows of {len(head.cameras)} cameras.")
    _render(passage, head, directory / _FRAMES)
    write_calibration(directory / "calibration.json", passage.twin.calibration)
    write_board_type(directory / "board.json", passage.twin.board_type)
    write_json(directory / _LINE, passage.twin.line.model_dump(mode="json"))
    write_json(directory / _HEAD, head.model_dump(mode="json", exclude_none=True))
    note.write_text(digest)
    return run


def _render(passage: Passage, head: RecordingHead, path: Path) -> None:
    """Write all frames of a passage into a new file."""
    frames: NDArray[Any] = np.memmap(path, np.uint8, "w+", shape=_shape(head))

    def render(row: int) -> None:
        for camera in range(len(head.cameras)):
            frames[row, camera] = passage.frame(camera, row)

    # Threads, not processes: OpenCV and numpy release the GIL, and the drawn board (gigabytes) exists only once.
    with ThreadPoolExecutor(os.cpu_count()) as pool:
        list(pool.map(render, range(head.rows)))


def _shape(head: RecordingHead) -> tuple[int, int, int, int]:
    camera = head.cameras[0]
    return head.rows, len(head.cameras), camera.height, camera.width
