"""Schemas of the requests and replies about setting a station up."""

from __future__ import annotations

from typing import Literal

from pydantic import BaseModel, Field

from vaoi_station.files.layouts import Layout
from vaoi_station.model import Strict

TrialState = Literal["none", "reading", "fitting", "judged", "refused", "accepted"]


class ArtworkOptions(BaseModel):
    """The marks of a calibration board; what is absent is nominal in station.toml."""

    columns: int = Field(default=5, ge=2, le=50, description="Marks in each view, across.")
    rows: int = Field(default=4, ge=2, le=50, description="Marks in each view, down.")
    mark_mm: float = Field(default=2.0, ge=0.1, le=50, description="Size of a mark.")
    tolerance_mm: float = Field(default=3.0, ge=0, le=50, description="Distance of marks from the edge of a view.")
    light_marks: bool = Field(default=False, description="Light marks on a dark board.")
    pitch_mm: float | None = Field(default=None, gt=0, le=10_000, description="Distance of neighbouring cameras.")
    px_per_mm: float | None = Field(default=None, ge=0.1, le=1000, description="Resolution of the cameras.")


class TrialRequest(Strict):
    """A request to calibrate the array from one row of a run that shows the calibration board."""

    run: str = Field(min_length=1, max_length=64, description="Id of a run whose frames can still be read.")
    row: int = Field(ge=0, le=100_000, description="The row in which every camera sees its marks.")
    layout: Layout = Field(description="The marks of the calibration board: the `layout.json` of its artwork.")
    pitch_mm: float | None = Field(
        default=None, gt=0, le=10_000, description="Distance of neighbouring cameras, where station.toml states none."
    )
    px_per_mm: float | None = Field(
        default=None, ge=0.1, le=1000, description="Resolution of the cameras, where station.toml states none."
    )
    residual_limit_px: float = Field(
        default=0.2, gt=0, le=100, description="Largest accepted rms residual of a camera."
    )
    working_distance_mm: float | None = Field(default=None, gt=0, le=10_000)
    center_tolerance_mm: float = Field(
        default=2.0, gt=0, le=1000, description="Accuracy of nominal_center_mm to the board as it lies."
    )
    mark_accuracy_um: float = Field(default=0.0, ge=0, le=10_000, description="Standard deviation of places of marks.")
    flatness_um: float = Field(
        default=0.0, ge=0, le=10_000, description="Standard deviation of the board's height; needs working_distance_mm."
    )


class TrialCamera(BaseModel):
    """What a trial has found for one camera."""

    camera: int
    name: str
    marks: int = Field(description="Marks of the layout that are expected in its frame.")
    used: int = Field(description="Marks in the fit.")
    residual_px: float | None = Field(default=None, description="Root mean square of the residuals.")
    corner_sigma_px: float | None = Field(default=None, description="Standard deviation at the worst corner.")
    distortion_px: float | None = Field(
        default=None, description="Distortion at the corner, if the marks determine it."
    )
    changed_px: float | None = Field(
        default=None, description="Root mean square difference to the calibration in force, the board's motion removed."
    )
    refusal: str | None = Field(default=None, description="Why this camera cannot be calibrated.")
    action: str | None = Field(default=None, description="What removes the cause of the refusal.")


class TrialNote(BaseModel):
    """A warning of a trial of a calibration."""

    code: str
    message: str
    values: dict[str, str] = Field(description="What the message states: numbers of cameras, places, lengths.")


class CalibrationTrial(BaseModel):
    """The latest trial of a calibration. It is kept until the next one begins or the station is restarted."""

    state: TrialState
    run: str | None = None
    row: int | None = None
    begun: str | None = None
    frames_read: int = 0
    frames: int = Field(default=0, description="Number of frames that are read: one for each camera.")
    cameras: list[TrialCamera] = []
    notes: list[TrialNote] = []
    message: str | None = Field(default=None, description="Why it was refused.")
    action: str | None = None
    shift_mm: tuple[float, float] | None = Field(
        default=None, description="How the calibration board lies displaced against the calibration in force."
    )
    turned_deg: float | None = None
    in_force_created: str | None = Field(default=None, description="When the calibration in force was made.")
    accepted_as: str | None = Field(default=None, description="Name of the file that was written.")
    backup: str | None = Field(default=None, description="Name of the copy of the file before.")
