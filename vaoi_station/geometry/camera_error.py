"""The error of a calibration as a displacement field over the frame: nine basis fields, and their covariance.

According to the calibration, a camera projects a point to q. A measurement of the point lies at q + e(q) + noise. The
field e is unknown, and is constant over all frames of a calibration: e(u, v) = Σ_k c_k·b_k(u, v), with u = (x − (w −
1)/2)/R, v = (y − (h − 1)/2)/R, and R half the diagonal of the frame, px.

| k | b_k | |
|---|---|---|
| 0, 1 | (1, 0), (0, 1) | shift |
| 2, 3 | (−v, u), (u, v) | turn, scale |
| 4, 5 | (u, −v), (v, u) | stretch along the axes and along the diagonals |
| 6, 7 | (u², uv), (uv, v²) | perspective |
| 8 | (u, v)·(u² + v²) | radial distortion |

Fields 0 to 7 are the eight parameters of a homography to first order. c is in px; at a corner u² + v² = 1, so that c_2,
c_3 and c_8 are displacements at the corner. `Camera.covariance_px2` is the covariance (9, 9) of c.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike

from vaoi_station.geometry.camera import Camera
from vaoi_station.geometry.transforms import Floats

FIELDS = 9  # number of basis fields of which the error of a camera consists
PLACE_FIELDS = 3  # the first fields, shift and turn: where a camera hangs
VAGUE_PX = 5.0
"""Standard deviation of shift or turn, px, from which on a camera counts as not calibrated, as after its exchange."""


def place_sigma_px(covariance: Floats | None) -> float:
    """Return the standard deviation, px, to which it is known where a camera hangs, by its covariance (9, 9), px²."""
    return 0.0 if covariance is None else float(np.sqrt(np.diag(covariance)[:PLACE_FIELDS].max()))


def uncalibrated(cameras: Sequence[Camera]) -> tuple[int, ...]:
    """Return the cameras of which the calibration says that it does not know where they hang."""
    return tuple(i for i, camera in enumerate(cameras) if place_sigma_px(camera.covariance_px2) > VAGUE_PX)


def frame_radius_px(camera: Camera) -> float:
    """Return R, half the diagonal of the frame, px."""
    return float(np.hypot(camera.width_px, camera.height_px)) / 2


def basis_px(camera: Camera, points_px: ArrayLike) -> Floats:
    """Evaluate the basis fields at undistorted pixels (k, 2) of a camera.

    Returns:
        (k, 2, 9): the displacement in x and y for c_k = 1 px. With coefficients c, the displacement is `basis @ c`.
    """
    return basis_fields((np.asarray(points_px, dtype=np.float64) - camera.center_px) / frame_radius_px(camera))


def basis_fields(uv: ArrayLike) -> Floats:
    """Evaluate the basis fields (k, 2, 9) at normalised image coordinates (k, 2)."""
    u, v = np.moveaxis(np.asarray(uv, dtype=np.float64), -1, 0)
    one, nil, rho2 = np.ones_like(u), np.zeros_like(u), u * u + v * v
    x = [one, nil, -v, u, u, v, u * u, u * v, u * rho2]
    y = [nil, one, u, v, -v, u, u * v, v * v, v * rho2]
    return np.stack([np.stack(x, -1), np.stack(y, -1)], -2)
