"""The equations of section 2 of the paper, one function each; lengths in mm, times in µs, rates in 1/s.

Every function raises InputError with name, value and limit of a quantity that is not finite and above 0.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import wraps
from inspect import signature
from typing import ParamSpec, TypeVar

from vaoi_station.errors import InputError

GREEN_UM = 0.55
"""Wavelength for which diffraction is computed: the middle of the visible spectrum."""
P = ParamSpec("P")
T = TypeVar("T")


def is_number(value: object) -> bool:
    """Return whether a value is a finite number; booleans are none."""
    return isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value)


def require(ok: bool, name: str, value: object, limit: str, where: str = "optics") -> None:
    """Raise InputError with name, value and limit of a quantity unless `ok` is true."""
    if not ok:
        raise InputError.field(where, name, value, limit)


def require_positive(where: str, name: str, value: object, *, or_zero: bool = False) -> None:
    """Raise InputError unless a quantity is finite and above 0, or 0 where that is allowed."""
    limit = "a finite number, 0 or above" if or_zero else "a finite number above 0"
    ok = is_number(value) and (value >= 0 if or_zero else value > 0)  # type: ignore[operator]  # it is a number
    require(ok, name, value, limit, where)


def _equation(function: Callable[P, T]) -> Callable[P, T]:
    """Check the quantities of an equation; of those in `_MAY_BE_ZERO` 0 is valid."""
    names = signature(function)

    @wraps(function)
    def checked(*args: P.args, **kwargs: P.kwargs) -> T:
        for name, value in names.bind(*args, **kwargs).arguments.items():
            require_positive("optics", name, value, or_zero=name in _MAY_BE_ZERO)
        return function(*args, **kwargs)

    return checked


_MAY_BE_ZERO = frozenset({"height_mm", "shift_mm", "readout_us"})


def ceil_to_whole(value: float) -> int:
    """Round up to a whole number, but down what exceeds one by a rounding error only."""
    nearest = round(value)
    return nearest if math.isclose(value, nearest, rel_tol=1e-9, abs_tol=1e-9) else math.ceil(value)


# The array of cameras: n cameras, each p_h px wide, cover the width w at r px/mm, and m_h of them see each point.


@_equation
def cameras_needed(width_mm: float, resolution_px_per_mm: float, multiplicity_h: float, sensor_px_h: float) -> float:
    """Compute the required number of cameras w·r·m_h / p_h, not rounded."""
    return width_mm * resolution_px_per_mm * multiplicity_h / sensor_px_h


@_equation
def achieved_multiplicity_h(cameras: int, sensor_px_h: float, width_mm: float, resolution_px_per_mm: float) -> float:
    """Compute the horizontal multiplicity m_h = n·p_h / (w·r)."""
    return cameras * sensor_px_h / (width_mm * resolution_px_per_mm)


@_equation
def field_of_view_mm(sensor_px: float, resolution_px_per_mm: float) -> float:
    """Compute the length p / r of board that a side of a frame with p pixels shows."""
    return sensor_px / resolution_px_per_mm


@_equation
def camera_pitch_mm(cameras: int, width_mm: float, field_mm: float) -> float:
    """Compute the distance of neighbouring cameras whose views end at the edges of the widest board; 0 for one view."""
    return max(width_mm - field_mm, 0.0) / (cameras - 1) if cameras > 1 else 0.0


# The lens.


@_equation
def focal_length_mm(
    distance_mm: float, sensor_px_h: float, resolution_px_per_mm: float, sensor_width_mm: float
) -> float:
    """Compute the focal length f that images p_h / r of the board onto the sensor's width; equation (1)."""
    return distance_mm / (1 + sensor_px_h / (resolution_px_per_mm * sensor_width_mm))


@_equation
def working_distance_mm(
    focal_length_mm: float, sensor_px_h: float, resolution_px_per_mm: float, sensor_width_mm: float
) -> float:
    """Compute the distance d at which a lens reaches the resolution r; equation (1) solved for d."""
    return focal_length_mm * (1 + sensor_px_h / (resolution_px_per_mm * sensor_width_mm))


@_equation
def depth_of_field_mm(
    distance_mm: float, focal_length_mm: float, f_number: float, circle_of_confusion_mm: float
) -> float:
    """Compute the depth of field d_f above a board in focus; equation (2). Nothing lies below it."""
    _require_beyond_focus(distance_mm, focal_length_mm)
    f2 = focal_length_mm**2
    nearest_mm = distance_mm * f2 / (f2 + f_number * circle_of_confusion_mm * (distance_mm - focal_length_mm))
    return distance_mm - nearest_mm


@_equation
def f_number(
    depth_of_field_mm: float, distance_mm: float, focal_length_mm: float, circle_of_confusion_mm: float
) -> float:
    """Compute the f-number N that gives a depth of field d_f above the board; equation (3)."""
    _require_beyond_focus(distance_mm, focal_length_mm)
    limit = f"below the distance, {distance_mm} mm"
    require(depth_of_field_mm < distance_mm, "depth_of_field_mm", depth_of_field_mm, limit)
    far = circle_of_confusion_mm * (distance_mm - focal_length_mm) * (distance_mm - depth_of_field_mm)
    return depth_of_field_mm * focal_length_mm**2 / far


