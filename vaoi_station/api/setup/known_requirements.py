"""The requirements of an optics plan that the configuration and the calibration of a station state.

The widest board is in neither: it is the width that the views of all cameras cover. The sensor's width is unknown too.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from vaoi_station.config import CameraConfig, StationConfig
from vaoi_station.model import Calibration
from vaoi_station.pixel_formats import PIXEL_FORMATS

CALIBRATION = "calibration"


class _View(NamedTuple):
    """Where a camera sees the belt, in tester coordinates."""

    center_mm: tuple[float, float]
    px_per_mm: float
    image_x: tuple[float, float]
    """Direction of the frame's rows on the belt, (2,), length 1."""


def known_requirements(config: StationConfig, calibration: Calibration | None) -> dict[str, tuple[float, str]]:
    """Return for each known requirement its value and the key of station.toml, or the file, that states it."""
    line, cameras = config.line, config.cameras
    lit_us, lit_by = _lit_us(config)
    known = {
        "speed_mm_s": (line.speed_mm_s, "line.conveyor_mm_s"),
        "cameras": (float(len(cameras)), "cameras"),
        "blur_px": (line.max_blur_px, "line.max_blur_px"),
        "frame_rate_hz": (1 / line.trigger_period_s, "line.trigger_period_s"),
        "exposure_us": (lit_us, lit_by),
        "readout_us": (max(c.readout_us for c in cameras), "cameras.readout_us"),
        "bits_per_pixel": (
            float(max(PIXEL_FORMATS[c.pixel_format].bits_per_pixel for c in cameras)),
            "cameras.pixel_format",
        ),
        "longest_board_mm": (line.longest_board_mm, "line.longest_board_mm"),
        "runs_in_memory": (float(config.ring.runs), "ring.runs"),
    }
    if calibration is not None and calibration.working_distance_mm is not None:
        known["distance_max_mm"] = (calibration.working_distance_mm, CALIBRATION)
    known |= _of_views(config, calibration)
    # No value is known to more digits, and a person is to read them.
    return {name: (float(f"{value:.6g}"), source) for name, (value, source) in known.items()}


def _lit_us(config: StationConfig) -> tuple[float, str]:
    """Return how long a row is exposed at most: light that ends before the exposure ends the exposure too."""
    exposure_us = max(c.exposure_us for c in config.cameras)
    on_us = [config.controller.lights[name].on_us for name in config.controller.light_sequence]
    if on_us and max(on_us) < exposure_us:
        return max(on_us), "controller.lights"
    return exposure_us, "cameras.exposure_us"


def _of_views(config: StationConfig, calibration: Calibration | None) -> dict[str, tuple[float, str]]:
    """Return what follows from where the cameras see the belt: sides of the frame, resolution, width."""
    calibrated = calibration is not None and len(calibration.camera_matrices) == len(config.cameras)
    views = _calibrated(config.cameras, calibration) if calibrated and calibration else _nominal(config.cameras)
    x, y = config.line.conveyor_mm_s
    across = np.array([-y, x]) / math.hypot(x, y)
    first = views[0].image_x if views else _image_x(config.cameras[0])
    # The rows of a frame lie across the motion unless the camera is mounted at a quarter turn.
    upright = abs(float(np.dot(first, across))) >= math.sqrt(0.5)
    width, height = (min(getattr(c, side) for c in config.cameras) for side in ("width", "height"))
    side_h, side_v = ("width", "height") if upright else ("height", "width")
    px_h, px_v = (width, height) if upright else (height, width)
    known = {
        "sensor_px_h": (float(px_h), f"cameras.{side_h}"),
        "sensor_px_v": (float(px_v), f"cameras.{side_v}"),
    }
    if views:
        source = CALIBRATION if calibrated else "cameras.nominal_px_per_mm"
        resolution = min(v.px_per_mm for v in views)  # a plan asks for the least
        places = [float(np.dot(v.center_mm, across)) for v in views]
        width_mm = max(places) - min(places) + px_h / resolution
        known["resolution_px_per_mm"] = (resolution, source)
        known["width_mm"] = (width_mm, CALIBRATION if calibrated else "cameras.nominal_center_mm")
    return known


def _calibrated(cameras: Sequence[CameraConfig], calibration: Calibration) -> list[_View]:
    views = []
    for camera in calibration.cameras(tuple(c.head for c in cameras)):
        x, y = camera.center_px
        center, beside = camera.row_from_image((x, y)), camera.row_from_image((x + 1, y))
        along = (beside - center) / np.linalg.norm(beside - center)
        views.append(_View((float(center[0]), float(center[1])), camera.px_per_mm, (float(along[0]), float(along[1]))))
    return views


def _nominal(cameras: Sequence[CameraConfig]) -> list[_View]:
    """Return the views by the mechanical design; none if a camera lacks its nominal values."""
    views = [
        _View(c.nominal_center_mm, c.nominal_px_per_mm, _image_x(c))
        for c in cameras
        if c.nominal_center_mm is not None and c.nominal_px_per_mm is not None
    ]
    return views if len(views) == len(cameras) else []


def _image_x(camera: CameraConfig) -> tuple[float, float]:
    roll = math.radians(camera.nominal_roll_deg or 0.0)
    return math.cos(roll), -math.sin(roll)
