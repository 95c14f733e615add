"""Grids of pixels on the footprints of components, and the frames that show them.

A grid is aligned with the footprint and lies on the board's surface. Its pixels are about as large as those of the
frames, or a power of two larger on large components. Coordinates of a grid: column and row, whose centres are integers;
the origin is the centre of the top-left pixel of the footprint's part without margin.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Any, NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from vaoi_station.geometry import Camera
from vaoi_station.geometry.transforms import Floats, apply
from vaoi_station.heights.resampling import sample
from vaoi_station.model import BoardType, Stitch
from vaoi_station.pixel_formats import eight_bit_grey

FrameKey = tuple[int, int]
Box = tuple[int, int, int, int]
LONGEST_PX = 160
"""Longest side of a grid; larger footprints get larger pixels."""
_MOST_LEVEL = 4
_MESH_PX = 12
"""Distance of the nodes at which positions in a frame are computed exactly. Between them they are interpolated."""
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


@dataclass(frozen=True, eq=False)
class View:
    """One frame that shows a component."""

    key: FrameKey
    foot_px: Floats
    """(2,) foot of the camera in grid coordinates: the point of the surface's plane below the camera centre."""
    distance_mm: float
    """Height of the camera above the board's surface at the component."""


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
    views: tuple[View, ...]


