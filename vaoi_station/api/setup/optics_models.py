"""Schemas of the requests and replies about the optics of a line."""

from __future__ import annotations

from typing import Annotated

from pydantic import BaseModel, Field

from vaoi_station.optics import Constraint, Requirements
from vaoi_station.optics.plan_sections import ArrayPlan, DataPlan, LensPlan, MotionPlan
from vaoi_station.optics.remedies import Remedy

# Wide enough for every line, and narrow enough that no figure of a plan exceeds what a float or a page can show.
Quantity = Annotated[float, Field(ge=1e-4, le=1e6, allow_inf_nan=False)]
Count = Annotated[int, Field(ge=1, le=100_000)]
Multiplicity = Annotated[float, Field(ge=1, le=1000, allow_inf_nan=False)]


class PlanOptions(BaseModel):
    """The requirements of a plan; what is optional and absent is chosen by the plan, or stays open."""

    width_mm: Quantity = Field(description="Width of the widest board, across the motion (w).")
    resolution_px_per_mm: Quantity = Field(description="Resolution on the board (r).")
    speed_mm_s: Quantity = Field(description="Speed of the conveyor (v).")
    sensor_px_h: Count = Field(description="Pixels of a frame across the motion (p_h).")
    sensor_px_v: Count = Field(description="Pixels of a frame along the motion (p_v).")
    sensor_width_mm: Quantity = Field(description="Width of the sensor, along p_h (w_s).")
    distance_max_mm: Quantity = Field(description="Largest distance of the cameras from the board (d_max).")
    distance_min_mm: Quantity | None = Field(default=None, description="Smallest such distance (d_min).")
    multiplicity_h: Multiplicity = Field(default=1.05, description="Number of cameras that see each point (m_h).")
    multiplicity_v: Multiplicity = Field(
        default=2.1, description="Number of frames of a camera that show each point (m_v)."
    )
    depth_of_field_mm: Quantity | None = Field(default=None, description="Height of the highest component (d_f).")
    circle_of_confusion_mm: Quantity | None = Field(default=None, description="Largest blur spot on the sensor (c).")
    blur_px: Quantity = Field(default=1.0, description="Largest motion during an exposure (τ).")
    lens_mm: Quantity | None = Field(default=None, description="Focal length of the chosen lens (f).")
    f_number: Quantity | None = Field(default=None, description="Chosen aperture (N).")
    cameras: Count | None = Field(default=None, description="Chosen number of cameras (n).")
    frame_rate_hz: Quantity | None = Field(default=None, description="Chosen frame rate (t).")
    exposure_us: Quantity | None = Field(default=None, description="Chosen exposure time (s).")
    readout_us: float = Field(
        default=0.0, ge=0, le=1e6, allow_inf_nan=False, description="Time from an exposure's end to the next one."
    )
    bits_per_pixel: int = Field(default=8, ge=1, le=64, description="Bits per pixel on the links.")
    longest_board_mm: Quantity | None = Field(default=None, description="Longest board, along the motion.")
    runs_in_memory: int = Field(default=3, ge=1, le=1000, description="Number of boards that the ring holds.")
    link_mbit_s: Quantity | None = Field(default=None, description="Total capacity of the links of all cameras.")

    def requirements(self) -> Requirements:
        """Convert to the input of a plan; raise InputError if quantities contradict each other."""
        return Requirements(**self.model_dump())


class OpticsPlan(BaseModel):
    """Cameras, lens, exposure, pulses and memory for the requirements, and every constraint with its margin."""

    requirements: Requirements
    array: ArrayPlan
    lens: LensPlan
    motion: MotionPlan
    data: DataPlan
    constraints: tuple[Constraint, ...]
    ok: bool = Field(description="Whether no constraint is violated; those that could not be checked do not count.")
    remedies: tuple[Remedy, ...] = Field(
        description="For each violated constraint: one requirement, changed just so far that the constraint holds."
    )


class KnownRequirements(BaseModel):
    """Requirements that are known without a person."""

    values: dict[str, float] = Field(description="By the name of the parameter of `GET optics/plan`.")
    sources: dict[str, str] = Field(description="For each of them the key of station.toml, or the file, that has it.")
