"""Grids of pixels on the footprints of components, and the frames that show them.

A grid is aligned with the footprint and lies on the board's surface. Its pixels are about as large as those of the
frames, or a power of two larger on large components. Coordinates of a grid: column and row, whose centres are integers;
the origin is the centre of the top-left pixel of the footprint's part without margin.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from vaoi_station.compiled import compiled
from vaoi_station.geometry import Camera
from vaoi_station.geometry.transforms import Floats, apply
from vaoi_station.heights.resampling import Ints, camera_arrays
from vaoi_station.model import BoardType, Stitch
from vaoi_station.pixel_formats import eight_bit_grey

FrameKey = tuple[int, int]
LONGEST_PX = 160
"""Longest side of a grid; larger footprints get larger pixels."""
_MOST_LEVEL = 4
_LEAST_SIDE_PX = 6
"""Least side of a grid. Smaller footprints have no height."""


class Frames:
    """The frames of one run in reduced copies, each computed when it is first used."""

    def __init__(self, frame: Callable[[int, int], NDArray[Any] | None]) -> None:
        """Create it from a function that returns the pixels of a camera and row; None for a missing frame."""
        self._frame = frame
        self._copies: dict[tuple[int, int, int], NDArray[Any] | None] = {}

    def get(self, key: FrameKey, level: int) -> NDArray[Any] | None:
        """Return the grey frame reduced by 2 to the power of `level`; None if it is missing."""
        at = (*key, level)
        if at not in self._copies:
            self._copies[at] = self._reduced(key, level)
        return self._copies[at]

    def _reduced(self, key: FrameKey, level: int) -> NDArray[Any] | None:
        if level == 0:
            pixels = self._frame(*key)
            if pixels is None:
                return None
            # 32-bit floats are grey levels that were divided by a flat field.
            return np.ascontiguousarray(pixels if pixels.dtype == np.float32 else eight_bit_grey(pixels))
        finer = self.get(key, level - 1)
        if finer is None:
            return None
        h, w = finer.shape[0] // 2 * 2, finer.shape[1] // 2 * 2
        return np.asarray(cv2.resize(finer[:h, :w], (w // 2, h // 2), interpolation=cv2.INTER_AREA))


class PartGrid(NamedTuple):
    """The grid of one component."""

    address: str
    width: int
    height: int
    """Columns and rows of the footprint's part without margin."""
    level: int
    """Frames are reduced by 2 to the power of this."""
    mm_per_px: float
    surface_mm: float
    """Height of the board's surface above the calibrated plane."""
    tester_from_grid: Floats
    """(2, 3) affine map."""
    keys: Ints
    """(v, 2) camera and row of the frames that show it."""
    feet_px: Floats
    """(v, 2) feet of their cameras in grid coordinates: the points of the surface's plane below the camera centres."""
    distance_mm: Floats
    """(v,) heights of the cameras above the board's surface at the component."""


class _RunFrames(NamedTuple):
    """The n frames of a run that have a matrix."""

    key: Ints
    """(n, 2) camera and row."""
    image_from_tester: Floats
    """(n, 3, 3) M_ij."""
    size_px: Floats
    """(n, 2)."""
    foot_mm: Floats
    """(n, 2) foot of the camera in tester coordinates."""
    distance_mm: Floats
    """(n,) working distance; NaN if it is unknown."""


