"""Routes under `optics`: plan cameras, lens, exposure and pulses of a line. They compute, and change nothing."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Annotated, Literal, NamedTuple

import numpy as np
from fastapi import APIRouter, Query
from pydantic import BaseModel, Field

from vaoi_station.api.parameters import rest_router
from vaoi_station.api.routes.services import Services
from vaoi_station.api.setup.station_files import StationFiles
from vaoi_station.config import CameraConfig, StationConfig
from vaoi_station.errors import VaoiError
from vaoi_station.files import read_calibration
from vaoi_station.geometry import Camera
from vaoi_station.geometry.transforms import Floats
from vaoi_station.model import Calibration
from vaoi_station.optics import Constraint, Requirements, make_plan
from vaoi_station.optics.plan import ArrayPlan, DataPlan, LensPlan, MotionPlan
from vaoi_station.optics.remedies import Remedy, find_remedies
from vaoi_station.optics.report import PAPER
from vaoi_station.pixel_formats import PIXEL_FORMATS

CALIBRATION = "calibration"
# Wide enough for every line, and narrow enough that no figure of a plan exceeds what a float or a page can show.
Quantity = Annotated[float, Field(ge=1e-4, le=1e6, allow_inf_nan=False)]
Count = Annotated[int, Field(ge=1, le=100_000)]
Multiplicity = Annotated[float, Field(ge=1, le=1000, allow_inf_nan=False)]


Of = Annotated[
    Literal["station", "paper"],
    Query(description="This station, by station.toml and its calibration, or the example of the paper."),
]


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
    link_mbit_s: Quantity | None = Field(default=None, description="Capacity of the link that all cameras share.")
    camera_link_mbit_s: Quantity | None = Field(default=None, description="Speed of one camera's own link.")
    packet_bytes: int = Field(default=9000, ge=576, le=65535, description="Packet size with headers.")


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


def router(services: Services, files: StationFiles) -> APIRouter:
    """Create the routes."""
    routes, ask = rest_router(prefix="/optics", tags=["setup"]), services.commands.ask

    @routes.get("/plan")
    async def plan_optics(options: Annotated[PlanOptions, Query()]) -> OpticsPlan:
        """Compute an optics plan as `vaoi plan` does: figures, constraints with margins, and remedies.

        A violated constraint is no refusal. Figures that the requirements leave open are absent.
        """

        def plan() -> OpticsPlan:
            made = make_plan(Requirements(**options.model_dump()))
            return OpticsPlan(**vars(made), ok=made.ok, remedies=find_remedies(made))

        return await ask(plan)

    @routes.get("/requirements")
    async def get_optics_requirements(of: Of = "station") -> KnownRequirements:
        """Return requirements to begin a plan with, and for each of them where it is stated."""

        def known() -> dict[str, tuple[float, str]]:
            if of == "paper":
                return {name: (float(value), "paper") for name, value in vars(PAPER).items() if value is not None}
            try:
                calibration = read_calibration(files.config.calibration)
            except VaoiError:
                calibration = None  # other pages state why it cannot be read
            return known_requirements(files.config, calibration)

        found = await ask(known)
        return KnownRequirements(
            values={name: value for name, (value, _) in found.items()},
            sources={name: source for name, (_, source) in found.items()},
        )

    return routes


class _View(NamedTuple):
    """Where a camera sees the belt, tester coordinates, and the direction of the rows of its frame there, length 1."""

    center_mm: Floats
    px_per_mm: float
    along: Floats


def known_requirements(config: StationConfig, calibration: Calibration | None) -> dict[str, tuple[float, str]]:
    """Return for each known requirement its value and the key of station.toml, or the file, that states it.

    The widest board is in neither: it is the width that the views of all cameras cover. The sensor's width is unknown.
    """
    line, cameras = config.line, config.cameras
    # Light that ends before the exposure ends the exposure too.
    exposure_us = max(c.exposure_us for c in cameras)
    on_us = max((config.controller.lights[name].on_us for name in config.controller.light_sequence), default=0.0)
    lit = (on_us, "controller.lights") if 0 < on_us < exposure_us else (exposure_us, "cameras.exposure_us")
    known: dict[str, tuple[float, str]] = {
        "speed_mm_s": (line.speed_mm_s, "line.conveyor_mm_s"),
        "cameras": (len(cameras), "cameras"),
        "blur_px": (line.max_blur_px, "line.max_blur_px"),
        "frame_rate_hz": (1 / line.trigger_period_s, "line.trigger_period_s"),
        "exposure_us": lit,
        "readout_us": (max(c.readout_us for c in cameras), "cameras.readout_us"),
        "bits_per_pixel": (max(PIXEL_FORMATS[c.pixel_format].bits_per_pixel for c in cameras), "cameras.pixel_format"),
        "longest_board_mm": (line.longest_board_mm, "line.longest_board_mm"),
        "runs_in_memory": (config.ring.runs, "ring.runs"),
    }
    shared = {(c.link, c.link_mbit_s) for c in cameras}
    if len(shared) == 1 and cameras[0].link_mbit_s is not None:
        known["link_mbit_s"] = (cameras[0].link_mbit_s, "cameras.link_mbit_s")
    if calibration is not None and calibration.working_distance_mm is not None:
        known["distance_max_mm"] = (calibration.working_distance_mm, CALIBRATION)
    known |= _of_views(config, calibration)
    # No value is known to more digits, and a person is to read them.
    return {name: (float(f"{value:.6g}"), source) for name, (value, source) in known.items()}


def _of_views(config: StationConfig, calibration: Calibration | None) -> dict[str, tuple[float, str]]:
    """Return what follows from where the cameras see the belt: sides of the frame, resolution, width."""
    cameras = config.cameras
    calibrated = calibration is not None and len(calibration.camera_matrices) == len(cameras)
    if calibrated and calibration is not None:
        views = _calibrated(calibration.cameras(tuple(c.head for c in cameras)))
    else:
        views = [
            _View(np.array(c.nominal_center_mm), c.nominal_px_per_mm, _nominal_along(c))
            for c in cameras
            if c.nominal_center_mm is not None and c.nominal_px_per_mm is not None
        ]
    if len(views) < len(cameras):
        views = []
    x, y = config.line.conveyor_mm_s
    across = np.array([-y, x]) / math.hypot(x, y)
    # The rows of a frame lie across the motion unless the camera is mounted at a quarter turn.
    along = views[0].along if views else _nominal_along(cameras[0])
    sides = ("width", "height") if abs(float(along @ across)) >= math.sqrt(0.5) else ("height", "width")
    px_h, px_v = (min(getattr(c, side) for c in cameras) for side in sides)
    known = {"sensor_px_h": (float(px_h), f"cameras.{sides[0]}"), "sensor_px_v": (float(px_v), f"cameras.{sides[1]}")}
    if views:
        resolution = min(view.px_per_mm for view in views)  # a plan asks for the least
        places_mm = [float(view.center_mm @ across) for view in views]
        width_mm = max(places_mm) - min(places_mm) + px_h / resolution
        known["resolution_px_per_mm"] = (resolution, CALIBRATION if calibrated else "cameras.nominal_px_per_mm")
        known["width_mm"] = (width_mm, CALIBRATION if calibrated else "cameras.nominal_center_mm")
    return known


def _calibrated(cameras: Sequence[Camera]) -> list[_View]:
    views = []
    for camera in cameras:
        x, y = camera.center_px
        center = camera.row_from_image((x, y))
        beside = camera.row_from_image((x + 1, y)) - center
        views.append(_View(center, camera.px_per_mm, beside / np.linalg.norm(beside)))
    return views


def _nominal_along(camera: CameraConfig) -> Floats:
    roll = math.radians(camera.nominal_roll_deg or 0.0)
    return np.array([math.cos(roll), -math.sin(roll)])
