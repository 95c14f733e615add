"""Predict, from the cameras and the nominal motion of the belt, where two frames show the same part of the board."""

from __future__ import annotations

import math

import numpy as np

from vaoi_station.geometry import Camera
from vaoi_station.geometry.projection_kernels import transfer_points
from vaoi_station.geometry.transforms import Floats

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

    The corners of frame b are projected into frame a, and the rectangle is limited to frame a. It is exact if the two
    frames differ by a shift, and accurate to a pixel or two at the small rotations of a camera array.
    """
    w, h = b.width_px - 1.0, b.height_px - 1.0
    back = predict(np.array([(0.0, 0.0), (w, 0.0), (w, h), (0.0, h)]), b, a, -np.asarray(shift_mm))
    (ax, ay), (bx, by), (cx, cy), (dx, dy) = back.tolist()
    x0, y0 = max(ax, dx, 0.0) + margin_px, max(ay, by, 0.0) + margin_px
    x1, y1 = min(bx, cx, a.width_px - 1.0) - margin_px, min(cy, dy, a.height_px - 1.0) - margin_px
    # an overlap less than two pixels wide comes from rounding
    if x1 - x0 < 2 or y1 - y0 < 2:
        return None
    return math.ceil(x0), math.ceil(y0), int(x1) + 1, int(y1) + 1


def overlap_share(camera: Camera, shift_mm: Floats) -> float:
    """Return which share (0 … 1) of a camera's frame is still in view after the board has moved by a shift (2,)."""
    box = overlap_box(camera, camera, shift_mm)
    if box is None:
        return 0.0
    return (box[2] - box[0]) * (box[3] - box[1]) / (camera.width_px * camera.height_px)
