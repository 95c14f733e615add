"""Data rates and buffer sizes; section 2.5. Prefixes are decimal: 1 Mbit = 10⁶ bit."""

from __future__ import annotations

from vaoi_station.optics.quantity_checks import ceil_to_whole, require_positive


def frame_bytes(sensor_px_h: int, sensor_px_v: int, bits_per_pixel: int) -> int:
    """Compute the size of one frame in bytes. Packed pixels are padded to a whole byte at the end of the frame.

    Raises:
        InputError: if a quantity is not above 0.
    """
    require_positive(sensor_px_h=sensor_px_h, sensor_px_v=sensor_px_v, bits_per_pixel=bits_per_pixel)
    # 12-bit packed formats store two pixels in three bytes, so an odd pixel count ends within a byte.
    return ceil_to_whole(sensor_px_h * sensor_px_v * bits_per_pixel / 8)


def data_rate_mbit_s(
    cameras: int, sensor_px_h: int, sensor_px_v: int, bits_per_pixel: int, frame_rate_hz: float
) -> float:
    """Compute the data rate of all cameras while a board passes, in 10⁶ bit/s.

    Raises:
        InputError: if a quantity is not above 0.
    """
    require_positive(
        cameras=cameras,
        sensor_px_h=sensor_px_h,
        sensor_px_v=sensor_px_v,
        bits_per_pixel=bits_per_pixel,
        frame_rate_hz=frame_rate_hz,
    )
    return cameras * sensor_px_h * sensor_px_v * bits_per_pixel * frame_rate_hz * 1e-6


def buffer_bytes(cameras: int, rows: int, one_frame_bytes: int, runs: int = 1) -> int:
    """Compute the memory in bytes for all frames of `runs` runs. This is the size of the ring.

    Raises:
        InputError: if a quantity is not above 0.
    """
    require_positive(cameras=cameras, rows=rows, one_frame_bytes=one_frame_bytes, runs=runs)
    return cameras * rows * one_frame_bytes * runs
