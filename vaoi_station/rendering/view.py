"""The view of one component in one frame: what a temporary image shows, and the matrices to render it."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal, NamedTuple

import numpy as np

from vaoi_station.geometry import Projective, System
from vaoi_station.geometry.transforms import Floats

Plane = Literal["board", "top"]
"""Plane in which a temporary image is right: the board's surface, or the top of the component's body."""

_VERTICAL = 1e-3
"""Tangent of the angle below which a view has no azimuth: it is seen from straight above."""


class Tile(NamedTuple):
    """A rectangular part of a picture: columns x0 to x1 and rows y0 to y1, ends excluded."""

    x0: int
    y0: int
    x1: int
    y1: int
    matrix: Floats
    """(3, 3) from pixels of the tile, counted from its corner, to raw pixels of the frame."""


@dataclass(eq=False, slots=True)
class View:
    """The view of one component in one frame. It is not changed after it is made."""

    # Not `frozen`: a board has thousands of views, and `object.__setattr__` for every field would double their cost.
    camera: int
    row: int
    width: int
    height: int
    px_per_mm: float
    coverage: float
    """Share of the component's footprint that lies inside the frame."""
    off_center: float
    """Distance from the component's centre to the frame's centre, in half diagonals; 0 is seen from straight above."""
    crop_matrix: Floats
    """(3, 3) matrix from CAD coordinates to pixels of the picture."""
    matrix: Floats
    """(3, 3) matrix from pixels of the picture to raw pixels of the frame; to undistorted pixels if `distorted`."""
    tiles: tuple[Tile, ...]
    """Parts of the picture, each with a matrix to raw pixels, if the view is `distorted`; otherwise empty."""
    outline_px: Floats
    """(4, 2) corners of the component's footprint in raw pixels of the frame, going round."""
    toward: Floats
    """(3,) vector from the component to the camera, mm: along CAD x, along CAD y, up; NaN if it is unknown."""
    lift_px: Floats
    """(2,) shift of the component's centre in the frame per mm of height, px."""
    plane: Plane
    """Plane in which the picture is right."""
    height_mm: float
    """Height of that plane above the board's surface."""

    @property
    def distorted(self) -> bool:
        """Whether the lens distorts this picture too much for a single matrix."""
        return bool(self.tiles)

    @property
    def crop_from_cad(self) -> Projective:
        """Transform from CAD coordinates to pixels of the picture."""
        return Projective(self.crop_matrix, System.CROP, System.CAD)

    @property
    def cad_from_crop(self) -> Projective:
        """Transform from pixels of the picture to CAD coordinates."""
        return self.crop_from_cad.inverse()

    @property
    def image_from_crop(self) -> Projective:
        """Transform from pixels of the picture to pixels of the frame, with the matrix `matrix`."""
        return Projective(self.matrix, System.IMAGE, System.CROP)

    @property
    def frame_px_per_mm(self) -> float:
        """Resolution of the frame at the component's centre, px/mm."""
        return self.image_from_crop.scale_at(((self.width - 1) / 2, (self.height - 1) / 2)) * self.px_per_mm

    @property
    def angle_deg(self) -> float | None:
        """Angle between the line of sight to the component's centre and the vertical; None if it is unknown."""
        x, y, z = self.toward.tolist()
        return None if math.isnan(z) else math.degrees(math.atan2(math.hypot(x, y), z))

    @property
    def azimuth_deg(self) -> float | None:
        """Direction in CAD from which the component is seen, from the x axis towards the y axis, 0 to 360.

        None if it is unknown, or if the component is seen from straight above.
        """
        x, y, z = self.toward.tolist()
        if math.isnan(z) or math.hypot(x, y) < _VERTICAL * z:
            return None
        return math.degrees(math.atan2(y, x)) % 360

    @property
    def picture_azimuth_deg(self) -> float | None:
        """The same direction in the picture: 0 right, 90 up, 180 left, 270 down; None where `azimuth_deg` is None."""
        if self.azimuth_deg is None:
            return None
        x, y = (self.crop_matrix[:2, :2] @ self.toward[:2]).tolist()
        # The picture's y axis points down.
        return math.degrees(math.atan2(-y, x)) % 360

    def covariance_px2(self, of_centre: Floats | None, height_sigma_mm: float = 0.0) -> Floats | None:
        """Return the covariance (2, 2) of the component's place in the frame, px²; None if it is unknown.

        Args:
            of_centre: covariance (2, 2) of the component's centre on the board's surface, from the result of the run.
            height_sigma_mm: standard deviation of the height of the picture's plane above the surface.
        """
        if of_centre is None:
            return None
        return np.asarray(of_centre + np.outer(self.lift_px, self.lift_px) * height_sigma_mm**2, dtype=np.float64)


def sigma_px(covariance_px2: Floats | None) -> float | None:
    """Return the standard deviation, px, along the direction in which it is largest; None without a covariance."""
    return None if covariance_px2 is None else math.sqrt(max(float(np.linalg.eigvalsh(covariance_px2)[-1]), 0.0))
