"""The stitching of this station: raw frames, calibration, nominal belt speed; offline, one task after the other."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from vaoi_station.model import BoardType, Calibration, RecordingHead
from vaoi_station.stitching.work import StitchSetup, stitch_frames

from ..adapter import Setting
from ..strip import Floats, Matrices, Strip

PACKAGES = ("numpy", "opencv-python-headless", "numba")
SETTINGS = {
    "frames alone, like the peers": Setting({"cad": False}),
    "with fiducials, CAD mapping, surface and heights": Setting({"cad": True}),
}


@dataclass(frozen=True, eq=False)
class _Known:
    head: RecordingHead
    calibration: Calibration
    board_type: BoardType
    cells: list[tuple[int, int]]
    raw: dict[tuple[int, int], NDArray[np.uint8]]
    tester_from_flat: Floats


def prepare(strip: Strip, directory: Path) -> _Known:
    """Read the station's input: raw frames and calibration."""
    cv2.setNumThreads(1)
    known, arrays = json.loads((directory / "ours.json").read_text()), np.load(directory / "ours.npz")
    cells = [(int(i), int(j)) for i, j in strip.cells]
    return _Known(
        RecordingHead.model_validate(known["head"]),
        Calibration.model_validate(known["calibration"]),
        BoardType.model_validate(known["board_type"]),
        cells,
        dict(zip(cells, arrays["raw"], strict=True)),
        arrays["tester_from_flat"],
    )


def place(known: _Known, *, cad: bool) -> Matrices:
    """Stitch, and return matrices from flattened pixels to the board at row 0, mm."""
    head = known.head
    cameras = known.calibration.cameras(head.cameras)
    board_type = known.board_type if cad else None
    setup = StitchSetup(cameras, head.conveyor_mm_s, head.trigger_period_s, board_type)
    stitch = stitch_frames(setup, head, lambda i, j: known.raw.get((i, j)))
    return [
        None if stitch.image_matrices[i][j] is None else np.linalg.inv(stitch.row_motion[j]) @ flat
        for (i, j), flat in zip(known.cells, known.tester_from_flat, strict=True)
    ]
