"""A calibrated camera over the conveyor: N_i, its lens, and the projection of planes above the belt.

N_i (equation 10) is the homography of the calibrated plane. If the working distance d is known, N_i also gives
the camera centre, and so the projection of a plane at height h. Let X be the ground position of a pixel: the point
where its ray meets the calibrated plane. A point at height h on this ray lies at X + (h / d)·(F − X), where F is the
foot of the camera: the point of the plane vertically below the camera centre.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from vaoi_station.geometry.lens import Lens
from vaoi_station.geometry.transforms import Floats, Projective, System

if TYPE_CHECKING:
    from vaoi_station.geometry.projection_kernels import CameraArrays

_BORDER_POINTS, _BOX_MARGIN = 9, 0.01
"""Points per side of the frame from which the box of the view is computed, and its margin as a share of its size.

A usable lens bends the border of the view between two of these points by less than this."""
_FOOT_ITERATIONS = 5


@dataclass(frozen=True)
class Camera:
    """A calibrated camera over the conveyor. Its homography `image_from_row` is the paper's N_i."""

    width_px: int
    height_px: int
    image_from_row: Projective
    lens: Lens
    working_distance_mm: float | None = None
    principal_point_px: tuple[float, float] | None = None
    covariance_px2: Floats | None = field(default=None, compare=False, repr=False)
    """Covariance (9, 9) of the calibration's error, px²: see `geometry.camera_error`. None if it is unknown."""

    @cached_property
    def row_from_image(self) -> Projective:
        """The inverse of N_i: the homography from undistorted pixels to row coordinates, mm."""
        return self.image_from_row.inverse()

    @cached_property
    def px_per_mm(self) -> float:
        """Resolution at the centre of the frame, the paper's r."""
        return self.image_from_row.scale_onto(self.center_px)

    @property
    def center_px(self) -> tuple[float, float]:
        """The centre of a frame as (x, y), px."""
        return (self.width_px - 1) / 2, (self.height_px - 1) / 2

    @cached_property
    def foot_mm(self) -> Floats:
        """The point of the calibrated plane vertically below the camera centre, (2,) mm.

        If the working distance is unknown, it is the centre of the view, which is exact for a camera without tilt.
        """
        if self.working_distance_mm is None:
            return self.row_from_image(self.center_px)
        return _foot_of(self.image_from_row, self.principal_point_px or self.center_px, self.working_distance_mm)

    @cached_property
    def viewpoint(self) -> tuple[float, float, float]:
        """The foot (x, y), mm, and the inverse working distance, 1/mm: 0 if unknown, so that heights have no effect."""
        x, y = self.foot_mm
        return float(x), float(y), 0.0 if self.working_distance_mm is None else 1 / self.working_distance_mm

    @cached_property
    def arrays(self) -> CameraArrays:
        """The camera as compiled functions take it."""
        return camera_arrays([self])

    def ground(self, raw_px: ArrayLike, height_mm: ArrayLike = 0.0) -> Floats:
        """Project raw pixels (..., 2) to points (..., 2) in mm, `height_mm` above the calibrated plane."""
        from vaoi_station.geometry.projection_kernels import image_to_ground

        raw, height, out = _flatten_pairs(raw_px, height_mm)
        image_to_ground(raw, height, self.arrays, out.reshape(-1, 2))
        return out

    def project(self, place_mm: ArrayLike, height_mm: ArrayLike = 0.0) -> Floats:
        """Project points (..., 2) in mm, `height_mm` above the calibrated plane, to raw pixels (..., 2)."""
        from vaoi_station.geometry.projection_kernels import ground_to_image

        place, height, out = _flatten_pairs(place_mm, height_mm)
        ground_to_image(place, height, self.arrays, out.reshape(-1, 2))
        return out

    def view_mm(self) -> tuple[Floats, Floats]:
        """Return the lowest and the highest corner, mm, of a box on the calibrated plane around what a frame shows."""
        return self._view_mm

    @cached_property
    def _view_mm(self) -> tuple[Floats, Floats]:
        x, y = (np.linspace(0, size - 1, _BORDER_POINTS) for size in (self.width_px, self.height_px))
        border = [np.column_stack([x, np.full_like(x, end)]) for end in (y[0], y[-1])]
        border += [np.column_stack([np.full_like(y, end), y]) for end in (x[0], x[-1])]
        # Not `ground`: a process that only chooses pictures, as the station's own, needs no machine code then.
        seen = self.row_from_image(self.lens.undistort(np.concatenate(border)))
        extra = _BOX_MARGIN * np.ptp(seen, axis=0)
        return np.asarray(seen.min(0) - extra), np.asarray(seen.max(0) + extra)

    def parallax(self, ground_mm: ArrayLike) -> Floats:
        """Return by how much a raised point lies off the ground points (..., 2) at which it is seen, per mm of height.

        0 if the working distance is unknown.
        """
        x, y, inverse = self.viewpoint
        return np.asarray(((x, y) - np.asarray(ground_mm, dtype=np.float64)) * inverse)

    def image_from_row_at(self, height_mm: float) -> Projective:
        """Return the homography from the plane at a height above the calibrated plane to undistorted pixels."""
        x, y, inverse = self.viewpoint
        if (k := height_mm * inverse) == 0:
            return self.image_from_row
        ground_from_place = np.array([[1, 0, -k * x], [0, 1, -k * y], [0, 0, 1 - k]])
        return Projective(self.image_from_row.matrix @ ground_from_place, System.IMAGE, System.ROW)

    def sees(self, raw_px: ArrayLike, margin_px: float = 0.0) -> np.ndarray:
        """Return whether raw pixels (..., 2) lie in the frame, at least `margin_px` off its border; equation 22."""
        # Comparisons with NaN are false: a pixel that cannot be computed counts as outside.
        p = np.asarray(raw_px, dtype=np.float64)
        x, y, low = p[..., 0], p[..., 1], margin_px
        return np.asarray((x >= low) & (y >= low) & (x <= self.width_px - 1 - low) & (y <= self.height_px - 1 - low))


