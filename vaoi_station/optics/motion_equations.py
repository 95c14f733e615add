"""Effects of the board's motion on frames: equations (4), (5) and (6), and parallax."""

from __future__ import annotations

from vaoi_station.optics.quantity_checks import require, require_non_negative, require_positive


def motion_blur_px(speed_mm_s: float, resolution_px_per_mm: float, exposure_us: float) -> float:
    """Compute the distance v·r·s in pixels that the board moves during one exposure; equation (4).

    Args:
        speed_mm_s: conveyor speed v.
        resolution_px_per_mm: resolution on the board, r.
        exposure_us: exposure time s.

    Raises:
        InputError: if a quantity is not above 0.
    """
    require_positive(speed_mm_s=speed_mm_s, resolution_px_per_mm=resolution_px_per_mm, exposure_us=exposure_us)
    return speed_mm_s * resolution_px_per_mm * exposure_us * 1e-6


def longest_exposure_us(blur_px: float, speed_mm_s: float, resolution_px_per_mm: float) -> float:
    """Compute the longest exposure time s with at most `blur_px` (τ) of motion blur; equation (5).

    Raises:
        InputError: if a quantity is not above 0.
    """
    require_positive(blur_px=blur_px, speed_mm_s=speed_mm_s, resolution_px_per_mm=resolution_px_per_mm)
    return blur_px / (speed_mm_s * resolution_px_per_mm) * 1e6


def lowest_frame_rate_hz(
    speed_mm_s: float, resolution_px_per_mm: float, sensor_px_v: float, multiplicity_v: float
) -> float:
    """Compute the lowest frame rate t, 1/s, at which m_v frames of a camera show each point; equation (6).

    Args:
        speed_mm_s: conveyor speed v.
        resolution_px_per_mm: resolution on the board, r.
        sensor_px_v: pixels of a frame along the motion, p_v.
        multiplicity_v: required number of frames of one camera that show each point, m_v.

    Raises:
        InputError: if a quantity is not above 0.
    """
    require_positive(
        speed_mm_s=speed_mm_s,
        resolution_px_per_mm=resolution_px_per_mm,
        sensor_px_v=sensor_px_v,
        multiplicity_v=multiplicity_v,
    )
    return speed_mm_s * resolution_px_per_mm / sensor_px_v * multiplicity_v


def parallax_px(height_mm: float, shift_mm: float, distance_mm: float, resolution_px_per_mm: float) -> float:
    """Compute the parallax r·s·h / (d − h): the extra motion in pixels of a point above the board's surface.

    Between two rows, the shift s is the motion of the board. Between two neighbouring cameras, it is their pitch.
    Parallax is the error of a stitch that ignores heights, and also the signal from which heights are measured.

    Args:
        height_mm: height of the point above the calibrated plane, h; below the distance.
        shift_mm: shift between the two views, s.
        distance_mm: distance of the cameras from the plane, d.
        resolution_px_per_mm: resolution in the plane, r.

    Raises:
        InputError: if a quantity is out of its range.
    """
    require_positive(distance_mm=distance_mm, resolution_px_per_mm=resolution_px_per_mm)
    require_non_negative(height_mm=height_mm, shift_mm=shift_mm)
    require(height_mm < distance_mm, "height_mm", height_mm, f"below the distance, {distance_mm} mm")
    # Similar triangles: a ray through a point at height h meets the board h / (d − h) times further from the foot.
    return resolution_px_per_mm * shift_mm * height_mm / (distance_mm - height_mm)


def parallax_px_per_mm(shift_mm: float, distance_mm: float, resolution_px_per_mm: float) -> float:
    """Compute the parallax in px per mm of height, r·s / d, for heights that are small compared to the distance.

    Raises:
        InputError: if the distance or the resolution is not above 0, or the shift below 0.
    """
    require_positive(distance_mm=distance_mm, resolution_px_per_mm=resolution_px_per_mm)
    require_non_negative(shift_mm=shift_mm)
    return resolution_px_per_mm * shift_mm / distance_mm
