"""Shapes of the artwork: the cross of a mark, the scale bar, and the arrow along the cameras."""

from __future__ import annotations

import numpy as np

from vaoi_station.geometry.transforms import Floats

LABEL_MM = 8.0
"""Height of the strip below the views for scale bar and title, outside all views."""
BAR_MM = 50.0
"""Length of the scale bar, if the board is wide enough."""


def cross(center: Floats, size_mm: float, width_mm: float) -> Floats:
    """Compute the corners (12, 2) of a cross in mm, in order along its outline."""
    r, a = size_mm / 2, width_mm / 2
    quarter = [(a, -r), (a, -a), (r, -a)]
    corners = []
    for turn in range(4):
        c, s = ((1, 0), (0, 1), (-1, 0), (0, -1))[turn]
        corners += [(c * x - s * y, s * x + c * y) for x, y in quarter]
    return np.asarray(np.array(corners) + center)


def scale_bar(low_mm: tuple[float, float], high_mm: tuple[float, float]) -> tuple[Floats, float]:
    """Compute the strokes (3, 2, 2) mm of a bar with end ticks in the strip below the views, and its length in mm."""
    length = BAR_MM if high_mm[0] - low_mm[0] >= BAR_MM + 10 else 10.0
    x, y = low_mm[0] + 5, high_mm[1] - LABEL_MM / 2
    ends = [(x, y), (x + length, y)]
    ticks = [[(end, y - 1.5), (end, y + 1.5)] for end in (x, x + length)]
    return np.array([ends, *ticks]), length


def label_baseline_mm(high_mm: tuple[float, float]) -> float:
    """Return y of the baseline of the cameras' numbers: between the views and the strip of the scale bar."""
    return high_mm[1] - LABEL_MM - 1.0


def arrow(low_mm: tuple[float, float], high_mm: tuple[float, float], first_camera_x_mm: float) -> Floats:
    """Compute the strokes (3, 2, 2) mm of an arrow from camera 0 towards the next one, left of the number of camera 0.

    It shows how the board lies: camera 0 above its number 0, and the arrow along the cameras.
    """
    begin, y = low_mm[0] + 1.0, label_baseline_mm(high_mm) - 0.9
    tip = max(begin + 3.0, min(begin + 12.0, first_camera_x_mm - 7.0))
    return np.array([[(begin, y), (tip, y)], *([(tip - 1.5, y + dy), (tip, y)] for dy in (-1.0, 1.0))])