def camera_arrays(cameras: Sequence[Camera]) -> CameraArrays:
    """Return the parameters of cameras as arrays for compiled functions."""
    # Imported here, because Numba takes a moment to load and many callers of this package never project.
    from vaoi_station.geometry.projection_kernels import CameraArrays

    radial = np.zeros((len(cameras), max((len(c.lens.coefficients) for c in cameras), default=0)))
    for own, camera in zip(radial, cameras, strict=True):
        own[: len(camera.lens.coefficients)] = camera.lens.coefficients
    return CameraArrays(
        np.array([c.image_from_row.matrix for c in cameras]),
        np.array([c.row_from_image.matrix for c in cameras]),
        radial,
        np.array([c.lens.shape for c in cameras]),
        np.array([c.viewpoint for c in cameras]),
    )


def _flatten_pairs(points: ArrayLike, height: ArrayLike) -> tuple[Floats, Floats, Floats]:
    """Return points (k, 2) and heights (k,), or one height (1,) for all, and an output array in the points' shape."""
    p, h = np.asarray(points, dtype=np.float64), np.asarray(height, dtype=np.float64)
    if h.ndim and h.shape != p.shape[:-1]:
        shape = np.broadcast_shapes(p.shape[:-1], h.shape)
        p, h = np.broadcast_to(p, (*shape, 2)).copy(), np.broadcast_to(h, shape).copy()
    return np.ascontiguousarray(p).reshape(-1, 2), np.ascontiguousarray(h).reshape(-1), np.empty(p.shape)


def _foot_of(image_from_row: Projective, principal_point_px: tuple[float, float], distance_mm: float) -> Floats:
    """Compute the camera's foot (2,), mm, from its homography, principal point and working distance.

    A fixed-point iteration finds the focal length that fits the distance: the distance is proportional to it except for
    the small tilt. Plain numbers, because numpy takes ten times as long, and this is part of the time of a result.
    """
    x, y = principal_point_px
    f, foot = image_from_row.scale_onto(principal_point_px) * distance_mm, (0.0, 0.0)
    columns = image_from_row.matrix.T.tolist()
    for _ in range(_FOOT_ITERATIONS):
        a, b, c = (((u - x * w) / f, (v - y * w) / f, w) for u, v, w in columns)
        # Two columns of a rotation have length 1; their mean length is the unknown scale of the homography.
        scale = (math.hypot(*a) + math.hypot(*b)) / 2
        p, q, r, u, v = (_dot(*two) / scale**2 for two in ((a, a), (a, b), (b, b), (a, c), (b, c)))
        # With noise, the columns are not exactly orthonormal. Therefore the nearest rotation is taken: the third one is
        # perpendicular to the others, so it is theirs that changes, by the inverse root of their products.
        root = math.sqrt(p * r - q * q)
        size = root * math.sqrt(p + r + 2 * root)
        foot = (-((r + root) * u - q * v) / size, -((p + root) * v - q * u) / size)
        normal = (a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0])
        f *= distance_mm * math.hypot(*normal) / abs(_dot(normal, c) / scale)
    return np.array(foot)


def _dot(a: Sequence[float], b: Sequence[float]) -> float:
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
