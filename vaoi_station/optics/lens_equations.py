"""Focal length, working distance, aperture: equations (1), (2) and (3)."""

from __future__ import annotations

from vaoi_station.optics.quantity_checks import require, require_positive

GREEN_UM = 0.55
"""Wavelength in µm for which diffraction is computed: the middle of the visible spectrum."""


def focal_length_mm(
    distance_mm: float, sensor_px_h: float, resolution_px_per_mm: float, sensor_width_mm: float
) -> float:
    """Compute the focal length f that images p_h / r of the board onto the sensor's width; equation (1).

    Args:
        distance_mm: distance from the lens to the board, the paper's d_max.
        sensor_px_h: pixels per row of the sensor, p_h.
        resolution_px_per_mm: pixels per mm on the board, r.
        sensor_width_mm: width of the sensor, w_s.

    Raises:
        InputError: if a quantity is not above 0.
    """
    require_positive(distance_mm=distance_mm)
    return distance_mm / _distance_over_focal_length(sensor_px_h, resolution_px_per_mm, sensor_width_mm)


def working_distance_mm(
    focal_length_mm: float, sensor_px_h: float, resolution_px_per_mm: float, sensor_width_mm: float
) -> float:
    """Compute the distance d at which a given lens reaches the resolution r; equation (1) solved for d.

    Raises:
        InputError: if a quantity is not above 0.
    """
    require_positive(focal_length_mm=focal_length_mm)
    return focal_length_mm * _distance_over_focal_length(sensor_px_h, resolution_px_per_mm, sensor_width_mm)


def depth_of_field_mm(
    distance_mm: float, focal_length_mm: float, f_number: float, circle_of_confusion_mm: float
) -> float:
    """Compute the depth of field d_f above the board, with the focus on the board's surface; equation (2).

    Args:
        distance_mm: distance from the lens to the board, d_max; above the focal length.
        focal_length_mm: focal length f.
        f_number: f-number N.
        circle_of_confusion_mm: c, the largest acceptable blur spot on the sensor.

    Raises:
        InputError: if a quantity is not above 0, or the distance is not above the focal length.
    """
    require_positive(f_number=f_number, circle_of_confusion_mm=circle_of_confusion_mm)
    _require_beyond_focus(distance_mm, focal_length_mm)
    # Only the near limit counts: components stand above the board, nothing lies below it.
    f2 = focal_length_mm**2
    nearest_mm = distance_mm * f2 / (f2 + f_number * circle_of_confusion_mm * (distance_mm - focal_length_mm))
    return distance_mm - nearest_mm


def f_number(
    depth_of_field_mm: float, distance_mm: float, focal_length_mm: float, circle_of_confusion_mm: float
) -> float:
    """Compute the f-number N that gives a depth of field d_f above the board; equation (3).

    Raises:
        InputError: if a quantity is not above 0, the distance is not above the focal length, or the depth
            of field reaches up to the lens.
    """
    require_positive(depth_of_field_mm=depth_of_field_mm, circle_of_confusion_mm=circle_of_confusion_mm)
    _require_beyond_focus(distance_mm, focal_length_mm)
    require(
        depth_of_field_mm < distance_mm, "depth_of_field_mm", depth_of_field_mm, f"below the distance, {distance_mm} mm"
    )
    return (
        depth_of_field_mm
        * focal_length_mm**2
        / (circle_of_confusion_mm * (distance_mm - focal_length_mm) * (distance_mm - depth_of_field_mm))
    )


def airy_disc_px(
    f_number: float, distance_mm: float, focal_length_mm: float, sensor_px_h: float, sensor_width_mm: float
) -> float:
    """Compute the diameter of the Airy disc on the sensor in pixels, for green light.

    The diameter is 2.44·λ·N·(1 + magnification). Diffraction limits the use of small apertures; the paper omits it.

    Raises:
        InputError: if a quantity is not above 0, or the distance is not above the focal length.
    """
    require_positive(f_number=f_number, sensor_px_h=sensor_px_h, sensor_width_mm=sensor_width_mm)
    _require_beyond_focus(distance_mm, focal_length_mm)
    # At close range the effective f-number is N·(1 + m): the image distance exceeds the focal length.
    magnification = focal_length_mm / (distance_mm - focal_length_mm)
    diameter_mm = 2.44 * GREEN_UM * 1e-3 * f_number * (1 + magnification)
    return diameter_mm * sensor_px_h / sensor_width_mm


def _distance_over_focal_length(sensor_px_h: float, resolution_px_per_mm: float, sensor_width_mm: float) -> float:
    """Compute the ratio d / f of working distance and focal length; equation (1)."""
    require_positive(
        sensor_px_h=sensor_px_h, resolution_px_per_mm=resolution_px_per_mm, sensor_width_mm=sensor_width_mm
    )
    return 1 + sensor_px_h / (resolution_px_per_mm * sensor_width_mm)


def _require_beyond_focus(distance_mm: float, focal_length_mm: float) -> None:
    """Raise InputError unless the board lies beyond the focal length; otherwise there is no real image."""
    require_positive(distance_mm=distance_mm, focal_length_mm=focal_length_mm)
    require(distance_mm > focal_length_mm, "distance_mm", distance_mm, f"above the focal length, {focal_length_mm} mm")