@_equation
def airy_disc_px(
    f_number: float, distance_mm: float, focal_length_mm: float, sensor_px_h: float, sensor_width_mm: float
) -> float:
    """Compute the diameter 2.44·λ·N·(1 + magnification) of the Airy disc on the sensor, px; not in the paper."""
    _require_beyond_focus(distance_mm, focal_length_mm)
    magnification = focal_length_mm / (distance_mm - focal_length_mm)
    diameter_mm = 2.44 * GREEN_UM * 1e-3 * f_number * (1 + magnification)
    return diameter_mm * sensor_px_h / sensor_width_mm


def _require_beyond_focus(distance_mm: float, focal_length_mm: float) -> None:
    require(distance_mm > focal_length_mm, "distance_mm", distance_mm, f"above the focal length, {focal_length_mm} mm")


# The motion of the board.


@_equation
def motion_blur_px(speed_mm_s: float, resolution_px_per_mm: float, exposure_us: float) -> float:
    """Compute the distance v·r·s that the board moves during one exposure; equation (4)."""
    return speed_mm_s * resolution_px_per_mm * exposure_us * 1e-6


@_equation
def longest_exposure_us(blur_px: float, speed_mm_s: float, resolution_px_per_mm: float) -> float:
    """Compute the longest exposure time s with at most `blur_px` (τ) of motion blur; equation (5)."""
    return blur_px / (speed_mm_s * resolution_px_per_mm) * 1e6


@_equation
def lowest_frame_rate_hz(
    speed_mm_s: float, resolution_px_per_mm: float, sensor_px_v: float, multiplicity_v: float
) -> float:
    """Compute the lowest frame rate t at which m_v frames of a camera show each point; equation (6)."""
    return speed_mm_s * resolution_px_per_mm / sensor_px_v * multiplicity_v


@_equation
def achieved_multiplicity_v(
    frame_rate_hz: float, sensor_px_v: float, speed_mm_s: float, resolution_px_per_mm: float
) -> float:
    """Compute the vertical multiplicity m_v = t·p_v / (v·r); equation (6) solved for m_v."""
    return frame_rate_hz * sensor_px_v / (speed_mm_s * resolution_px_per_mm)


@_equation
def parallax_px(height_mm: float, shift_mm: float, distance_mm: float, resolution_px_per_mm: float) -> float:
    """Compute the extra motion r·s·h / (d − h) of a point at height h between two views that are shifted by s."""
    require(height_mm < distance_mm, "height_mm", height_mm, f"below the distance, {distance_mm} mm")
    return resolution_px_per_mm * shift_mm * height_mm / (distance_mm - height_mm)


@_equation
def parallax_px_per_mm(shift_mm: float, distance_mm: float, resolution_px_per_mm: float) -> float:
    """Compute the parallax per mm of height, r·s / d, of heights that are small compared to the distance."""
    return resolution_px_per_mm * shift_mm / distance_mm


# Pulses and data.


@_equation
def spare_time_us(period_us: float, exposure_us: float, readout_us: float = 0.0) -> float:
    """Compute the trigger period less exposure and readout; negative if they do not fit into it.

    A sensor that exposes while it reads out has a readout of 0.
    """
    return period_us - exposure_us - readout_us


@_equation
def capture_duration_s(board_mm: float, field_mm: float, speed_mm_s: float) -> float:
    """Compute the time from the entry of the leading edge into a view to the exit of the trailing edge."""
    return (board_mm + field_mm) / speed_mm_s


@_equation
def rows_per_board(duration_s: float, frame_rate_hz: float) -> int:
    """Compute the number of pulses m while a board is in view; each point is then in at least ⌊m_v⌋ frames."""
    return ceil_to_whole(duration_s * frame_rate_hz)


@_equation
def data_rate_mbit_s(
    cameras: int, sensor_px_h: int, sensor_px_v: int, bits_per_pixel: int, frame_rate_hz: float
) -> float:
    """Compute the data rate of all cameras while a board passes, in 10⁶ bit/s."""
    return cameras * sensor_px_h * sensor_px_v * bits_per_pixel * frame_rate_hz * 1e-6


@_equation
def frame_bytes(sensor_px_h: int, sensor_px_v: int, bits_per_pixel: int) -> int:
    """Compute the size of one frame; packed pixels are padded to a whole byte at its end."""
    return ceil_to_whole(sensor_px_h * sensor_px_v * bits_per_pixel / 8)


@_equation
def buffer_bytes(cameras: int, rows: int, one_frame_bytes: int, runs: int = 1) -> int:
    """Compute the memory for all frames of `runs` runs: the size of the ring."""
    return cameras * rows * one_frame_bytes * runs
