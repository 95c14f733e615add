"""A recording: its head, the record of every frame, and the light program of its rows."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from enum import StrEnum
from typing import Annotated, Any, Literal, Self

import numpy as np
from numpy.typing import NDArray
from pydantic import BeforeValidator, Field, model_validator

from vaoi_station.model.frozen_model import Finite, FrozenModel, PointMm, Positive, Whole

Microseconds = Annotated[Positive, Field(le=3.6e9)]
"""An exposure time in µs; at most an hour."""
Gain = Annotated[Positive, Field(ge=1e-3, le=1e4)]
"""A linear gain of a camera: 2 makes grey levels twice as large as 1."""
MillimetresPerSecond = Annotated[Finite, Field(ge=-1e5, le=1e5)]


class CameraHead(FrozenModel):
    """Frame size, exposure and nominal view of one camera."""

    width: Annotated[Whole, Field(ge=16, le=65536)]
    """Width of its frames, px."""
    height: Annotated[Whole, Field(ge=16, le=65536)]
    """Height of its frames, px."""
    exposure_us: Microseconds
    """Exposure time."""
    nominal_center_mm: PointMm | None = None
    """Centre of its view by the mechanical design, in tester coordinates."""
    nominal_px_per_mm: Positive | None = None
    """Its resolution by the mechanical design; a calibration that differs by more than a factor of 1.5 is refused."""
    nominal_roll_deg: Annotated[Finite, Field(ge=-360, le=360)] | None = None
    """Rotation of the mounted camera, from image x towards image y; 180 is upside down, empty upright. Only calibration
    needs it."""
    bits: Annotated[Whole, Field(ge=8, le=16)] | None = None
    """Used bits of a 16-bit pixel, from the lowest: 12 for values up to 4095. Empty: estimated from all frames."""
    serial: Annotated[str, Field(min_length=1)] | None = None
    """Serial number, by which flat fields of other cameras are refused."""


class RecordingHead(FrozenModel):
    """The content of recording.json: cameras, number of rows, pulse times, lights and missing frames."""

    format: Literal["vaoi-recording"]
    version: Literal[1]
    cameras: Annotated[tuple[CameraHead, ...], Field(min_length=1)]
    """One entry per camera, in the order of the calibration."""
    rows: Annotated[Whole, Field(ge=1, le=100_000)]
    """Number of pulses, m."""
    trigger_period_s: Annotated[Positive, Field(le=3600)]
    """Nominal time from pulse to pulse."""
    conveyor_mm_s: tuple[MillimetresPerSecond, MillimetresPerSecond]
    """Nominal velocity of the board in tester coordinates, [vx, vy]."""
    missing: tuple[tuple[Whole, Whole], ...] = ()
    """[camera, row] of every frame that never arrived, or is not proven to belong to its row."""
    trigger_times_s: tuple[Finite, ...] | None = None
    """Times of the m pulses by the controller's clock, increasing. Empty: evenly spaced, from 0."""
    belt_mm: tuple[Finite, ...] | None = None
    """Way of the belt at each row by its encoder, from row 0 on, increasing: the prior of the motion. Empty: velocity ·
    time."""
    exposures_us: tuple[tuple[Microseconds, ...], ...] | None = None
    """Exposure time of each row and camera, where it varies. Empty: that of the camera."""
    gains: tuple[tuple[Gain, ...], ...] | None = None
    """Linear gain of each row and camera: 2 makes grey levels twice as large. Empty: 1."""
    lights: tuple[str, ...] | None = None
    """Name of the light of each row. Rows of one light are linked."""
    rotation_deg: Literal[0, 90, 180, 270] | None = None
    """Expected rotation of the board on the belt, counter-clockwise from CAD-upright as the camera sees it. Empty:
    0."""
    skip: tuple[Annotated[str, Field(min_length=1, max_length=80)], ...] | None = None
    """Positions of the boards of a panel that were not to be tested, as the order of the board stated."""
    doubts: tuple[str, ...] = ()
    """Sentences on what was doubtful when the run was filmed. Each is a reason of the result, which is then not ok."""

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


class Verdict(StrEnum):
    """The final state of one (camera, row) of a run."""

    OK = "ok"
    INCOMPLETE = "incomplete"
    MISSING = "missing"


