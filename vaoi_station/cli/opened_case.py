"""A recording with its board type, its cameras and the result of stitching, as several commands open it."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from vaoi_station.errors import InputError
from vaoi_station.files import Recording, open_recording, read_board_type, read_calibration, read_stitch
from vaoi_station.files.results import read_heights
from vaoi_station.geometry import Camera
from vaoi_station.library.recordings import check_result
from vaoi_station.model import BoardType, Stitch
from vaoi_station.model.stitch_result import with_heights
from vaoi_station.stitching.recordings.origin import check_origin

_KEPT_FRAMES = 96
"""Number of frames that are kept in memory, so that frames that show many components are read once."""


@dataclass(frozen=True)
class Case:
    """A recording with its board type, its cameras and the result of stitching."""

    recording: Recording
    board_type: BoardType
    cameras: Sequence[Camera]
    stitch: Stitch

    @classmethod
    def open(
        cls, case: Path, result: Path, calibration: Path | None, board: Path | None, heights: Path | None = None
    ) -> Case:
        """Open a recording; refuse a result that belongs to another one.

        `heights` is a file of `vaoi heights`; its heights replace those of the result.
        """
        recording = open_recording(case)
        head = recording.head
        known = read_calibration(calibration or case / "calibration.json", head.cameras)
        cameras = known.cameras(head.cameras)
        board_type = read_board_type(board or case / "board.json")
        stitch = read_stitch(result)
        check_result(stitch, head.rows, cameras, result)
        check_origin(stitch, recording, known, board_type, result)
        measured = {} if heights is None else read_heights(heights, board_type)
        return cls(recording, board_type, cameras, with_heights(stitch, measured))

    @cached_property
    def frame(self) -> Callable[[int, int], NDArray[Any] | None]:
        """Function that reads a frame (camera, row), None if it is missing; it keeps those that were used last."""
        return lru_cache(_KEPT_FRAMES)(self.recording.frame)

    @cached_property
    def px_per_mm(self) -> float:
        """Mean resolution of the cameras."""
        return float(np.mean([c.px_per_mm for c in self.cameras]))


def refuse_input(out: Path, case: Path, result: Path, calibration: Path | None, board: Path | None) -> None:
    """Raise InputError if a command would overwrite what it reads."""
    inputs = {calibration or case / "calibration.json", board or case / "board.json", case / "recording.json", result}
    if out.resolve() in {path.resolve() for path in inputs}:
        raise InputError(f"{out}: is read by this command and is not overwritten.", action="Give another --out.")
