"""A calibration: the camera matrices N_i and the distortion of the lenses."""

from __future__ import annotations

from typing import Annotated, Any, Literal, Self

import numpy as np
from numpy.typing import NDArray
from pydantic import BeforeValidator, Field, PlainSerializer, model_validator

from vaoi_station.geometry import Camera, Lens, Projective, System
from vaoi_station.geometry.camera_error import VAGUE_PX, place_sigma_px
from vaoi_station.model.frozen_model import (
    MOST_MM,
    Finite,
    FrozenModel,
    Matrix,
    Pixels,
    PointPx,
    Positive,
    parse_square,
)
from vaoi_station.model.recording import CameraHead

_FIELDS = 9
"""Number of basis fields of a camera's error; see `geometry.camera_error`."""
_ROUNDING = 1e-9
"""Accepted asymmetry, and accepted negative eigenvalues, of a covariance relative to its largest entry."""


def _parse_covariance(value: Any) -> NDArray[np.float64]:
    """Convert nested lists to a read-only, finite, symmetric, positive semidefinite (9, 9) matrix."""
    m = parse_square(value, _FIELDS)
    slack = _ROUNDING * float(np.abs(m).max())
    if np.abs(m - m.T).max() > slack:
        raise ValueError("is not symmetric, but a covariance must be")
    if np.linalg.eigvalsh((m + m.T) / 2)[0] < -slack:
        raise ValueError("has a negative eigenvalue, but a covariance must not")
    m.setflags(write=False)
    return m


Covariance = Annotated[NDArray[np.float64], BeforeValidator(_parse_covariance), PlainSerializer(lambda m: m.tolist())]
"""Covariance (9, 9) of the coefficients of a camera's error, px²; see `geometry.camera_error`."""


class Distortion(FrozenModel):
    """Radial distortion of one lens: centre and radius in px, and coefficients; see `geometry.Lens`."""

    center: PointPx
    """Centre c of the distortion, px."""
    radius: Annotated[Positive, Field(ge=1, le=1e6)]
    """Radius R, px."""
    radial: tuple[Annotated[Finite, Field(ge=-10, le=10)], ...]
    """Coefficients a1, a2, …."""


class Calibration(FrozenModel):
    """The content of calibration.json: camera matrices N_i (tester → undistorted pixels), lenses and covariances."""

    format: Literal["vaoi-calibration"]
    version: Literal[1]
    unit: Literal["mm"]
    """Unit of the tester's plane."""
    camera_matrices: Annotated[tuple[Matrix, ...], Field(min_length=1)]
    """N_i of every camera."""
    working_distance_mm: Annotated[Positive, Field(ge=1, le=MOST_MM)] | None = None
    """Height of the cameras above the calibrated plane. Empty: heights have no parallax."""
    residual_px: tuple[Pixels, ...] | None = None
    """Residual of every camera."""
    principal_point: tuple[PointPx, ...] | None = None
    """Where each optical axis meets the image, px. Empty: the middle of the image."""
    created: str | None = None
    """When it was made."""
    covariances: Any = None
    """Of every camera: covariance of n11 n12 n13 n21 n22 n23 n31 n32 (n33 = 1) and the radial coefficients."""
    covariance: tuple[Covariance, ...] | None = None
    """Of every camera: covariance, 9 × 9, of the error of N_i and its lens over the frame, px²."""
    distortion: tuple[Distortion, ...] | None = None
    """Lens of every camera. Empty: ideal lenses."""

    @model_validator(mode="after")
    def _one_entry_per_camera(self) -> Self:
        n = len(self.camera_matrices)
        for key in ("residual_px", "principal_point", "covariance", "distortion"):
            value = getattr(self, key)
            if value is not None and len(value) != n:
                raise ValueError(f"{key} has {len(value)} entries, must have one per camera: {n}")
        return self

    @property
    def uncalibrated(self) -> tuple[int, ...]:
        """The cameras whose place it does not know, as after an exchange; their N_i are those of their predecessors."""
        return tuple(i for i, known in enumerate(self.covariance or ()) if place_sigma_px(known) > VAGUE_PX)

    def cameras(self, heads: tuple[CameraHead, ...]) -> tuple[Camera, ...]:
        """Return one calibrated camera per head. The heads give the frame sizes."""
        # A lens without coefficients is ideal; its centre and radius are then irrelevant.
        lenses = [Lens((0.0, 0.0), 1.0)] * len(heads)
        if self.distortion:
            lenses = [Lens(d.center, d.radius, d.radial) for d in self.distortion]
        return tuple(
            Camera(
                width_px=head.width,
                height_px=head.height,
                image_from_row=Projective(self.camera_matrices[i], System.IMAGE, System.ROW),
                lens=lenses[i],
                working_distance_mm=self.working_distance_mm,
                principal_point_px=self.principal_point[i] if self.principal_point else None,
                covariance_px2=self.covariance[i] if self.covariance else None,
            )
            for i, head in enumerate(heads)
        )
