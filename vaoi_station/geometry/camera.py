"""One camera over the conveyor: N_i, its lens, and what it sees of planes above the belt.

N_i (equation 10) is the homography of the calibrated plane. With the working distance known it
gives the camera's centre too, and with it the view of every plane at a height h: a point seen at
ground position X (where its ray meets the calibrated plane) and standing h above that plane is at
X + (h / d)·(F − X), F being the point of the plane right below the camera and d the distance.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike

from vaoi_station.geometry.lens import Lens
from vaoi_station.geometry.transforms import Floats, Projective, System, apply

_BORDER_POINTS = 9
"""Per side of the frame, whose places tell what a camera sees."""
_BOX_ROOM = 0.01
"""More than a usable lens bends a border between two of them, of the view."""


@dataclass(frozen=True)
class Camera:
    """A calibrated camera; `image_from_row` is the paper's N_i (row 0: tester coordinates)."""

    width_px: int
    height_px: int
    image_from_row: Projective
    lens: Lens
    working_distance_mm: float | None = None
    principal_point_px: tuple[float, float] | None = None

    @cached_property
    def row_from_image(self) -> Projective:
        """Undistorted pixels to mm in the calibrated plane."""
        return self.image_from_row.inverse()

    @cached_property
    def px_per_mm(self) -> float:
        """Resolution in the middle of the frame, the paper's r."""
        return self.image_from_row.scale_at(self.row_from_image(self.center_px))

    @property
    def center_px(self) -> tuple[float, float]:
        """Middle of the frame."""
        return (self.width_px - 1) / 2, (self.height_px - 1) / 2

    @cached_property
    def foot_mm(self) -> Floats:
        """The point of the calibrated plane straight below the camera, (2,) mm.

        From N_i = K [r1 r2 t] with the focal length that puts the camera at the working distance;
        without a working distance the middle of the view, which is what a camera that looks
        straight down has below it.
        """
        if self.working_distance_mm is None:
            return self.row_from_image(self.center_px)
        return _foot_of(self.image_from_row.matrix, self.principal_point_px or self.center_px, self.working_distance_mm)

    def ground(self, raw_px: ArrayLike, height_mm: ArrayLike = 0.0) -> Floats:
        """Where points seen at raw pixels (..., 2) are, in mm (..., 2), if they stand `height_mm` above the plane."""
        from vaoi_station.geometry.projection_kernels import image_to_ground

        raw, height, out = _paired(raw_px, height_mm)
        n = self.row_from_image.matrix
        image_to_ground(raw, height, self._eye, n, self.lens.coefficients, self.lens.shape, out.reshape(-1, 2))
        return out

    def view_mm(self, margin_px: float = 0.0, heights_mm: tuple[float, float] = (0.0, 0.0)) -> tuple[Floats, Floats]:
        """Corners of a box that holds all places seen at least a margin inside the frame, at heights between two.

        It is a little too large, for what lenses do between the points of the border that are looked at.
        """
        if margin_px == 0 and heights_mm == (0.0, 0.0):
            return self._view_mm
        return self._seen_mm(margin_px, heights_mm)

    @cached_property
    def _view_mm(self) -> tuple[Floats, Floats]:
        return self._seen_mm(0.0, (0.0, 0.0))

    def _seen_mm(self, margin_px: float, heights_mm: tuple[float, float]) -> tuple[Floats, Floats]:
        x = np.linspace(margin_px, self.width_px - 1 - margin_px, _BORDER_POINTS)
        y = np.linspace(margin_px, self.height_px - 1 - margin_px, _BORDER_POINTS)
        border = [np.column_stack([x, np.full_like(x, end)]) for end in (y[0], y[-1])]
        border += [np.column_stack([np.full_like(y, end), y]) for end in (x[0], x[-1])]
        seen = np.concatenate([self.ground(np.concatenate(border), height) for height in heights_mm])
        room = _BOX_ROOM * np.ptp(seen, axis=0)
        return np.asarray(seen.min(0) - room), np.asarray(seen.max(0) + room)

    def parallax(self, ground_mm: ArrayLike) -> Floats:
        """mm per mm of height by which a point seen at ground position (..., 2) really lies elsewhere, (..., 2)."""
        ground = np.asarray(ground_mm, dtype=np.float64)
        if self.working_distance_mm is None:
            return np.zeros_like(ground)
        return np.asarray((self.foot_mm - ground) / self.working_distance_mm, dtype=np.float64)

    def project(self, place_mm: ArrayLike, height_mm: ArrayLike = 0.0) -> Floats:
        """Raw pixels (..., 2) of points at places (..., 2) in mm, `height_mm` above the plane."""
        from vaoi_station.geometry.projection_kernels import ground_to_image

        place, height, out = _paired(place_mm, height_mm)
        n = self.image_from_row.matrix
        ground_to_image(place, height, self._eye, n, self.lens.coefficients, self.lens.shape, out.reshape(-1, 2))
        return out

    @cached_property
    def _eye(self) -> tuple[float, float, float]:
        """Foot, and the inverse of the working distance: 0 where that is not known, so that heights do nothing."""
        x, y = self.foot_mm
        return float(x), float(y), 0.0 if self.working_distance_mm is None else 1 / self.working_distance_mm

    def image_from_row_at(self, height_mm: float) -> Projective:
        """The homography of the plane at a height: undistorted pixels of places in that plane."""
        if self.working_distance_mm is None or height_mm == 0:
            return self.image_from_row
        k = height_mm / self.working_distance_mm
        x, y = self.foot_mm
        ground_from_place = np.array([[1, 0, -k * x], [0, 1, -k * y], [0, 0, 1 - k]])
        return Projective(self.image_from_row.matrix @ ground_from_place, System.IMAGE, System.ROW)

    def sees(self, raw_px: ArrayLike, margin_px: float = 0.0) -> np.ndarray:
        """Whether raw pixels (..., 2) lie inside the frame, kept off its border by a margin; equation 22."""
        p = np.asarray(raw_px, dtype=np.float64)
        x, y, low = p[..., 0], p[..., 1], margin_px
        return np.asarray((x >= low) & (y >= low) & (x <= self.width_px - 1 - low) & (y <= self.height_px - 1 - low))


