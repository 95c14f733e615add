"""One temporary image per frame that sees a component (section 3.4, equation 22).

The picture shows the component's bounding box, upright as CAD shows it: never mirrored, CAD x to the
right on the top side and to the left on the bottom side, CAD "up" up. One matrix maps its pixels to
CAD and back; where lenses distort, the matrix from picture to frame gives undistorted pixels and the
renderer bends them.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from vaoi_station.errors import InputError, StateError
from vaoi_station.geometry import Camera, Projective, System
from vaoi_station.geometry.transforms import Floats, apply
from vaoi_station.model import BoardType, Component, Stitch

MOST_PIXELS = 16_000_000
"""No temporary image is larger; ask for fewer pixels per mm."""
_COVERAGE_GRID = 9
_LENS_MARGIN_PX = 50.0
"""No lens bends the border of a frame by more."""


@dataclass(frozen=True, eq=False)
class View:
    """How one frame shows one component."""

    camera: int
    row: int
    width: int
    height: int
    px_per_mm: float
    coverage: float
    """Share of the picture that lies inside the frame."""
    off_center: float
    """Distance of the component's middle from the frame's, in half diagonals: small is seen straight from above."""
    crop_from_cad: Projective
    image_from_crop: Projective
    """Undistorted pixels; `distorted` says whether the lens bends them."""
    distorted: bool

    @property
    def cad_from_crop(self) -> Projective:
        """CAD coordinates of the picture's pixels."""
        return self.crop_from_cad.inverse()


class Album:
    """The views of one stitched board: what all its components share is computed once."""

    def __init__(self, board_type: BoardType, stitch: Stitch, cameras: Sequence[Camera]) -> None:
        """Take matrices and cameras of one run.

        Raises:
            StateError: the run has no CAD mapping.
        """
        if stitch.tester_from_cad is None:
            raise StateError(
                "this run has no CAD mapping, so components cannot be cut out.",
                action="; ".join(stitch.reasons),
                code="no-cad-mapping",
            )
        self._board_type, self._surface, self._cameras = board_type, stitch.surface, tuple(cameras)
        self._keys = [
            (i, j) for i, rows in enumerate(stitch.image_matrices) for j, m in enumerate(rows) if m is not None
        ]
        row_from_cad = [d @ stitch.tester_from_cad.matrix for d in stitch.row_motion]
        self._row_from_cad = np.array([row_from_cad[j] for _, j in self._keys]).reshape(-1, 3, 3)
        self._image_from_row = np.array([cameras[i].image_from_row.matrix for i, _ in self._keys]).reshape(-1, 3, 3)
        self._image_from_cad = self._image_from_row @ self._row_from_cad
        self._size = np.array([(cameras[i].width_px, cameras[i].height_px) for i, _ in self._keys]).reshape(-1, 2)
        self._resolution = float(np.mean([c.px_per_mm for c in cameras]))

    def views(
        self, component: Component, *, px_per_mm: float | None = None, min_coverage: float = 0.5
    ) -> tuple[View, ...]:
        """Every frame that sees a component; see `views_of`."""
        resolution = px_per_mm or self._resolution
        width, height, crop_from_cad = crop_of(component, self._board_type, resolution)
        image_from_crop = self._planes(component) @ crop_from_cad.inverse().matrix
        corners = np.array(
            [[-0.5, -0.5, 1], [width - 0.5, -0.5, 1], [width - 0.5, height - 0.5, 1], [-0.5, height - 0.5, 1]]
        )
        seen = image_from_crop @ corners.T
        seen = seen[:, :2] / seen[:, 2:]
        touching = (seen.max(2) > -_LENS_MARGIN_PX).all(1) & (seen.min(2) < self._size + _LENS_MARGIN_PX).all(1)
        grid = _grid(width, height)
        views = []
        for n in np.flatnonzero(touching):
            i, j = self._keys[n]
            camera = self._cameras[i]
            raw = camera.lens.distort(apply(image_from_crop[n], grid))
            coverage = float(camera.sees(raw[:-1]).mean())
            if coverage < max(min_coverage, 1e-9):
                continue
            off = float(np.hypot(*(raw[-1] - camera.center_px))) / math.hypot(*camera.center_px)
            to_image = Projective(image_from_crop[n], System.IMAGE, System.CROP)
            views.append(
                View(i, j, width, height, resolution, coverage, off, crop_from_cad, to_image, not camera.lens.ideal)
            )
        return tuple(sorted(views, key=lambda v: (-round(v.coverage, 3), round(v.off_center, 6), v.row, v.camera)))

    def _planes(self, component: Component) -> Floats:
        """CAD to undistorted pixels of every frame, (f, 3, 3), in the plane of the component's footprint."""
        if self._surface is None:
            return self._image_from_cad
        height = float(self._surface.height_mm(np.array(component.center)))
        at_height = np.array([c.image_from_row_at(height).matrix for c in self._cameras])
        return np.asarray(at_height[[i for i, _ in self._keys]] @ self._row_from_cad)