class FrameRecord(FrozenModel):
    """The record of one frame of a run: slot in the ring, final state with its cause, times and exposure."""

    camera: int
    row: int
    verdict: Verdict
    cause: str = ""
    slot: int | None = None
    """Slot of the ring that holds the frame; None if no frame arrived."""
    frame_id: int | None = None
    camera_time_s: float | None = None
    pulse_error_us: float | None = None
    """Time stamp of the frame minus time of its pulse, both converted to the host's clock."""
    exposure_us: float | None = None
    """Time for which the frame was exposed, or for which LEDs of a light program lit it if that is shorter; None if
    unknown."""
    gain: float | None = None
    """Linear gain of the frame; None if unknown."""
    light: str = ""
    """Name of the light pattern of the frame's row."""
    proven: bool = True
    """Whether the frame belongs to its row as far as the proof of the run shows; otherwise `cause` states the doubt."""

    @property
    def usable(self) -> bool:
        """Whether the frame is complete and proven; no other frame is stitched or shown as a view of a component."""
        return self.verdict is Verdict.OK and self.proven


class Pulse(FrozenModel):
    """One trigger pulse, which all cameras receive. Its time is in seconds of the controller's clock."""

    index: int
    time_s: float
    light: str = ""


MOST_STEPS = 64
"""Largest number of steps of a program. The controller's firmware may hold fewer; it says how many."""


def _as_tuple(value: Any) -> Any:
    """Return a single number, which applies to all cameras, as a list with one entry."""
    return [value] if isinstance(value, int | float) and not isinstance(value, bool) else value


_Microseconds = Annotated[Positive, Field(le=1e6)]
_Decibels = Annotated[float, Field(strict=True, ge=-60, le=60, allow_inf_nan=False)]


class ProgramStep(FrozenModel):
    """One step of a program as a board type or station.toml states it. What is absent is as in station.toml."""

    light: Annotated[str, Field(min_length=1, max_length=100)]
    """Name of the light pattern."""
    on_us: _Microseconds | None = None
    """On-time of the light's LEDs, µs."""
    exposure_us: Annotated[tuple[_Microseconds, ...], Field(min_length=1), BeforeValidator(_as_tuple)] | None = None
    """Exposure of every camera, µs; one entry applies to all cameras."""
    gain_db: Annotated[tuple[_Decibels, ...], Field(min_length=1), BeforeValidator(_as_tuple)] | None = None
    """Gain of every camera, dB; one entry applies to all cameras."""


Program = Annotated[tuple[ProgramStep, ...], Field(max_length=MOST_STEPS)]
"""The steps of a light program: row j is filmed with step j modulo their number. Empty: there is no program."""


@dataclass(frozen=True)
class ProgramRow:
    """One step of a program with all its values: what a row is filmed with."""

    light: str
    exposures_us: tuple[float, ...]
    """Exposure of every camera, µs: the time for which its shutter is open."""
    gains_db: tuple[float, ...]
    on_us: float | None = None
    """On-time of the LEDs, µs; None if the light shines for the whole exposure."""
    trigger_us: float | None = None
    """Width of the camera trigger, µs, where cameras expose for as long; None: that of station.toml."""

    @property
    def lit_us(self) -> tuple[float, ...]:
        """Time for which light falls on the sensor of every camera, µs: the shorter of exposure and on-time."""
        return self.exposures_us if self.on_us is None else tuple(min(e, self.on_us) for e in self.exposures_us)

    @property
    def gains(self) -> tuple[float, ...]:
        """Linear gain of every camera; 1 is 0 dB."""
        return tuple(linear_gain(db) for db in self.gains_db)


def linear_gain(gain_db: float) -> float:
    """Convert a gain in dB to the factor on grey levels, rounded to 6 decimals."""
    return round(10 ** (gain_db / 20), 6)


def row_of(program: Sequence[ProgramRow], row: int) -> ProgramRow | None:
    """Return what a row is filmed with; None without a program."""
    return program[row % len(program)] if program else None


def usual_light(lights: Iterable[str | None]) -> str | None:
    """Return the light of most frames, and of equally many the first; None if there is no frame."""
    return next(iter(Counter(lights).most_common(1)), (None, 0))[0]