def _paired(points: ArrayLike, height: ArrayLike) -> tuple[Floats, Floats, Floats]:
    """Points (k, 2) with their heights (k,), or (1,) for all, and room for the answer in the shape of the question."""
    p, h = np.asarray(points, dtype=np.float64), np.asarray(height, dtype=np.float64)
    if h.ndim and h.shape != p.shape[:-1]:
        shape = np.broadcast_shapes(p.shape[:-1], h.shape)
        p, h = np.broadcast_to(p, (*shape, 2)).copy(), np.broadcast_to(h, shape).copy()
    return np.ascontiguousarray(p).reshape(-1, 2), np.ascontiguousarray(h).reshape(-1), np.empty(p.shape)


def _foot_of(n: Floats, principal_point_px: tuple[float, float], distance_mm: float) -> Floats:
    """Camera centre projected on the plane, from a homography with known principal point and distance.

    The focal length that fits the distance is found by fixed-point iteration: the distance a trial
    focal length gives is proportional to it, up to the small tilt of the camera.
    """
    x, y = principal_point_px
    middle = apply(np.linalg.inv(n), (x, y))
    f = Projective(n, System.IMAGE, System.ROW).scale_at(middle) * distance_mm
    centre = np.zeros(3)
    for _ in range(5):
        b = np.linalg.inv(np.array([[f, 0, x], [0, f, y], [0, 0, 1]])) @ n
        b = b / ((np.linalg.norm(b[:, 0]) + np.linalg.norm(b[:, 1])) / 2)
        r3 = np.cross(b[:, 0], b[:, 1])
        rotation = _nearest_rotation(np.column_stack([b[:, 0], b[:, 1], r3 / np.linalg.norm(r3)]))
        centre = -rotation.T @ b[:, 2]
        f *= distance_mm / abs(centre[2])
    return np.asarray(centre[:2])


def _nearest_rotation(m: Floats) -> Floats:
    u, _, vt = np.linalg.svd(m)
    return np.asarray(u @ vt)
