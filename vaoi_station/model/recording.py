"""The head of a recording: its cameras, rows and times. The frames are image files in the same folder."""

from __future__ import annotations

import math
from typing import Annotated, Literal, Self

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, model_validator

from vaoi_station.model.frozen_model import Finite, FrozenModel, PointMm, Positive, Whole

Microseconds = Annotated[Positive, Field(le=3.6e9)]
"""An exposure time in µs; at most an hour."""
Gain = Annotated[Positive, Field(ge=1e-3, le=1e4)]
"""A linear gain of a camera: 2 makes grey levels twice as large as 1."""
MillimetresPerSecond = Annotated[Finite, Field(ge=-1e5, le=1e5)]


class CameraHead(FrozenModel):
    """Frame size, exposure and nominal view of one camera."""

    width: Annotated[Whole, Field(ge=16, le=65536)]
    height: Annotated[Whole, Field(ge=16, le=65536)]
    exposure_us: Microseconds
    nominal_center_mm: PointMm | None = None
    nominal_px_per_mm: Positive | None = None
    nominal_roll_deg: Annotated[Finite, Field(ge=-360, le=360)] | None = None
    """Rotation of the mounted camera, from image x towards image y; 180 is upside down. None: upright."""
    bits: Annotated[Whole, Field(ge=8, le=16)] | None = None
    """Used bits of a 16-bit pixel, counted from the lowest: 12 for values up to 4095; None if unknown."""
    serial: Annotated[str, Field(min_length=1)] | None = None
    """Serial number of the camera; None if it is not known."""


class RecordingHead(FrozenModel):
    """The content of recording.json: cameras, number of rows, pulse times, lights and missing frames."""

    format: Literal["vaoi-recording"]
    version: Literal[1]
    cameras: Annotated[tuple[CameraHead, ...], Field(min_length=1)]
    rows: Annotated[Whole, Field(ge=1, le=100_000)]
    trigger_period_s: Annotated[Positive, Field(le=3600)]
    conveyor_mm_s: tuple[MillimetresPerSecond, MillimetresPerSecond]
    missing: tuple[tuple[Whole, Whole], ...] = ()
    trigger_times_s: tuple[Finite, ...] | None = None
    belt_mm: tuple[Finite, ...] | None = None
    """Way of the belt at each row by its encoder, since row 0; None if the belt has none."""
    exposures_us: tuple[tuple[Microseconds, ...], ...] | None = None
    gains: tuple[tuple[Gain, ...], ...] | None = None
    lights: tuple[str, ...] | None = None
    rotation_deg: Literal[0, 90, 180, 270] | None = None
    """Expected rotation of the board on the belt, counter-clockwise from CAD-upright as the camera sees it."""
    doubts: tuple[str, ...] = ()
    """Doubts about the frames that arose when they were recorded. Each is a reason of the result, which is then not
    ok."""

    @model_validator(mode="after")
    def _consistent(self) -> Self:
        n, m = len(self.cameras), self.rows
        for camera, row in self.missing:
            if not (0 <= camera < n and 0 <= row < m):
                raise ValueError(f"missing names [{camera}, {row}], but there are {n} cameras and {m} rows (from 0)")
        for key in ("trigger_times_s", "belt_mm", "exposures_us", "gains", "lights"):
            value = getattr(self, key)
            if value is not None and len(value) != m:
                raise ValueError(f"{key} has {len(value)} entries, must have one per row: {m}")
        for key in ("exposures_us", "gains"):
            if any(len(row) != n for row in getattr(self, key) or ()):
                raise ValueError(f"{key} must have {n} entries in every row, one per camera")
        if self.trigger_times_s and (np.diff(self.trigger_times_s) <= 0).any():
            raise ValueError("trigger_times_s must increase from row to row")
        if self.belt_mm is not None and ((np.diff(self.belt_mm) <= 0).any() or not any(self.conveyor_mm_s)):
            raise ValueError("belt_mm must increase from row to row, and conveyor_mm_s must not be zero")
        return self

    def row_times_s(self) -> NDArray[np.float64]:
        """Return the time of each pulse in seconds, one entry per row."""
        # Measured times are preferred, because the nominal period is only right if the controller kept it.
        if self.trigger_times_s is not None:
            return np.array(self.trigger_times_s)
        return np.asarray(np.arange(self.rows) * self.trigger_period_s, dtype=np.float64)

    def motion_times_s(self) -> NDArray[np.float64]:
        """Return for each row the time in which a belt at its nominal speed would have got there, in seconds.

        With `belt_mm` this follows from the measured way, whatever the belt's speed was; otherwise it is the time of
        the pulse. The prior of the motion is nominal velocity · this time.
        """
        if self.belt_mm is None:
            return self.row_times_s()
        return np.array([motion_time_s(way_mm, self.conveyor_mm_s) for way_mm in self.belt_mm])

    def exposure_us(self, camera: int, row: int) -> float:
        """Return the exposure time of one frame in µs."""
        return self.exposures_us[row][camera] if self.exposures_us else self.cameras[camera].exposure_us

    def gain(self, camera: int, row: int) -> float:
        """Return the linear gain of one frame; 1 if the recording states none."""
        return self.gains[row][camera] if self.gains else 1.0

    def light(self, row: int) -> str | None:
        """Return the name of the light pattern of one row; None if the recording states none."""
        return self.lights[row] if self.lights else None


def motion_time_s(way_mm: float, conveyor_mm_s: tuple[float, float]) -> float:
    """Return the time in which a belt at its nominal velocity covers a way, in s, rounded to ns."""
    return round(way_mm / math.hypot(*conveyor_mm_s), 9)