class Places:
    """Where the components of one run lie in its frames."""

    def __init__(self, board_type: BoardType, stitch: Stitch, cameras: Sequence[Camera]) -> None:
        """Store the matrices of a run; `cameras` are those of its calibration."""
        assert stitch.tester_from_cad is not None
        self.board_type, self.stitch = board_type, stitch
        mine = stitch.cameras(cameras)
        self.cameras = camera_arrays(mine)
        self.tester_from_cad = stitch.tester_from_cad.matrix
        """C (3, 3)."""
        # Rows that a repeated pattern may have displaced by a period show other parts than their matrices say.
        doubtful = {row for rows in stitch.quality.get("rows_apart", ()) for row in rows}
        keys = [
            (i, j)
            for i, rows in enumerate(stitch.image_matrices)
            for j, m in enumerate(rows)
            if m is not None and j not in doubtful
        ]
        self._px_per_mm = float(np.mean([c.px_per_mm for c in mine]))
        self._row_from_tester = np.array(stitch.row_motion)
        back = np.linalg.inv(self._row_from_tester)
        distance_mm = [mine[i].working_distance_mm for i, _ in keys]
        self._frames = _RunFrames(
            np.array(keys).reshape(-1, 2),
            np.array([np.asarray(stitch.image_matrices[i][j]) for i, j in keys]).reshape(-1, 3, 3),
            np.array([(mine[i].width_px, mine[i].height_px) for i, _ in keys], np.float64).reshape(-1, 2),
            np.array([apply(back[j], mine[i].foot_mm) for i, j in keys]).reshape(-1, 2),
            np.array([np.nan if d is None else d for d in distance_mm], np.float64),
        )

    def grid(self, address: str, corners_cad: Floats, longest_px: int = LONGEST_PX) -> PartGrid | None:
        """Return the grid of a component with these corners (4, 2), or None if it is too small for one.

        Its longest side is at most `longest_px`.
        """
        matrix = self.stitch.component_matrix(address)
        assert matrix is not None
        corners = apply(matrix, corners_cad)
        # Plain numbers: numpy takes ten times as long for so few.
        (ax, ay), (bx, by), (cx, cy), (dx, dy) = corners.tolist()
        sides = ((bx - ax, by - ay), (dx - ax, dy - ay))
        length = [math.hypot(*side) for side in sides]
        longest = max(length) * self._px_per_mm
        level = min(max(0, math.ceil(math.log2(longest / longest_px))), _MOST_LEVEL) if longest > 0 else 0
        pitch = 2**level / self._px_per_mm
        width, height = (int(v / pitch + 1e-6) for v in length)
        if min(width, height) < _LEAST_SIDE_PX:
            return None
        (ux, uy), (vx, vy) = ((x / v * pitch, y / v * pitch) for (x, y), v in zip(sides, length, strict=True))
        x = (ax + bx + cx + dx) / 4 - ux * (width - 1) / 2 - vx * (height - 1) / 2
        y = (ay + by + cy + dy) / 4 - uy * (width - 1) / 2 - vy * (height - 1) / 2
        affine = np.array([[ux, vx, x], [uy, vy, y]])
        surface = self.stitch.surface
        z = 0.0 if surface is None else float(surface.height_mm(corners_cad.sum(0) / 4))
        shown, feet, distance = _shown(self._frames, affine, corners, z)
        return PartGrid(address, width, height, level, pitch, z, affine, self._frames.key[shown], feet, distance)

    def row_from_grid(self, grid: PartGrid) -> Floats:
        """Return the affine maps (v, 2, 3) from a grid to row coordinates at the rows of its frames."""
        # The row's motion after the grid's place.
        way = self._row_from_tester[grid.keys[:, 1], :2, :2] @ grid.tester_from_grid
        way[:, :, 2] += self._row_from_tester[grid.keys[:, 1], :2, 2]
        return way


@compiled
def _shown(frames: _RunFrames, affine: Floats, corners: Floats, z: float) -> tuple[Ints, Floats, Floats]:
    """Return the numbers (v,) of the frames in which a part of a footprint lies, `feet_px` and `distance_mm`.

    Args:
        frames: the frames of the run.
        affine: (2, 3) from the grid to tester coordinates.
        corners: (4, 2) of the footprint, tester coordinates.
        z: height of the board's surface above the calibrated plane.
    """
    shown, v = np.empty(len(frames.key), np.int64), 0
    for n in range(len(frames.key)):
        m, inside = frames.image_from_tester[n], frames.distance_mm[n] > z
        for axis in range(2):
            low, high = np.inf, -np.inf
            for i in range(4):
                x, y = corners[i, 0], corners[i, 1]
                px = (m[axis, 0] * x + m[axis, 1] * y + m[axis, 2]) / (m[2, 0] * x + m[2, 1] * y + m[2, 2])
                low, high = min(low, px), max(high, px)
            inside = inside and high > 0 and low < frames.size_px[n, axis]
        if inside:
            shown[v] = n
            v += 1
    feet, distance = np.empty((v, 2)), np.empty(v)
    scale = affine[0, 0] * affine[1, 1] - affine[0, 1] * affine[1, 0]
    for i in range(v):
        x, y = frames.foot_mm[shown[i], 0] - affine[0, 2], frames.foot_mm[shown[i], 1] - affine[1, 2]
        feet[i, 0] = (affine[1, 1] * x - affine[0, 1] * y) / scale
        feet[i, 1] = (affine[0, 0] * y - affine[1, 0] * x) / scale
        distance[i] = frames.distance_mm[shown[i]] - z
    return shown[:v], feet, distance
