"""The picture for the engineer: the bodies of a board type laid over what was filmed."""

from __future__ import annotations

from collections.abc import Collection

import cv2
import numpy as np
from numpy.typing import NDArray

from vaoi_station.board_check.overview import Overview
from vaoi_station.board_check.report import BoardCheck
from vaoi_station.board_check.run_frames import CheckedRun
from vaoi_station.geometry.transforms import Floats, apply
from vaoi_station.model import BoardType
from vaoi_station.stitching.geometry import ComponentIndex

_MARGIN_MM = 4.0
_SIDE_PX = 1600
"""Length to which the longer side of the picture is enlarged, at most by 4."""
STATED, FOUND, UNLIKELY = (255, 160, 0), (0, 230, 255), (60, 60, 255)
"""Colours, BGR: bodies where the run's C puts them, where they were found, and those that seem to be absent."""
_MOST_LABELS = 300


def picture_of_check(run: CheckedRun, board_type: BoardType, report: BoardCheck) -> NDArray[np.uint8]:
    """Return the picture (h, w, 3), BGR, of a checked board type."""
    found = None if report.tester_from_cad is None else np.array(report.tester_from_cad)
    refs = {entry.ref for entry in report.unlikely}
    return overlay(run.overview, board_type, found, run.stated_matrix(board_type), refs)


def overlay(
    overview: Overview, board: BoardType, found: Floats | None, stated: Floats | None, unlikely: Collection[str]
) -> NDArray[np.uint8]:
    """Return the picture (h, w, 3), BGR, in the orientation of the tester's axes.

    Args:
        overview: what was filmed.
        board: the board type.
        found: C by the components; None if they were not found.
        stated: C of the run; None if it has none.
        unlikely: addresses of components that seem to be absent.
    """
    index = ComponentIndex.of(board)
    drawn = [
        (colour, apply(overview.px_from_tester @ matrix, index.corners.reshape(-1, 2)).reshape(-1, 4, 2))
        for colour, matrix in ((STATED, stated), (FOUND, found))
        if matrix is not None
    ]
    h, w = overview.grey.shape
    low, high = np.zeros(2), np.array([w, h], dtype=np.float64)
    if drawn:
        every, margin = drawn[-1][1].reshape(-1, 2), _MARGIN_MM * overview.px_per_mm
        low = np.clip(np.floor(every.min(0) - margin), 0, high - 2)
        high = np.clip(np.ceil(every.max(0) + margin), low + 2, high)
    (x0, y0), (x1, y1) = low.astype(int), high.astype(int)
    factor = float(np.clip(_SIDE_PX / max(x1 - x0, y1 - y0), 1, 4))
    picture = cv2.cvtColor(np.ascontiguousarray(overview.grey[y0:y1, x0:x1]), cv2.COLOR_GRAY2BGR)
    picture = cv2.resize(picture, None, fx=factor, fy=factor, interpolation=cv2.INTER_LINEAR)
    for colour, corners in drawn:
        for address, body in zip(index.addresses, corners, strict=True):
            absent = colour == FOUND and address in unlikely
            at = (body - low + 0.5) * factor - 0.5
            shade = UNLIKELY if absent else colour
            # OpenCV takes sixteenths of a pixel; far-off corners would overflow.
            points = np.rint(np.clip(at, -1e4, 1e5) * 16).astype(np.int32)
            cv2.polylines(picture, [points], True, shade, 2 if absent else 1, cv2.LINE_AA, 4)
            if colour == FOUND and (absent or len(index.addresses) <= _MOST_LABELS):
                x, y = np.rint(np.clip(at.min(0), -1e4, 1e5)).astype(int).tolist()
                cv2.putText(picture, address, (x, y - 2), cv2.FONT_HERSHEY_SIMPLEX, 0.35, shade, 1, cv2.LINE_AA)
    return np.asarray(picture, np.uint8)