def views_of(
    component: Component,
    board_type: BoardType,
    stitch: Stitch,
    cameras: Sequence[Camera],
    *,
    px_per_mm: float | None = None,
    min_coverage: float = 0.5,
) -> tuple[View, ...]:
    """Every frame that sees a component, the best first: those that show all of it, then those nearest to their middle.

    Args:
        component: of the board type.
        board_type: gives unit, axes and side.
        stitch: matrices of the run.
        cameras: of the same calibration.
        px_per_mm: resolution of the pictures; by default the cameras'.
        min_coverage: frames that show less of the box are left out.

    Raises:
        StateError: the run has no CAD mapping.
        InputError: the picture would be too large.
    """
    return Album(board_type, stitch, cameras).views(component, px_per_mm=px_per_mm, min_coverage=min_coverage)


def render(view: View, frame: NDArray[Any], camera: Camera) -> NDArray[Any]:
    """Resample one temporary image, (height, width) or (height, width, channels), by bilinear interpolation.

    Places outside the frame are black.
    """
    size = (view.width, view.height)
    if not view.distorted:
        matrix = view.image_from_crop.matrix
        flags = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
        return np.asarray(cv2.warpPerspective(frame, matrix, size, flags=flags, borderMode=cv2.BORDER_CONSTANT))
    x, y = np.meshgrid(np.arange(view.width), np.arange(view.height))
    raw = camera.lens.distort(view.image_from_crop(np.stack([x, y], -1))).astype(np.float32)
    return np.asarray(cv2.remap(frame, raw[..., 0], raw[..., 1], cv2.INTER_LINEAR, borderMode=cv2.BORDER_CONSTANT))


def crop_of(component: Component, board_type: BoardType, px_per_mm: float) -> tuple[int, int, Projective]:
    """Width and height of a component's picture, and the transform from CAD to its pixels.

    Pixel sizes are areas: the edges of the box are the outer edges of the border pixels, so the centre
    of pixel (0, 0) lies half a pixel inside.
    """
    corners = board_type.footprint(component)
    low, high = corners.min(0), corners.max(0)
    scale = px_per_mm * board_type.mm_per_unit
    width, height = (max(round(float(v) * scale), 1) for v in high - low)
    if width * height > MOST_PIXELS:
        raise InputError.field(
            component.address,
            "px_per_mm",
            px_per_mm,
            f"small enough for {MOST_PIXELS / 1e6:.0f} megapixels (this would be {width}×{height})",
        )
    x_right = board_type.side == "top"
    y_down = board_type.y_axis == "down"
    box = np.array([low, high])
    sx = width / (high[0] - low[0]) * (1 if x_right else -1)
    sy = height / (high[1] - low[1]) * (1 if y_down else -1)
    x0 = box[0 if x_right else 1, 0]
    y0 = box[0 if y_down else 1, 1]
    matrix = np.array([[sx, 0, -sx * x0 - 0.5], [0, sy, -sy * y0 - 0.5], [0, 0, 1.0]])
    return width, height, Projective(matrix, System.CROP, System.CAD)


def _grid(width: int, height: int) -> Floats:
    """Pixels (81 + 1, 2) spread over a picture, and its middle as the last."""
    x, y = np.linspace(0, width - 1, _COVERAGE_GRID), np.linspace(0, height - 1, _COVERAGE_GRID)
    grid = np.stack(np.meshgrid(x, y), -1).reshape(-1, 2)
    return np.vstack([grid, [(width - 1) / 2, (height - 1) / 2]])