class Places:
    """Where the components of one run lie in its frames."""

    def __init__(self, board_type: BoardType, stitch: Stitch, cameras: Sequence[Camera]) -> None:
        """Store the matrices of a run; `cameras` are those of its calibration."""
        assert stitch.tester_from_cad is not None
        self.board_type, self.stitch = board_type, stitch
        self.cameras = stitch.cameras(cameras)
        self.tester_from_cad = stitch.tester_from_cad.matrix
        """C (3, 3)."""
        self._keys = [
            (i, j) for i, rows in enumerate(stitch.image_matrices) for j, m in enumerate(rows) if m is not None
        ]
        self._px_per_mm = float(np.mean([c.px_per_mm for c in self.cameras]))
        motion = np.array(stitch.row_motion)
        back = np.linalg.inv(motion)
        self._row_from_tester = motion
        self._feet = np.array([apply(back[j], self.cameras[i].foot_mm) for i, j in self._keys])
        self._matrices = np.array([np.asarray(stitch.image_matrices[i][j]) for i, j in self._keys])
        distance_mm = [self.cameras[i].working_distance_mm for i, _ in self._keys]
        self._distance_mm = np.array([np.nan if d is None else d for d in distance_mm])
        self._frame_px = np.array([(self.cameras[i].width_px, self.cameras[i].height_px) for i, _ in self._keys])

    def grid(self, address: str, corners_cad: Floats, longest_px: int = LONGEST_PX) -> PartGrid | None:
        """Return the grid of a component with these corners (4, 2), or None if it is too small for one.

        Its longest side is at most `longest_px`.
        """
        matrix = self.stitch.component_matrix(address)
        assert matrix is not None
        corners = apply(matrix, corners_cad)
        side = corners[1] - corners[0], corners[3] - corners[0]
        length = [float(np.hypot(*s)) for s in side]
        longest = max(length) * self._px_per_mm
        level = min(max(0, math.ceil(math.log2(longest / longest_px))), _MOST_LEVEL) if longest > 0 else 0
        pitch = 2**level / self._px_per_mm
        size = [int(v / pitch + 1e-6) for v in length]
        if min(size) < _LEAST_SIDE_PX:
            return None
        along = [s / v * pitch for s, v in zip(side, length, strict=True)]
        # Sums: `mean` takes twice as long for so few numbers.
        middle = corners.sum(0) / 4
        origin = middle - along[0] * (size[0] - 1) / 2 - along[1] * (size[1] - 1) / 2
        affine = np.column_stack([along[0], along[1], origin])
        surface = self.stitch.surface
        z = 0.0 if surface is None else float(surface.height_mm(corners_cad.sum(0) / 4))
        views = self._views(affine, np.concatenate([corners, middle[None]]), z)
        return PartGrid(address, size[0], size[1], level, pitch, z, affine, views)

    def _views(self, affine: Floats, points: Floats, z: float) -> tuple[View, ...]:
        """Return the frames in which at least a part of the footprint lies; `points` (5, 2) are corners and middle."""
        q = points @ self._matrices[:, :, :2].swapaxes(1, 2) + self._matrices[:, None, :, 2]
        px = q[..., :2] / q[..., 2:]
        inside = (px.max(1) > 0).all(1) & (px.min(1) < self._frame_px).all(1)
        inside &= self._distance_mm > z
        (a, b), (c, d) = affine[:, :2].tolist()
        grid_from_tester = np.array([[d, -b], [-c, a]]) / (a * d - b * c)
        shown = np.flatnonzero(inside)
        feet, distance = (self._feet[shown] - affine[:, 2]) @ grid_from_tester.T, self._distance_mm[shown] - z
        keys = (self._keys[n] for n in shown.tolist())
        return tuple(View(*view) for view in zip(keys, feet, distance.tolist(), strict=True))

    def rectified(
        self, grid: PartGrid, images: Sequence[NDArray[Any]], margin: int, height_mm: float = 0.0
    ) -> NDArray[np.float32]:
        """Return the pixels (k, h, w) of a grid's k views on the plane at a height above the surface, with a margin.

        NaN where a frame does not show the place.
        """
        box = (-margin, -margin, grid.width + margin, grid.height + margin)
        out = np.empty((len(images), grid.height + 2 * margin, grid.width + 2 * margin), np.float32)
        # All frames of one camera are projected in one call, whose cost is that of the call.
        cameras = np.array([view.key[0] for view in grid.views])
        for camera in set(cameras.tolist()):
            mine = np.flatnonzero(cameras == camera).tolist()
            raw = self._raw(grid, [grid.views[k] for k in mine], box, height_mm)
            for k, nodes in zip(mine, raw, strict=True):
                sample(images[k], nodes, _MESH_PX, out[k])
        return out

    def rectified_box(self, grid: PartGrid, view: View, image: NDArray[Any], box: Box) -> NDArray[np.float32]:
        """Return the same of one view on the surface, for a box: first column, first row, and those after the last."""
        x0, y0, x1, y1 = box
        out = np.empty((y1 - y0, x1 - x0), np.float32)
        sample(image, self._raw(grid, [view], box, 0.0)[0], _MESH_PX, out)
        return out

    def _raw(self, grid: PartGrid, views: Sequence[View], box: Box, height_mm: float) -> Floats:
        """Return the positions (k, ny, nx, 2) of the nodes of a box in k frames of one camera."""
        x0, y0, x1, y1 = box
        nodes = _mesh((y1 - y0 - 2) // _MESH_PX + 2, (x1 - x0 - 2) // _MESH_PX + 2) + (x0, y0)
        m, a = self._row_from_tester[[view.key[1] for view in views]], grid.tester_from_grid
        # One affine map from the grid to row coordinates: the row's motion after the grid's place.
        turn, shift = m[:, :2, :2] @ a[:, :2], m[:, :2, :2] @ a[:, 2] + m[:, :2, 2]
        row = nodes.reshape(-1, 2) @ turn.swapaxes(1, 2) + shift[:, None]
        raw = self.cameras[views[0].key[0]].project(row, grid.surface_mm + height_mm)
        raw = raw.reshape(len(views), *nodes.shape)
        return (raw + 0.5) * 0.5**grid.level - 0.5 if grid.level else raw


@lru_cache(maxsize=256)
def _mesh(rows: int, columns: int) -> Floats:
    """Return the nodes (rows, columns, 2) of a mesh that begins at the origin: column and row of the grid."""
    nodes = np.empty((rows, columns, 2))
    nodes[..., 0], nodes[..., 1] = np.arange(columns) * float(_MESH_PX), np.arange(rows)[:, None] * float(_MESH_PX)
    nodes.flags.writeable = False
    return nodes
