from __future__ import annotations

import pytest

from vaoi_station.errors import InputError
from vaoi_station.optics import buffer_bytes, data_rate_mbit_s, frame_bytes


def test_the_papers_data_rate_is_in_decimal_megabits() -> None:
    assert data_rate_mbit_s(12, 1392, 1040, 8, 8) == pytest.approx(1111.8, abs=0.05)


def test_the_papers_single_camera_at_15_frames_a_second() -> None:
    """ "Roughly 175 MBit/s"."""
    assert data_rate_mbit_s(1, 1392, 1040, 8, 15) == pytest.approx(175, rel=0.01)


def test_frames_and_buffers() -> None:
    assert frame_bytes(1392, 1040, 8) == 1392 * 1040
    assert frame_bytes(1392, 1040, 16) == 2 * 1392 * 1040
    assert frame_bytes(3, 3, 12) == 14
    assert buffer_bytes(12, 40, 1392 * 1040) == 694_886_400
    assert buffer_bytes(12, 40, 1392 * 1040, runs=3) == 3 * 694_886_400


def test_zero_rows_and_bits_are_refused() -> None:
    with pytest.raises(InputError, match="rows is 0"):
        buffer_bytes(12, 0, 100)
    with pytest.raises(InputError, match="bits_per_pixel is 0"):
        data_rate_mbit_s(1, 10, 10, 0, 8)
