"""Plausibility of N_i: whether a camera that looks down as designed can have this matrix.

Four marks fit any layout without residuals, but a wrong layout gives a view that no real camera has.
"""

from __future__ import annotations

import math

import numpy as np

from vaoi_station.geometry.transforms import Floats, apply
from vaoi_station.model import CameraHead
from vaoi_station.model.reason import Note

TILT_DEG = 6.0
"""Largest plausible tilt of a camera; with more, it would not be in focus over its whole frame."""
MAX_SCALE_ERROR = 0.08
"""Largest accepted relative difference between fitted and nominal resolution."""
_MAX_PRINT_ERROR = 0.02
"""Relative scale error of the print above which a warning is given."""


def find_implausibility(matrix: Floats, head: CameraHead, working_distance_mm: float | None) -> str | None:
    """Return why N_i (3, 3) is implausible, with value and limit; None if it is plausible.

    Without a working distance, the diagonal of the view is assumed.
    """
    low, high = local_scales(matrix, head)
    if np.linalg.det(matrix) < 0:
        return "its view is mirrored"
    nominal = head.nominal_px_per_mm or 1.0
    if abs(math.sqrt(low * high) / nominal - 1) > MAX_SCALE_ERROR:
        return (
            f"its resolution is {math.sqrt(low * high):.2f} px/mm, more than {MAX_SCALE_ERROR:.0%} off the nominal "
            f"{nominal:.2f} px/mm"
        )
    # A tilt by α compresses the view by cos α in one direction and leaves the other unchanged.
    stretch, most = high / low, 1 / math.cos(math.radians(TILT_DEG))
    if stretch > most:
        return (
            f"its view is stretched by {stretch - 1:.2%} in one direction, but a camera that is tilted by at most "
            f"{TILT_DEG:.0f}° stretches by {most - 1:.2%}"
        )
    # The third row of N_i gives the relative depth, which varies over the frame only if the camera is tilted.
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


def print_scale_note(scale_ratio: float) -> Note | None:
    """Return a warning if the scale of the print is probably wrong, else None.

    `scale_ratio` is the ratio of fitted to nominal resolution, as the median of all cameras.
    """
    if abs(scale_ratio - 1) <= _MAX_PRINT_ERROR:
        return None
    sentence = (
        f"all cameras together see the board {abs(scale_ratio - 1):.1%} {'larger' if scale_ratio > 1 else 'smaller'} "
        "than designed: check the scale bar of the print, and nominal_px_per_mm"
    )
    return Note("print-scale", sentence, percent=f"{100 * (scale_ratio - 1):+.1f}")


def local_scales(matrix: Floats, head: CameraHead) -> tuple[float, float]:
    """Compute the smallest and the largest resolution, px/mm, of all directions at the centre of the frame."""
    # They are the singular values of the Jacobian of the homography.
    middle = apply(np.linalg.inv(matrix), np.array([(head.width - 1) / 2, (head.height - 1) / 2]))
    w = float(matrix[2, :2] @ middle + matrix[2, 2])
    jacobian = (matrix[:2, :2] - np.outer(apply(matrix, middle), matrix[2, :2])) / w
    high, low = (float(v) for v in np.linalg.svd(jacobian, compute_uv=False))
    return low, high
