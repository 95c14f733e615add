"""Predict where two frames show the same from the cameras and the belt's nominal motion."""

from __future__ import annotations

import math

import numpy as np

from vaoi_station.geometry import Camera
from vaoi_station.geometry.projection_kernels import transfer_points
from vaoi_station.geometry.transforms import Floats

Box = tuple[int, int, int, int]
"""x0, y0, x1, y1 in pixels; the ends are excluded."""


def predict(a_px: Floats, a: Camera, b: Camera, shift_mm: Floats) -> Floats:
    """Return the raw pixels in frame b of points of the plane at raw pixels (k, 2) of frame a, after a shift (2,)."""
    shift = np.asarray(shift_mm, dtype=np.float64)
    return transfer_points(a_px, a.row_from_image.matrix, *_lens(a), shift, b.image_from_row.matrix, *_lens(b))


def _lens(camera: Camera) -> tuple[Floats, tuple[float, float, float, float, float]]:
    return camera.lens.coefficients, camera.lens.shape


def overlap_box(a: Camera, b: Camera, shift_mm: Floats, margin_px: float = 0.0) -> Box | None:
    """Return the part of frame a that frame b shows too, or None.

    The corners of frame b are projected into a and cut off there. The box is exact for shifts, and within a pixel or
    two for the small rotations of a camera array.
    """
    w, h = b.width_px - 1.0, b.height_px - 1.0
    back = predict(np.array([(0.0, 0.0), (w, 0.0), (w, h), (0.0, h)]), b, a, -np.asarray(shift_mm))
    (ax, ay), (bx, by), (cx, cy), (dx, dy) = back.tolist()
    x0, y0 = max(ax, dx, 0.0) + margin_px, max(ay, by, 0.0) + margin_px
    x1, y1 = min(bx, cx, a.width_px - 1.0) - margin_px, min(cy, dy, a.height_px - 1.0) - margin_px
    # a strip of a pixel comes from rounding, not from an overlap
    if x1 - x0 < 2 or y1 - y0 < 2:
        return None
    return math.ceil(x0), math.ceil(y0), int(x1) + 1, int(y1) + 1


def overlap_share(camera: Camera, shift_mm: Floats) -> float:
    """Return the share of a frame that is still in view after a shift on the belt."""
    box = overlap_box(camera, camera, shift_mm)
    if box is None:
        return 0.0
    return (box[2] - box[0]) * (box[3] - box[1]) / (camera.width_px * camera.height_px)
