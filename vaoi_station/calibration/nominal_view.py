"""The nominal view of a camera, from the mechanical design."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from vaoi_station.errors import InputError
from vaoi_station.geometry.transforms import Floats, apply
from vaoi_station.model import CameraHead

REACH_MM = 12.0
"""Largest accepted distance of a view from its nominal position, mm."""
_REACH_SHARE = 0.45
"""Largest accepted deviation of a view from the design, as a share of the shorter side of the view."""


def nominal_matrix(head: CameraHead, camera: int) -> Floats:
    """Compute N_i (3, 3), tester mm → px, of a camera exactly as designed, with image x along tester x.

    Raises:
        InputError: if the recording lacks the nominal view.
    """
    for key in ("nominal_center_mm", "nominal_px_per_mm"):
        if getattr(head, key) is None:
            raise InputError(
                f"recording.json: cameras.{camera}.{key} is missing; without it the marks in its view are unknown.",
                action="Give the centre of the camera's view in coordinates of the layout, to a few mm.",
            )
    assert head.nominal_center_mm is not None
    assert head.nominal_px_per_mm is not None
    r, (x, y) = head.nominal_px_per_mm, head.nominal_center_mm
    turn = np.radians(head.nominal_roll_deg or 0.0)
    c, s = r * np.cos(turn), r * np.sin(turn)
    u, v = (head.width - 1) / 2, (head.height - 1) / 2
    return np.array([[c, -s, u - c * x + s * y], [s, c, v - s * x - c * y], [0, 0, 1.0]])


def reach_mm(head: CameraHead) -> float:
    """Compute the largest accepted deviation of a view from its nominal position, mm."""
    # Less than half a view; otherwise marks of a neighbouring camera could be taken for marks of this camera.
    r = head.nominal_px_per_mm or 1.0
    return min(REACH_MM, _REACH_SHARE * min(head.width, head.height) / r)


def is_in_frame(head: CameraHead, px: Floats, margin_px: float = 0.0) -> NDArray[np.bool_]:
    """Return whether pixels (k, 2) lie in the frame, `margin_px` off its border; negative margins extend it."""
    limit = np.array([head.width - 1, head.height - 1]) - margin_px
    return np.asarray(((px >= margin_px) & (px <= limit)).all(-1))


def marks_in_view(head: CameraHead, camera: int, marks_mm: Floats, slack_mm: float = 0.0) -> NDArray[np.int_]:
    """Return the indices of the marks (k, 2) mm in the nominal view, extended by `slack_mm` on all sides."""
    n = nominal_matrix(head, camera)
    return np.flatnonzero(is_in_frame(head, apply(n, marks_mm), -slack_mm * (head.nominal_px_per_mm or 1.0)))
