"""The `[array]` table of a scenario file: the design of the camera array, its mounting errors, lenses and sensors.

The cameras of an array are alike unless the keys `camera_…` give each its own resolution, frame size or mounting.
"""

from __future__ import annotations

from itertools import pairwise
from typing import Annotated, Literal

from pydantic import Field

from vaoi_station.model import Strict

Finite = Annotated[float, Field(allow_inf_nan=False)]
Positive = Annotated[float, Field(gt=0, allow_inf_nan=False)]
NotNegative = Annotated[float, Field(ge=0, allow_inf_nan=False)]
Share = Annotated[float, Field(ge=0, le=1)]
Index = Annotated[int, Field(ge=0)]
PerCamera = Annotated[tuple[Positive, ...], Field(min_length=1)]
Side = Annotated[int, Field(ge=32, le=16384)]
"""Width or height of a frame, px."""


class Section(Strict):
    """Base class of all tables of a scenario file."""


class ArraySection(Section):
    """The camera array: design, mounting errors, lenses and sensors."""

    cameras: Annotated[int, Field(ge=1, le=64)] = 3
    width_px: Side = 1392
    height_px: Side = 1040
    px_per_mm: Positive = 40.0
    working_distance_mm: Positive = 483.0
    overlap: Annotated[float, Field(ge=1, le=16)] = 1.05
    tilt_deg: NotNegative = 0.115
    roll_deg: NotNegative = 0.23
    position_mm: NotNegative = 0.15
    focal_length: Annotated[float, Field(ge=0, le=0.1)] = 0.002
    distortion_px: Finite = 0.0
    exposures_us: PerCamera = (250.0,)
    reference_exposure_us: Positive = 250.0
    gain: Positive = 1.0
    black_level: NotNegative = 2.0
    vignetting: Annotated[float, Field(ge=0, lt=1)] = 0.25
    psf_px: NotNegative = 0.6
    shot_noise: NotNegative = 0.03
    read_noise: NotNegative = 1.5
    flicker: NotNegative = 0.01
    bits: Literal[8, 16] = 8
    seed: Index = 11
    camera_px_per_mm: tuple[Positive, ...] = ()
    camera_frame_px: tuple[tuple[Side, Side], ...] = ()
    camera_roll_deg: Annotated[tuple[Finite, ...], Field(min_length=1)] = (0.0,)

    @property
    def pitch_mm(self) -> float:
        """Distance of neighbouring cameras: the width of a field of view divided by the overlap m_h."""
        return self.width_px / self.px_per_mm / self.overlap

    @property
    def view_mm(self) -> tuple[float, float]:
        """Nominal field of view of one camera, mm: its extent across and along the motion."""
        return self.width_px / self.px_per_mm, self.height_px / self.px_per_mm

    def exposure_us(self, camera: int) -> float:
        """Return the exposure time of one camera. A list with fewer entries than cameras is repeated."""
        return self.exposures_us[camera % len(self.exposures_us)]

    @property
    def finest_px_per_mm(self) -> float:
        """The highest design resolution of any camera."""
        return max(self.resolution_px_per_mm(i) for i in range(self.cameras))

    def resolution_px_per_mm(self, camera: int) -> float:
        """Return the design resolution of one camera. A list with fewer entries than cameras is repeated."""
        own = self.camera_px_per_mm
        return own[camera % len(own)] if own else self.px_per_mm

    def frame_px(self, camera: int) -> tuple[int, int]:
        """Return width and height of the frames of one camera. A list with fewer entries than cameras is repeated."""
        own = self.camera_frame_px
        return own[camera % len(own)] if own else (self.width_px, self.height_px)

    def design_roll_deg(self, camera: int) -> float:
        """Return by how much one camera is mounted rotated, from image x towards image y; 180 is upside down."""
        return self.camera_roll_deg[camera % len(self.camera_roll_deg)]

    def camera_view_mm(self, camera: int) -> tuple[float, float]:
        """Return the nominal field of view of one camera, mm: its extent across and along the motion.

        The roll is rounded to quarter turns.
        """
        (w, h), r = self.frame_px(camera), self.resolution_px_per_mm(camera)
        return (h / r, w / r) if self._lies_across(camera) else (w / r, h / r)

    def center_mm(self, camera: int) -> float:
        """Return tester x of the nominal centre of one camera's view. All neighbours overlap by the same share."""
        widths = [self.camera_view_mm(i)[0] for i in range(camera + 1)]
        if len(set(widths)) == 1:
            return camera * (widths[0] / self.overlap)
        return sum((a + b) / 2 for a, b in pairwise(widths)) / self.overlap

    def _lies_across(self, camera: int) -> bool:
        """Whether a camera is mounted nearer to a quarter turn than to upright or upside down."""
        return round(self.design_roll_deg(camera) / 90) % 2 == 1
