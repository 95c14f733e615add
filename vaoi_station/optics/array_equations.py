"""How many cameras stand side by side, and what they overlap; section 2.4, w·r·m_h ≤ n·p_h."""

from __future__ import annotations

from vaoi_station.optics.quantity_checks import require_positive


def cameras_needed(width_mm: float, resolution_px_per_mm: float, multiplicity_h: float, sensor_px_h: float) -> float:
    """Number of cameras w·r·m_h / p_h, as a fraction: the next whole number is what to buy.

    Args:
        width_mm: of the widest board, w.
        resolution_px_per_mm: r.
        multiplicity_h: in how many cameras' frames every point is to be seen, m_h.
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
    """Horizontal multiplicity m_h that a number of cameras reaches over the width w: n·p_h / (w·r).

    Raises:
        InputError: if a quantity is not above 0.
    """
    require_positive(
        cameras=cameras, sensor_px_h=sensor_px_h, width_mm=width_mm, resolution_px_per_mm=resolution_px_per_mm
    )
    return cameras * sensor_px_h / (width_mm * resolution_px_per_mm)


def field_of_view_mm(sensor_px: float, resolution_px_per_mm: float) -> float:
    """Length of board along one side of a frame, p / r.

    Raises:
        InputError: if a quantity is not above 0.
    """
    require_positive(sensor_px=sensor_px, resolution_px_per_mm=resolution_px_per_mm)
    return sensor_px / resolution_px_per_mm


def camera_pitch_mm(cameras: int, width_mm: float, field_mm: float) -> float:
    """Distance between neighbouring cameras whose views together end where the widest board ends.

    0 for a single camera, and where one view covers the board.

    Raises:
        InputError: if a quantity is not above 0.
    """
    require_positive(cameras=cameras, width_mm=width_mm, field_mm=field_mm)
    return max(width_mm - field_mm, 0.0) / (cameras - 1) if cameras > 1 else 0.0
