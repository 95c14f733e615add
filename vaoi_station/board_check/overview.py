"""A stitched run with its frames, and one grey picture of all that was filmed with the strength of its edges."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cache, cached_property, lru_cache

import cv2
import numpy as np
from numpy.typing import NDArray

from vaoi_station.errors import StateError
from vaoi_station.frame_index import FootprintViews, FrameIndex
from vaoi_station.geometry import Camera, apply
from vaoi_station.geometry.transforms import Floats
from vaoi_station.model import BoardType, Stitch, Surface
from vaoi_station.pixel_formats import eight_bit_grey
from vaoi_station.stitching.adjustment.motion import Motion
from vaoi_station.stitching.matching.frames import PreparedFrame, Scene

Frame = Callable[[int, int], NDArray[np.generic] | None]
"""A function that returns the pixels of camera and row; None if they never arrived."""
Floats32 = NDArray[np.float32]

_MOST_PX = 6e6
"""Largest number of pixels of the picture."""
_FINEST_PX_PER_MM = 8.0
_LOCAL_MM = 4.0
"""Edges are compared with the mean strength of the edges within about this distance, so that each region counts."""
_NOISE_GREY = 3.0
"""Strength of edges, grey levels per pixel, below which a region counts as blank."""


@dataclass(frozen=True, eq=False)
class Overview:
    """The picture of all that was filmed."""

    grey: NDArray[np.uint8]
    """(h, w); 0 where no frame shows anything."""
    seen: NDArray[np.bool_]
    """(h, w) whether a frame shows the place."""
    low_mm: Floats
    """(2,) tester coordinates of the centre of the first pixel."""
    px_per_mm: float

    @property
    def px_from_tester(self) -> Floats:
        """Matrix (3, 3) from tester coordinates to pixels."""
        s, (x, y) = self.px_per_mm, self.low_mm
        return np.array([[s, 0, -s * x], [0, s, -s * y], [0, 0, 1.0]])

    @cached_property
    def edges(self) -> Callable[[float], Floats32]:
        """Returns, for a blur in mm, the strength (2, h, w) of edges along x and y, less those around it.

        The first is that of edges across x, that is, of vertical lines.
        """
        return cache(self._edges)

    def _edges(self, blur_mm: float) -> Floats32:
        grey = cv2.GaussianBlur(self.grey, (0, 0), 0.8).astype(np.float32)
        inside = cv2.erode(self.seen.astype(np.uint8), np.ones((5, 5), np.uint8)) > 0
        strengths = [np.abs(cv2.Sobel(grey, cv2.CV_32F, dx, dy, ksize=3)) / 8 for dx, dy in ((1, 0), (0, 1))]
        share = (
            cv2.blur(inside.astype(np.float32), (around := 2 * int(_LOCAL_MM * self.px_per_mm / 2) + 1, around)) + 1e-3
        )
        out = np.zeros((2, *self.grey.shape), np.float32)
        for n, strength in enumerate(strengths):
            strength[~inside] = 0
            # Relative to its surroundings, a bright connector does not outweigh a hundred dark chips.
            local = cv2.blur(strength, (around, around)) / share + _NOISE_GREY / 4
            relative = np.minimum(strength / local, 4.0)
            fine = cv2.GaussianBlur(relative, (0, 0), max(blur_mm * self.px_per_mm, 0.3))
            # An edge is stronger than what lies beside it; a region full of texture is not.
            coarse = cv2.GaussianBlur(relative, (0, 0), 4 * blur_mm * self.px_per_mm)
            out[n] = np.where(inside, fine - coarse, 0.0)
        return out


def make_overview(stitch: Stitch, cameras: Sequence[Camera], frame: Frame, lights: Sequence[str] = ()) -> Overview:
    """Put the frames of a run together in tester coordinates, on the plane of the board; the most frequent light's.

    Every place is taken from the frame whose centre is nearest, which shows bodies with the least lean.

    Raises:
        StateError: no frame was placed.
    """
    usual = max(dict.fromkeys(lights), key=list(lights).count) if lights else ""
    rows = [j for j in range(len(stitch.row_motion)) if not lights or lights[j] == usual]
    keys = [(i, j) for j in rows for i in range(len(cameras)) if stitch.image_matrices[i][j] is not None]
    if not keys:
        raise StateError("this run has no placed frame.", action="; ".join(stitch.reasons), code="no-frame-placed")
    filmed = np.concatenate([_view_mm(cameras[i], stitch.row_motion[j]) for i, j in keys])
    low, extent = filmed.min(0), np.ptp(filmed, axis=0)
    resolution = min(_FINEST_PX_PER_MM, *(c.px_per_mm for c in cameras), float(np.sqrt(_MOST_PX / extent.prod())))
    width, height = (int(v) + 1 for v in extent * resolution)
    tester_from_px = np.array([[1 / resolution, 0, low[0]], [0, 1 / resolution, low[1]], [0, 0, 1.0]])
    grey, nearest = np.zeros((height, width), np.uint8), np.full((height, width), np.inf, np.float32)
    lift_mm = 0.0 if stitch.surface is None else stitch.surface.lift_mm
    for i, j in keys:
        pixels = frame(i, j)
        if pixels is not None:
            image_from_tester = cameras[i].image_from_row_at(lift_mm).matrix @ stitch.row_motion[j]
            _paste(pixels, cameras[i], image_from_tester @ tester_from_px, resolution, (grey, nearest))
    return Overview(grey, np.isfinite(nearest), low, resolution)


def _view_mm(camera: Camera, row_from_tester: Floats) -> Floats:
    """Return the corners (4, 2) of a box around what a camera sees, in tester coordinates."""
    (x0, y0), (x1, y1) = camera.view_mm()
    return np.asarray(apply(np.linalg.inv(row_from_tester), np.array([(x0, y0), (x1, y0), (x1, y1), (x0, y1)])))


def _paste(
    pixels: NDArray[np.generic],
    camera: Camera,
    image_from_px: Floats,
    px_per_mm: float,
    target: tuple[NDArray[np.uint8], Floats32],
) -> None:
    """Paste a frame where its centre is nearer than those of the frames before.

    `target` is the picture (h, w), and the squared distance of each pixel from the centre of its frame.
    """
    grey, nearest = target
    factor = max(int(camera.px_per_mm / px_per_mm), 1)
    small = cv2.resize(eight_bit_grey(pixels), None, fx=1 / factor, fy=1 / factor, interpolation=cv2.INTER_AREA)
    half = 0.5 / factor - 0.5
    small_from_px = np.array([[1 / factor, 0, half], [0, 1 / factor, half], [0, 0, 1]]) @ image_from_px
    px_from_image = np.linalg.inv(image_from_px)
    w, h = camera.width_px - 1.0, camera.height_px - 1.0
    corners = apply(px_from_image, np.array([(0, 0), (w, 0), (w, h), (0, h)]))
    x0, y0 = (max(int(v), 0) for v in np.floor(corners.min(0)))
    x1, y1 = (min(int(v) + 1, n) for v, n in zip(np.ceil(corners.max(0)), grey.shape[::-1], strict=True))
    if x1 <= x0 or y1 <= y0:
        return
    shifted = small_from_px @ np.array([[1, 0, x0], [0, 1, y0], [0, 0, 1.0]])
    size, flags = (x1 - x0, y1 - y0), cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
    part = cv2.warpPerspective(small, shifted, size, flags=flags)
    there = cv2.warpPerspective(np.full(small.shape, 255, np.uint8), shifted, size, flags=flags) == 255
    cx, cy = apply(px_from_image, np.array(camera.center_px))
    y, x = np.ogrid[y0:y1, x0:x1]
    distance = ((x - cx) ** 2 + (y - cy) ** 2).astype(np.float32)
    nearer = there & (distance < nearest[y0:y1, x0:x1])
    grey[y0:y1, x0:x1][nearer] = part[nearer]
    nearest[y0:y1, x0:x1][nearer] = distance[nearer]


_MOST_PREPARED = 24
"""Number of frames that are kept in memory; components are measured frame by frame."""


@dataclass(frozen=True, eq=False)
class CheckedRun:
    """A stitched run, its frames, and the board type with which it was stitched."""

    stitch: Stitch
    cameras: tuple[Camera, ...]
    """The cameras as in the run."""
    frame: Frame
    lights: tuple[str, ...] = ()
    board_type: BoardType | None = None
    """The board type to which C of the run belongs; None without one."""

    @cached_property
    def overview(self) -> Overview:
        """The picture of all that was filmed."""
        return make_overview(self.stitch, self.cameras, self.frame, self.lights)

    @cached_property
    def motion(self) -> Motion:
        """The motion of the rows."""
        back = np.linalg.inv(np.array(self.stitch.row_motion))
        return Motion(np.arctan2(back[:, 1, 0], back[:, 0, 0]), back[:, :2, 2].copy(), np.zeros(2))

    @cached_property
    def scene(self) -> Scene:
        """The cameras and the placed frames."""
        placed = [
            (i, j)
            for i, rows in enumerate(self.stitch.image_matrices)
            for j, matrix in enumerate(rows)
            if matrix is not None
        ]

        @lru_cache(maxsize=_MOST_PREPARED)
        def prepared(key: tuple[int, int]) -> PreparedFrame:
            pixels = self.frame(*key)
            if pixels is None:
                raise LookupError(key)
            return PreparedFrame(pixels)

        return Scene(self.cameras, tuple(key for key in placed if self.frame(*key) is not None), prepared)

    def views(self, cad: Floats, tester_from_cad: Floats) -> FootprintViews:
        """Return the views of CAD points (n, 2) on a board that is flat at the height of the run's board."""
        # Tilt and bow are known in the coordinates of the run's board type only; they move a point by micrometres.
        surface = Surface(lift_mm=self.stitch.surface.lift_mm) if self.stitch.surface else None
        rows = np.array(self.stitch.row_motion)
        return FrameIndex(self.cameras, rows, surface=surface, tester_from_cad=tester_from_cad).views(cad)

    def stated_matrix(self, board: BoardType) -> Floats | None:
        """Return C of the run for data in the unit and axes of another board type; None if the run has no C."""
        c, own = self.stitch.cad_matrix, self.board_type
        if c is None or own is None:
            return None
        flip = 1.0 if own.y_axis == board.y_axis else -1.0
        ratio = board.mm_per_unit / own.mm_per_unit
        return np.asarray(np.array(c) @ np.diag([ratio, flip * ratio, 1.0]))
