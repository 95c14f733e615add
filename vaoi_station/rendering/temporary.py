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
    if stitch.tester_from_cad is None:
        raise StateError(
            "this run has no CAD mapping, so components cannot be cut out.",
            action="; ".join(stitch.reasons),
            code="no-cad-mapping",
        )
    resolution = px_per_mm or float(np.mean([c.px_per_mm for c in cameras]))
    width, height, crop_from_cad = crop_of(component, board_type, resolution)
    grid = np.stack(
        np.meshgrid(np.linspace(0, width - 1, _COVERAGE_GRID), np.linspace(0, height - 1, _COVERAGE_GRID)), -1
    ).reshape(-1, 2)
    views = []
    for i, camera in enumerate(cameras):
        for j in range(len(stitch.image_matrices[i])):
            if stitch.image_matrices[i][j] is None:
                continue
            image_from_crop = _image_from_cad(stitch, camera, i, j, component) @ crop_from_cad.inverse()
            coverage = _coverage(camera, image_from_crop, grid)
            if coverage < max(min_coverage, 1e-9):
                continue
            middle = camera.lens.distort(image_from_crop(((width - 1) / 2, (height - 1) / 2)))
            off = float(np.hypot(*(middle - camera.center_px))) / math.hypot(*camera.center_px)
            ideal = camera.lens.ideal
            views.append(
                View(i, j, width, height, resolution, coverage, off, crop_from_cad, image_from_crop, not ideal)
            )
    return tuple(sorted(views, key=lambda v: (-round(v.coverage, 3), round(v.off_center, 6), v.row, v.camera)))


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


def _image_from_cad(stitch: Stitch, camera: Camera, i: int, j: int, component: Component) -> Projective:
    """CAD to undistorted pixels of one frame, in the plane in which the component's footprint lies."""
    assert stitch.tester_from_cad is not None
    if stitch.surface is None:
        image_from_tester = stitch.image_from_tester(i, j)
        assert image_from_tester is not None
        return image_from_tester @ stitch.tester_from_cad
    height = float(stitch.surface.height_mm(np.array(component.center)))
    row_from_tester = Projective(stitch.row_motion[j], System.ROW, System.TESTER)
    return camera.image_from_row_at(height) @ row_from_tester @ stitch.tester_from_cad


def _coverage(camera: Camera, image_from_crop: Projective, grid: Floats) -> float:
    undistorted = apply(image_from_crop.matrix, grid)
    size = np.array([camera.width_px, camera.height_px], dtype=np.float64)
    near = np.asarray((np.abs(undistorted - camera.center_px) <= size).all(-1))
    if not near.any():
        return 0.0
    raw = camera.lens.distort(np.where(near[:, None], undistorted, 0.0))
    return float((camera.sees(raw) & near).mean())
