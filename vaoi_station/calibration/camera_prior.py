"""Prior knowledge about a camera before it sees any mark: limits of its lens, of its mounting, and of the board.

Marks cannot determine everything: from four marks, no distortion can be estimated. Whatever the marks leave open has
the standard deviations below, in px at the corner of the frame, and so enters the covariance of the calibration.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from vaoi_station.geometry.camera_error import FIELDS, basis_fields
from vaoi_station.geometry.transforms import Floats, apply

RADIAL_PX = 1.5
"""Standard deviation of the radial distortion at the corner. Industrial lenses have 0.1 to 0.3 % of the distance."""
HIGHER_ORDER = 0.05
"""Part of the radial distortion that is not proportional to the cube of the radius: its standard deviation, as a
share."""
_SECOND_PX = 0.5
"""Standard deviation of a second radial coefficient, which is estimated only if it is significant and marks are
many."""
_STRETCH_PX = 0.5
"""Standard deviation of the stretch of a view.

A tilt by 2° stretches a view by 0.06 %, and prints differ by as much between their axes."""
_TILT_RAD = math.radians(2.0)
"""Standard deviation of the tilt of a camera. The largest plausible tilt, 6°, is three times this."""
SHAPE, RADIAL = slice(4, 8), 8
"""Positions of stretch and perspective, and of radial distortion, in the basis of `geometry.camera_error`."""
_GRID = np.stack(np.meshgrid(np.linspace(-0.8, 0.8, 9), np.linspace(-0.6, 0.6, 7)), -1).reshape(-1, 2)
"""Points of a frame of 4 : 3, normalised, at which the basis of `geometry.camera_error` is fitted to displacements."""
_TO_BASIS = np.linalg.pinv(basis_fields(_GRID).reshape(-1, FIELDS))


@dataclass(frozen=True)
class CameraPrior:
    """Prior knowledge about one camera, and the standard deviations in px that follow from it.

    The accuracies of the calibration board are standard deviations in mm; 0 means exact.
    """

    center_px: tuple[float, float]
    radius_px: float
    """Half the diagonal of the frame."""
    px_per_mm: float = 1.0
    working_distance_mm: float | None = None
    mark_accuracy_mm: float = 0.0
    """Standard deviation of the positions of marks on the board, per axis."""
    flatness_mm: float = 0.0
    """Standard deviation, mm, of the board's height within one view, because boards are not exactly flat."""

    @property
    def distance_mm(self) -> float:
        """The working distance, mm. If it is unknown, the smallest that a lens has: the diagonal of the view."""
        return self.working_distance_mm or 2 * self.radius_px / self.px_per_mm

    @property
    def print_px(self) -> float:
        """Standard deviation, per axis, of the positions of marks due to their print, px."""
        return self.mark_accuracy_mm * self.px_per_mm

    @property
    def grid_px(self) -> Floats:
        """Points (k, 2) of the frame at which the basis of `geometry.camera_error` is fitted to displacements."""
        return _GRID * self.radius_px + self.center_px

    def sigma_px(self, order: int) -> Floats:
        """Return the standard deviations of stretch (2), perspective (2) and `order` radial coefficients, px."""
        # A tilt α moves the corner by R²·tan α / f, with the focal length f = resolution · distance.
        tilt = self.radius_px**2 * math.tan(_TILT_RAD) / (self.px_per_mm * self.distance_mm)
        return np.array([_STRETCH_PX, _STRETCH_PX, tilt, tilt, RADIAL_PX, _SECOND_PX][: 4 + order])

    def flatness_covariance_px2(self) -> Floats:
        """Compute the covariance (9, 9) px² of a camera's error that results from a board that is not flat.

        The nine coefficients of the error are those of `geometry.camera_error`.
        """
        # A height h moves the picture by (u, v)·R·h/d. Heights that are constant, linear and quadratic over the view
        # look like scale, perspective and radial distortion, from which marks in one picture cannot distinguish them.
        variance = np.zeros(FIELDS)
        variance[[3, 6, 7, RADIAL]] = (self.radius_px * self.flatness_mm / self.distance_mm) ** 2
        return np.diag(variance)


def to_basis(fields: Floats) -> Floats:
    """Compute the coefficients (9, p) of displacement fields, given at the grid of a camera as (k, 2, p)."""
    return np.asarray(_TO_BASIS @ fields.reshape(-1, fields.shape[-1]))


def shape_of_view(prior: CameraPrior, image_from_plane: Floats) -> Floats:
    """Compute stretch and perspective (4,) of a homography plane → undistorted px, in px at the corner."""
    # Stretch and perspective are what remains of the picture of a plane after the best similarity is removed.
    image = (prior.grid_px - prior.center_px) @ np.array([1, 1j])
    plane = apply(np.linalg.inv(image_from_plane), prior.grid_px) @ np.array([1, 1j])
    design = np.column_stack([plane, np.ones_like(plane)])
    rest = image - design @ np.linalg.lstsq(design, image, rcond=None)[0]
    return to_basis(np.stack([rest.real, rest.imag], -1)[..., None])[SHAPE, 0]
