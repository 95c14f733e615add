"""Measured figures equal those with which the pictures were drawn."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from vaoi_station.photometry.image_quality import measure_quality
from vaoi_station.pixel_formats import to_full_scale


@pytest.mark.parametrize("noise", [0.0, 1.5, 4.0])
@pytest.mark.parametrize("blur", [0.5, 0.7, 1.0, 1.5, 2.0])
def test_the_measured_blur_is_that_of_the_picture(painter: Any, blur: float, noise: float) -> None:
    figures = measure_quality(painter.tilted_board(blur, noise))
    assert figures.blur_px == pytest.approx(blur, rel=0.06)
    assert figures.mtf50 == pytest.approx(min(0.187 / blur, 0.5), rel=0.07)
    assert all(b == pytest.approx(blur, rel=0.2) for row in figures.blur_tiles_px for b in row)


def test_focus_does_not_depend_on_the_exposure(painter: Any) -> None:
    bright = painter.tilted_board(1.0)
    dim = (bright // 2).astype(np.uint8)
    assert measure_quality(dim).focus == pytest.approx(measure_quality(bright).focus, rel=0.05)
    assert measure_quality(dim).blur_px == pytest.approx(measure_quality(bright).blur_px, rel=0.05)


@pytest.mark.parametrize("noise", [0.0, 3.0])
def test_without_edges_there_is_no_blur_figure(painter: Any, noise: float) -> None:
    figures = measure_quality(painter.exposed(np.full((120, 160), 90.0), noise))
    assert (figures.blur_px, figures.mtf50) == (None, None)
    assert {b for row in figures.blur_tiles_px for b in row} == {None}


def test_levels_are_shares_of_the_full_scale() -> None:
    ramp: Any = np.tile(np.arange(256), (256, 1)).astype(np.uint8)
    f = measure_quality(ramp)
    assert (f.mean, f.low, f.high) == pytest.approx((0.5, 0.01, 0.99), abs=0.006)
    assert f.saturated == 1 / 256
    twelve = to_full_scale((ramp.astype(np.uint16) << 4) | 15, 12)
    assert measure_quality(twelve).high == pytest.approx(f.high, abs=0.01)
    assert measure_quality(twelve).saturated == f.saturated
    assert measure_quality(twelve // 4).high == pytest.approx(f.high / 4, abs=0.01), "a dark frame is dark"
    colour = np.dstack([ramp // 2, ramp, ramp // 4])
    assert measure_quality(colour).saturated == f.saturated, "one channel is enough"
