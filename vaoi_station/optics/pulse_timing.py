"""Trigger period, rows per board and capture duration; sections 2.4 and 2.5."""

from __future__ import annotations

from vaoi_station.optics.quantity_checks import ceil_to_whole, require_non_negative, require_positive


def trigger_period_us(frame_rate_hz: float) -> float:
    """Compute the time between two pulses, 1 / t, in µs for a frame rate t in 1/s.

    Raises:
        InputError: if the rate is not above 0.
    """
    require_positive(frame_rate_hz=frame_rate_hz)
    return 1e6 / frame_rate_hz


def achieved_multiplicity_v(
    frame_rate_hz: float, sensor_px_v: float, speed_mm_s: float, resolution_px_per_mm: float
) -> float:
    """Compute the vertical multiplicity m_v = t·p_v / (v·r) at a frame rate; equation (6) solved for m_v.

    Raises:
        InputError: if a quantity is not above 0.
    """
    require_positive(
        frame_rate_hz=frame_rate_hz,
        sensor_px_v=sensor_px_v,
        speed_mm_s=speed_mm_s,
        resolution_px_per_mm=resolution_px_per_mm,
    )
    return frame_rate_hz * sensor_px_v / (speed_mm_s * resolution_px_per_mm)


def spare_time_us(period_us: float, exposure_us: float, readout_us: float = 0.0) -> float:
    """Compute the trigger period minus exposure and readout. It is negative if both do not fit into the period.

    A sensor that exposes while it reads out has a readout of 0. A positive value is then the paper's t < 1/s.

    Raises:
        InputError: if period or exposure is not above 0, or the readout below 0.
    """
    require_positive(period_us=period_us, exposure_us=exposure_us)
    require_non_negative(readout_us=readout_us)
    return period_us - exposure_us - readout_us


def capture_duration_s(board_mm: float, field_mm: float, speed_mm_s: float) -> float:
    """Compute the time from the leading edge's entry into the view to the trailing edge's exit.

    Args:
        board_mm: length of the board along the motion.
        field_mm: length of the view along the motion, p_v / r.
        speed_mm_s: conveyor speed v.

    Raises:
        InputError: if a quantity is not above 0.
    """
    require_positive(board_mm=board_mm, field_mm=field_mm, speed_mm_s=speed_mm_s)
    # The board is in view from the entry of its leading edge until its trailing edge has crossed the view too.
    return (board_mm + field_mm) / speed_mm_s


def rows_per_board(duration_s: float, frame_rate_hz: float) -> int:
    """Compute the number of pulses m while a board is in view; each point is then in at least ⌊m_v⌋ frames.

    Raises:
        InputError: if a quantity is not above 0.
    """
    require_positive(duration_s=duration_s, frame_rate_hz=frame_rate_hz)
    # The number is rounded up. Otherwise the trailing edge of the board would have one frame less.
    return ceil_to_whole(duration_s * frame_rate_hz)
