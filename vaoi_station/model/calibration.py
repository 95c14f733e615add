"""A calibration: the camera matrices N_i and the distortion of the lenses."""

from __future__ import annotations

from typing import Annotated, Any, Literal, Self

from pydantic import Field, model_validator

from vaoi_station.geometry import Camera, Lens, Projective, System
from vaoi_station.model.frozen_model import Finite, FrozenModel, Matrix, Point, Positive
from vaoi_station.model.recording import CameraHead


class Distortion(FrozenModel):
    """Radial distortion of one lens: centre and radius in px, and coefficients; see `geometry.Lens`."""

    center: Point
    radius: Positive
    radial: tuple[Finite, ...]


class Calibration(FrozenModel):
    """The content of calibration.json: camera matrices N_i (tester → undistorted pixels), lenses and covariances."""

    format: Literal["vaoi-calibration"]
    version: Literal[1]
    unit: Literal["mm"]
    camera_matrices: Annotated[tuple[Matrix, ...], Field(min_length=1)]
    working_distance_mm: Positive | None = None
    residual_px: tuple[Finite, ...] | None = None
    principal_point: tuple[Point, ...] | None = None
    created: str | None = None
    covariances: Any = None
    distortion: tuple[Distortion, ...] | None = None

    @model_validator(mode="after")
    def _one_entry_per_camera(self) -> Self:
        n = len(self.camera_matrices)
        for key in ("residual_px", "principal_point", "distortion"):
            value = getattr(self, key)
            if value is not None and len(value) != n:
                raise ValueError(f"{key} has {len(value)} entries, must have one per camera: {n}")
        return self

    def cameras(self, heads: tuple[CameraHead, ...]) -> tuple[Camera, ...]:
        """Return one calibrated camera per head. The heads give the frame sizes."""
        return tuple(self._camera(i, head) for i, head in enumerate(heads))

    def _camera(self, i: int, head: CameraHead) -> Camera:
        # A lens without coefficients is ideal; its centre and radius are then irrelevant.
        d = self.distortion[i] if self.distortion else None
        return Camera(
            width_px=head.width,
            height_px=head.height,
            image_from_row=Projective(self.camera_matrices[i], System.IMAGE, System.ROW),
            lens=Lens(d.center, d.radius, d.radial) if d else Lens((0.0, 0.0), 1.0),
            working_distance_mm=self.working_distance_mm,
            principal_point_px=self.principal_point[i] if self.principal_point else None,
        )
