"""Predict, from the cameras and the nominal motion of the belt, where two frames show the same part of the board."""

from __future__ import annotations

import math

import cv2
import numpy as np

from vaoi_station.geometry import Camera
from vaoi_station.geometry.projection_kernels import transfer_points
from vaoi_station.geometry.transforms import Floats

_UPRIGHT = math.cos(math.radians(2.0))
"""Two frames are turned against one another if the cosine of the angle between them is below this."""
_LEAST_PX = 2.0
"""Least width of an overlap, px. A narrower one is only the result of rounding."""
Box = tuple[int, int, int, int]
"""A rectangle (x0, y0, x1, y1) in pixels; column x1 and line y1 do not belong to it."""


def predict(a_px: Floats, a: Camera, b: Camera, shift_mm: Floats) -> Floats:
    """Predict where frame b shows the points (k, 2) of frame a, both in raw pixels.

    The points lie in the calibrated plane, and the board moves by `shift_mm` (2,) from frame a to frame b.
    """
    shift = np.asarray(shift_mm, dtype=np.float64)
    return transfer_points(a_px, a.row_from_image.matrix, *_lens(a), shift, b.image_from_row.matrix, *_lens(b))


def _lens(camera: Camera) -> tuple[Floats, tuple[float, float, float, float, float]]:
    """Return the radial coefficients and the shape of a camera's lens, as compiled functions take them."""
    return camera.lens.coefficients, camera.lens.shape


def overlap_box(a: Camera, b: Camera, shift_mm: Floats, margin_px: float = 0.0) -> Box | None:
    """Return the part of frame a that frame b shows too, reduced by a margin, or None if the frames do not overlap.

    The corners of frame b are projected into frame a, and the rectangle around them is limited to frame a. The result
    is exact if the two frames differ by a shift. At the small rotations of a camera array it is accurate to a pixel or
    two. For larger rotations, it is the smallest rectangle around the part that both frames show.
    """
    back = _frame_in(a, b, shift_mm)
    (ax, ay), (bx, by), (cx, cy), (dx, dy) = back.tolist()
    across, along = bx - ax, by - ay
    if across < _UPRIGHT * math.hypot(across, along):
        polygon = overlap_polygon(a, b, shift_mm, (margin_px, margin_px))
        if not len(polygon):
            return None
        (x0, y0), (x1, y1) = polygon.min(0).tolist(), polygon.max(0).tolist()
        return math.ceil(x0), math.ceil(y0), int(x1) + 1, int(y1) + 1
    x0, y0 = max(ax, dx, 0.0) + margin_px, max(ay, by, 0.0) + margin_px
    x1, y1 = min(bx, cx, a.width_px - 1.0) - margin_px, min(cy, dy, a.height_px - 1.0) - margin_px
    if x1 - x0 < _LEAST_PX or y1 - y0 < _LEAST_PX:
        return None
    return math.ceil(x0), math.ceil(y0), int(x1) + 1, int(y1) + 1


def overlap_polygon(a: Camera, b: Camera, shift_mm: Floats, margins_px: tuple[float, float] = (0.0, 0.0)) -> Floats:
    """Return the corners (k, 2) of the part of frame a that frame b shows too; none (0, 2) if there is no overlap.

    `margins_px` are the widths of the strips along the borders of frames a and b that are left out.
    """
    sides = [min(c.width_px, c.height_px) - 1 - 2 * margin for c, margin in zip((a, b), margins_px, strict=True)]
    back = _frame_in(a, b, shift_mm, margins_px[1])
    if min(sides) < _LEAST_PX or not np.isfinite(back).all():
        return np.zeros((0, 2))
    area, common = cv2.intersectConvexConvex(_border(a, margins_px[0]).astype(np.float32), back.astype(np.float32))
    if common is None or area < _LEAST_PX**2 or np.ptp(common[:, 0], axis=0).min() < _LEAST_PX:
        return np.zeros((0, 2))
    return np.asarray(common[:, 0], dtype=np.float64)


def _frame_in(a: Camera, b: Camera, shift_mm: Floats, margin_px: float = 0.0) -> Floats:
    """Project the corners (4, 2) of frame b, reduced by a margin, into frame a."""
    return predict(_border(b, margin_px), b, a, -np.asarray(shift_mm))


def _border(camera: Camera, margin_px: float) -> Floats:
    """Return the corners (4, 2) of a frame without a strip along its border."""
    low, w, h = margin_px, camera.width_px - 1.0 - margin_px, camera.height_px - 1.0 - margin_px
    return np.array([(low, low), (w, low), (w, h), (low, h)])


def overlap_share(camera: Camera, shift_mm: Floats) -> float:
    """Return the share (0 to 1) of a camera's frame still in view after the board has moved by `shift_mm` (2,)."""
    box = overlap_box(camera, camera, shift_mm)
    if box is None:
        return 0.0
    return (box[2] - box[0]) * (box[3] - box[1]) / (camera.width_px * camera.height_px)
