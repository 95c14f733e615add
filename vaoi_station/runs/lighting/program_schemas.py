"""Documents about light programs, for callers."""

from __future__ import annotations

from typing import Literal

from pydantic import Field

from vaoi_station.model import Strict

Limits = tuple[float, float]


class ProgramFaultEntry(Strict):
    """One fault of a light program."""

    step: int | None = Field(default=None, description="Index of the step; absent: the whole program or the line.")
    field: str | None = Field(default=None, description="The key of the step that is wrong.")
    camera: int | None = Field(default=None, description="The camera that cannot follow.")
    message: str
    action: str | None = None
    code: str = Field(description="What it is, for programs.")
    values: dict[str, str] = Field(description="What the message states, as it is written there.")


class ProgramNote(Strict):
    """What could not be checked."""

    code: str
    message: str
    values: dict[str, str] = Field(description="What the message states: names of cameras and settings.")


class ProgramStepValues(Strict):
    """One step with all its values, as rows are filmed with it."""

    light: str
    on_us: float | None = Field(default=None, description="Absent: the light shines for the whole exposure.")
    exposures_us: tuple[float, ...] = Field(description="Exposure of every camera.")
    gains_db: tuple[float, ...] = Field(description="Gain of every camera.")
    lit_us: tuple[float, ...] = Field(description="How long light falls on the sensor of every camera.")
    trigger_us: float | None = Field(default=None, description="Width of the trigger where it sets exposures.")


class ProgramCamera(Strict):
    """What bounds the exposures of one camera."""

    camera: int
    name: str
    exposure_us: float = Field(description="Exposure of station.toml.")
    gain_db: float = Field(description="Gain of station.toml.")
    readout_us: float = Field(description="Read-out that must end before the next row.")
    px_per_mm: float | None = Field(default=None, description="Resolution; absent: not known.")
    longest_lit_us: float | None = Field(default=None, description="Longest light with which motion blurs no more.")
    way: Literal["rows", "trigger-width", "register", "sequencer"] = Field(
        description="How its exposure changes: from row to row, by the width of the trigger, by its register (one for "
        "all rows), by its sequencer."
    )
    exposure_limits_us: Limits | None = Field(default=None, description="Limits that the camera states.")
    gain_limits_db: Limits | None = Field(default=None, description="Limits that the camera states.")


class ProgramLight(Strict):
    """A light that steps may name."""

    name: str
    channels: tuple[int, ...] = ()
    on_us: float | None = Field(default=None, description="On-time of station.toml; absent: the whole exposure.")
    on_limits_us: Limits | None = Field(default=None, description="Limits of the controller's firmware at this period.")


class ProgramCheck(Strict):
    """A light program with all its values, its limits, and all its faults."""

    board_type: str
    origin: Literal["request", "board-type", "station", "cameras"] = Field(
        description="Whose program it is: of the request, the board type, or station.toml; `cameras`: there is none, "
        "and lights and exposures are those of station.toml."
    )
    usable: bool = Field(description="No fault was found; what `unchecked` lists shows when it is armed.")
    faults: tuple[ProgramFaultEntry, ...]
    unchecked: tuple[ProgramNote, ...] = Field(description="What was not checked: no device has stated its limits.")
    steps: tuple[ProgramStepValues, ...]
    most_steps: int = Field(description="Largest number of steps.")
    period_s: float = Field(description="Shortest time between two rows.")
    speed_mm_s: float = Field(description="Fastest speed of the belt.")
    max_blur_px: float
    cameras: tuple[ProgramCamera, ...]
    lights: tuple[ProgramLight, ...]
