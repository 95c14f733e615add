"""Where a camera is meant to look, by the mechanical design: what N_i is looked for around."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from vaoi_station.errors import InputError
from vaoi_station.geometry.transforms import Floats, apply
from vaoi_station.model import CameraHead

REACH_MM = 12.0
"""How far off the design a camera may look, at the most."""
_REACH_SHARE = 0.45
"""The same as a share of the shorter side of its view."""


def nominal_matrix(head: CameraHead, camera: int) -> Floats:
    """N_i (3, 3), tester mm → px, of a camera that hangs exactly as designed, image x along tester x.

    Raises:
        InputError: if the recording does not say where the camera is meant to look.
    """
    for key in ("nominal_center_mm", "nominal_px_per_mm"):
        if getattr(head, key) is None:
            raise InputError(
                f"recording.json: cameras.{camera}.{key} is missing; without it nobody knows which marks it sees.",
                action="Give the place of the camera's view in coordinates of the layout, to a few mm.",
            )
    assert head.nominal_center_mm is not None
    assert head.nominal_px_per_mm is not None
    r, (x, y) = head.nominal_px_per_mm, head.nominal_center_mm
    return np.array([[r, 0, (head.width - 1) / 2 - r * x], [0, r, (head.height - 1) / 2 - r * y], [0, 0, 1.0]])


def reach_mm(head: CameraHead) -> float:
    """How far the view may be off its nominal place."""
    r = head.nominal_px_per_mm or 1.0
    return min(REACH_MM, _REACH_SHARE * min(head.width, head.height) / r)


def is_in_frame(head: CameraHead, px: Floats, margin_px: float = 0.0) -> NDArray[np.bool_]:
    """Whether places (k, 2) px lie in the frame, kept off its border by a margin (negative: or so far outside)."""
    limit = np.array([head.width - 1, head.height - 1]) - margin_px
    return np.asarray(((px >= margin_px) & (px <= limit)).all(-1))


def marks_in_view(head: CameraHead, camera: int, marks_mm: Floats, slack_mm: float = 0.0) -> NDArray[np.int_]:
    """Indices of the marks (k, 2) mm that the camera is meant to see, or would if it were off by `slack_mm`."""
    n = nominal_matrix(head, camera)
    return np.flatnonzero(is_in_frame(head, apply(n, marks_mm), -slack_mm * n[0, 0]))
