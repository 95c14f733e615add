"""Whether an N_i can be that of a camera that looks down as designed.

Four marks fit any layout without a residual; what a wrong one yields is a view that no camera has.
"""

from __future__ import annotations

import math

import numpy as np

from vaoi_station.geometry.transforms import Floats, apply
from vaoi_station.model import CameraHead

TILT_DEG = 6.0
"""No camera looks askew by more; one that did would not focus over its frame."""
SCALE_SHARE = 0.08
_PRINT_SHARE = 0.02
"""Boards whose print is off in scale by more are told of."""


def find_implausibility(matrix: Floats, head: CameraHead, working_distance_mm: float | None) -> str | None:
    """Why N_i (3, 3) is no view of such a camera, with number and limit; None if it is one.

    Args:
        matrix: tester mm → undistorted px.
        head: with the nominal resolution.
        working_distance_mm: if unknown, at least the diagonal of the view.
    """
    low, high = local_scales(matrix, head)
    if np.linalg.det(matrix) < 0:
        return "its view is mirrored"
    nominal = head.nominal_px_per_mm or 1.0
    if abs(math.sqrt(low * high) / nominal - 1) > SCALE_SHARE:
        return (
            f"its resolution is {math.sqrt(low * high):.2f} px/mm, more than {SCALE_SHARE:.0%} off the nominal "
            f"{nominal:.2f} px/mm"
        )
    stretch, most = high / low, 1 / math.cos(math.radians(TILT_DEG))
    if stretch > most:
        return (
            f"its view is stretched by {stretch - 1:.2%} in one direction, but a camera that is tilted by at most "
            f"{TILT_DEG:.0f}° stretches by {most - 1:.2%}"
        )
    diagonal = math.hypot(head.width, head.height) / nominal
    distance = working_distance_mm or diagonal
    corners = np.array([[x, y] for x in (0, head.width - 1) for y in (0, head.height - 1)], dtype=np.float64)
    depth = apply(np.linalg.inv(matrix), corners) @ matrix[2, :2] + matrix[2, 2]
    if depth.min() <= 0:
        return "its horizon lies within the frame"
    change, most = float(depth.max() / depth.min()) - 1, diagonal * math.tan(math.radians(TILT_DEG)) / distance
    if change > most:
        return (
            f"its resolution changes by {change:.1%} over the frame, but a camera {distance:.0f} mm away that is "
            f"tilted by at most {TILT_DEG:.0f}° has {most:.1%}"
        )
    return None


def print_scale_note(scale_ratio: float) -> str | None:
    """What to check when cameras see the board larger or smaller than designed; None if they do not."""
    if abs(scale_ratio - 1) <= _PRINT_SHARE:
        return None
    return (
        f"all cameras together see the board {abs(scale_ratio - 1):.1%} {'larger' if scale_ratio > 1 else 'smaller'} "
        "than designed: check the scale bar of the print, and nominal_px_per_mm"
    )


def local_scales(matrix: Floats, head: CameraHead) -> tuple[float, float]:
    """Least and greatest px per mm in the middle of the frame, over all directions."""
    middle = apply(np.linalg.inv(matrix), np.array([(head.width - 1) / 2, (head.height - 1) / 2]))
    w = float(matrix[2, :2] @ middle + matrix[2, 2])
    jacobian = (matrix[:2, :2] - np.outer(apply(matrix, middle), matrix[2, :2])) / w
    high, low = (float(v) for v in np.linalg.svd(jacobian, compute_uv=False))
    return low, high
