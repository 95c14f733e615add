from __future__ import annotations

import pytest

from vaoi_station.calibration.artwork.artwork_files import array_of
from vaoi_station.model import CameraHead


def test_an_array_is_that_of_nominal_values() -> None:
    def head(x: float | None, px: float | None, width: int = 400) -> CameraHead:
        center = None if x is None else (x, 0.0)
        return CameraHead(width=width, height=300, exposure_us=1.0, nominal_center_mm=center, nominal_px_per_mm=px)

    pitch, field = array_of([head(0, 10), head(30, 20, 500)])
    assert pitch == 30.0
    assert field == pytest.approx((20.0, 15.0))
    assert array_of([head(0, None), head(None, 10)]) == (None, None)
    assert array_of([head(0, None)], 40.0) == (None, (10.0, 7.5))
