"""Number, pitch and overlap of the cameras of an array (paper, section 2.4).

n cameras, each p_h px wide, must cover the width w at r px/mm, and m_h cameras must see each point: w·r·m_h ≤ n·p_h.
"""

from __future__ import annotations

from vaoi_station.optics.quantity_checks import require_positive


def cameras_needed(width_mm: float, resolution_px_per_mm: float, multiplicity_h: float, sensor_px_h: float) -> float:
    """Compute the required number of cameras w·r·m_h / p_h. It is not rounded up to a whole number.

    Args:
        width_mm: width of the widest board, w.
        resolution_px_per_mm: resolution on the board, r.
        multiplicity_h: required number of cameras that see each point, m_h.
        sensor_px_h: pixels per row of one sensor, p_h.

    Raises:
        InputError: if a quantity is not above 0.
    """
    require_positive(
        width_mm=width_mm,
        resolution_px_per_mm=resolution_px_per_mm,
        multiplicity_h=multiplicity_h,
        sensor_px_h=sensor_px_h,
    )
    return width_mm * resolution_px_per_mm * multiplicity_h / sensor_px_h


def achieved_multiplicity_h(cameras: int, sensor_px_h: float, width_mm: float, resolution_px_per_mm: float) -> float:
    """Compute the horizontal multiplicity m_h = n·p_h / (w·r) of n cameras over the width w.

    Raises:
        InputError: if a quantity is not above 0.
    """
    require_positive(
        cameras=cameras, sensor_px_h=sensor_px_h, width_mm=width_mm, resolution_px_per_mm=resolution_px_per_mm
    )
    return cameras * sensor_px_h / (width_mm * resolution_px_per_mm)


def field_of_view_mm(sensor_px: float, resolution_px_per_mm: float) -> float:
    """Compute the length p / r of board, mm, that one side of a frame with p pixels shows.

    Raises:
        InputError: if a quantity is not above 0.
    """
    require_positive(sensor_px=sensor_px, resolution_px_per_mm=resolution_px_per_mm)
    return sensor_px / resolution_px_per_mm


def camera_pitch_mm(cameras: int, width_mm: float, field_mm: float) -> float:
    """Compute the distance between neighbouring cameras whose views together just cover the widest board.

    The distance is 0 for a single camera, or if a single view covers the board.

    Raises:
        InputError: if a quantity is not above 0.
    """
    require_positive(cameras=cameras, width_mm=width_mm, field_mm=field_mm)
    # The two outer views end at the edges of the board, so there are n − 1 equal steps between n views.
    return max(width_mm - field_mm, 0.0) / (cameras - 1) if cameras > 1 else 0.0
