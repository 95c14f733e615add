"""Selection of the few frames per row that a reference keeps (paper, section 3.3.3).

All cameras of a row see the same motion of the board, so a few frames determine it. Frames that are far apart determine
its angle best.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence

import cv2
import numpy as np

from vaoi_station.geometry import Camera
from vaoi_station.geometry.transforms import Floats, apply
from vaoi_station.model import BoardType, Stitch
from vaoi_station.stitching.matching.evidence import FrameKey

MOST_PER_ROW = 4
"""Largest number of frames that are kept per row."""
_LEAST_SHARE = 0.05
"""Least share of a frame that must show the board for the frame to be kept."""


def select_reference_frames(
    stitch: Stitch, cameras: Sequence[Camera], board_type: BoardType, present: Collection[FrameKey]
) -> frozenset[FrameKey]:
    """Select the frames that a reference keeps: at most `MOST_PER_ROW` of each row, spread evenly over the cameras.

    Args:
        stitch: result of the run; its CAD mapping gives the frames that show the board.
        cameras: cameras of the run.
        board_type: board type of the run.
        present: keys (camera, row) of the good frames.
    """
    c = stitch.cad_matrix
    assert c is not None, "only a run with a CAD mapping can be a reference"
    low, high = board_type.extent()
    board_mm = apply(c, np.array([low, (high[0], low[1]), high, (low[0], high[1])]))
    chosen: set[FrameKey] = set()
    for row, moved in enumerate(stitch.row_motion):
        place_mm = apply(moved, board_mm)
        showing = [i for i, camera in enumerate(cameras) if (i, row) in present and _share(camera, place_mm) > 0]
        chosen |= {(i, row) for i in _spread(showing)}
    return frozenset(chosen)


def _spread(cameras: list[int]) -> list[int]:
    if len(cameras) <= MOST_PER_ROW:
        return cameras
    # The first and the last camera are among them, because the angle is determined best over the longest distance.
    return [cameras[k] for k in np.linspace(0, len(cameras) - 1, MOST_PER_ROW).round().astype(int)]


def _share(camera: Camera, board_mm: Floats) -> float:
    """Compute the share of a camera's frame that shows the board with corners (4, 2); 0 if the share is too small."""
    w, h = camera.width_px - 1.0, camera.height_px - 1.0
    view = camera.ground(np.array([[0, 0], [w, 0], [w, h], [0, h]]))
    area, _ = cv2.intersectConvexConvex(view.astype(np.float32), board_mm.astype(np.float32))
    share = float(area) / abs(float(cv2.contourArea(view.astype(np.float32))))
    return share if share >= _LEAST_SHARE else 0.0
