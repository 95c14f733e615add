"""A board filmed beforehand: all its frames in one flat file, to be mapped by whoever plays them."""

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

from vaoi_station.config import Line
from vaoi_station.files import read_board_type, read_calibration, write_board_type, write_calibration
from vaoi_station.files.documents import parse, read_json, write_json
from vaoi_station.model import BoardType, Calibration, RecordingHead
from vaoi_station.simulation import Passage, Scenario, Twin

_FRAMES, _HEAD, _LINE, _SCENARIO = "frames.raw", "recording.json", "line.json", "scenario.sha256"


@dataclass(frozen=True)
class Film:
    """A directory with the frames of one passage, (rows, cameras, h, w) uint8, and what was known of it beforehand."""

    directory: Path

    @property
    def head(self) -> RecordingHead:
        """What was filmed."""
        return parse(RecordingHead, read_json(self.directory / _HEAD), self.directory / _HEAD)

    @property
    def calibration(self) -> Calibration:
        """That of the array."""
        return read_calibration(self.directory / "calibration.json")

    @property
    def board_type(self) -> BoardType:
        """What was on the belt."""
        return read_board_type(self.directory / "board.json")

    @property
    def line(self) -> Line:
        """The mechanics of the line it was filmed on."""
        return parse(Line, read_json(self.directory / _LINE), self.directory / _LINE)

    def map(self) -> NDArray[np.uint8]:
        """All frames, (rows, cameras, h, w), read-only; nothing is copied."""
        with (self.directory / _FRAMES).open("rb") as file:
            memory = mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ)
        return np.frombuffer(memory, np.uint8).reshape(_shape(self.head))


def film(scenario: Scenario, directory: Path, tell: Callable[[str], None] = lambda _: None) -> Film:
    """The first board of a scenario, rendered on all cores; kept films of the same scenario are used again."""
    made, digest = Film(directory), hashlib.sha256(scenario.model_dump_json().encode()).hexdigest()
    note = directory / _SCENARIO
    if note.is_file() and note.read_text() == digest:
        return made
    passage = Twin(scenario).passage(0)
    head = passage.head()
    tell(f"Drawing a board of {scenario.board.width_mm:.0f} × {scenario.board.length_mm:.0f} mm.")
    _ = passage.twin.scene, passage.placements
    directory.mkdir(parents=True, exist_ok=True)
    note.unlink(missing_ok=True)
    tell(f"Filming {head.rows} rows of {len(head.cameras)} cameras.")
    _render(passage, head, directory / _FRAMES)
    write_calibration(directory / "calibration.json", passage.twin.calibration)
    write_board_type(directory / "board.json", passage.twin.board_type)
    write_json(directory / _LINE, passage.twin.line.model_dump(mode="json"))
    write_json(directory / _HEAD, head.model_dump(mode="json", exclude_none=True))
    note.write_text(digest)
    return made


def _render(passage: Passage, head: RecordingHead, path: Path) -> None:
    """Threads suffice: OpenCV and numpy do the work, and the drawn board is there only once."""
    frames: NDArray[Any] = np.memmap(path, np.uint8, "w+", shape=_shape(head))

    def render(row: int) -> None:
        for camera in range(len(head.cameras)):
            frames[row, camera] = passage.frame(camera, row)

    with ThreadPoolExecutor(os.cpu_count()) as pool:
        list(pool.map(render, range(head.rows)))


def _shape(head: RecordingHead) -> tuple[int, int, int, int]:
    camera = head.cameras[0]
    return head.rows, len(head.cameras), camera.height, camera.width
