"""Answers about cameras and about the examination of the station."""

from __future__ import annotations

from typing import Any, Literal

from pydantic import BaseModel, ConfigDict, Field, model_validator

from vaoi_station.model import Strict


class Answer(BaseModel):
    """Base class of these answers: immutable; a program may get further fields with any version."""

    model_config = ConfigDict(frozen=True)


class SharpnessTile(Answer):
    """The sharpness of one of the 3 × 3 parts of a frame."""

    column: int
    row: int
    blur_px: float | None = None
    """Standard deviation of the blur across edges, px; absent if the part has too few edges."""


class FrameFigures(Answer):
    """The figures of one frame. Grey levels are shares of the full scale."""

    width: int
    height: int
    focus: float
    """Figure of focus: a higher value is sharper. Comparable only between frames of the same scene."""
    blur_px: float | None = None
    """Standard deviation of the blur across edges, px, of the whole frame; absent if there are too few edges."""
    mtf50: float | None = None
    """Spatial frequency, cycles per pixel, at which the modulation falls to one half."""
    tiles: tuple[SharpnessTile, ...]
    mean: float
    low: float
    """Grey level below which 1 % of the pixels lie."""
    high: float
    """Grey level below which 99 % of the pixels lie."""
    saturated: float
    """Share of the pixels at full scale."""
    histogram: tuple[float, ...]
    """Share of the pixels in each of 64 equal steps of grey, from dark to bright."""


class CameraFrame(FrameFigures):
    """The newest frame of a camera that is in memory, and its figures."""

    camera: int
    run: str
    row: int
    light: str
    exposure_us: float | None = None
    gain: float | None = None
    link_mbit_s: float | None = None
    """Mean data rate of the camera while the run was filmed, Mbit/s; absent while it is."""


class CameraTrialRequest(Strict):
    """Settings that one camera is to try with one pulse; what is absent is as in station.toml."""

    light: str | None = Field(default=None, min_length=1, max_length=100, description="Name of a light.")
    on_us: float | None = Field(default=None, gt=0, le=1e6, allow_inf_nan=False, description="On-time of its LEDs.")
    exposure_us: float | None = Field(default=None, gt=0, le=1e6, allow_inf_nan=False)
    gain_db: float | None = Field(default=None, ge=-60, le=60, allow_inf_nan=False)


class CameraTrialFrame(FrameFigures):
    """A frame that was taken with settings on trial, and its figures."""

    camera: int
    number: int
    """Number of the trial, for its picture."""
    light: str
    on_us: float | None = None
    exposure_us: float
    gain_db: float
    expires_in_s: float
    """Time until the settings of station.toml are set again, without another trial."""


class ExaminationFinding(Answer):
    """One finding of `vaoi doctor`."""

    check: str
    subject: str
    """The camera, file or port that it concerns; empty: the station."""
    level: Literal["ok", "warning", "fault", "not-applicable"]
    code: str = ""
    """What is wrong; empty without a problem."""
    message: str
    action: str
    """The step that solves the problem; empty without a problem."""
    figures: dict[str, float] = Field(default_factory=dict)
    """Measured values, with units in the names."""
    names: dict[str, str] = Field(default_factory=dict)
    """Files and other names that the message states, by what they are."""

    @model_validator(mode="before")
    @classmethod
    def _divided(cls, finding: dict[str, Any]) -> dict[str, Any]:
        # The doctor has one object for both; clients in typed languages need one type per field.
        figures = finding.get("figures", {})
        numbers = {name: value for name, value in figures.items() if isinstance(value, int | float)}
        return finding | {"figures": numbers, "names": {n: v for n, v in figures.items() if isinstance(v, str)}}


class Examination(Answer):
    """All findings of `vaoi doctor`, in the order of its checks."""

    created: str
    worst: Literal["ok", "warning", "fault", "not-applicable"]
    findings: tuple[ExaminationFinding, ...]
