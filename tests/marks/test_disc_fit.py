from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from vaoi_station.marks.disc_fit import FITTED, fit_disc
from vaoi_station.stitching.matching.frames import read_only

Paint = Callable[..., Any]
COMPILES = settings(deadline=None)
"""The first call waits for the compiler."""


@COMPILES
@given(
    at=st.tuples(st.floats(-0.5, 0.5), st.floats(-0.5, 0.5)),
    radius=st.floats(4, 15),
    blur=st.floats(0.6, 1.2),
    slope=st.tuples(st.floats(-0.004, 0.004), st.floats(-0.004, 0.004)),
)
def test_a_disc_is_fitted_whatever_its_light_and_size(
    at: tuple[float, float], radius: float, blur: float, slope: tuple[float, float]
) -> None:
    y, x = np.mgrid[:80, :80]
    u, v = x - 40 - at[0], y - 40 - at[1]
    z = (np.hypot(u, v) - radius) / blur
    cover = 0.5 * np.vectorize(math.erfc)(z / math.sqrt(2))
    image = np.rint((60 + 120 * cover) * (1 + slope[0] * u + slope[1] * v)).clip(0, 255).astype(np.uint8)
    code, px, py, sigma, found_radius, found_blur, ground, contrast = fit_disc(
        read_only(image), 40 + 0.3 * radius, 40 - 0.3 * radius, 1.1 * radius, radius, 1, 1e-3, 12
    )
    assert code == FITTED
    assert np.hypot(px - 40 - at[0], py - 40 - at[1]) < 0.02
    assert 0 < sigma < 0.02
    assert found_radius == pytest.approx(radius, abs=0.1)
    assert found_blur == pytest.approx(blur, rel=0.1)
    assert ground == pytest.approx(60, abs=2)
    assert contrast == pytest.approx(120, abs=4)


def test_sigma_is_the_scatter_of_repetitions(paint: Paint) -> None:
    clean, g, errors, sigmas = paint([("circle", 48.3, 39.8, 16.0)]).astype(float), np.random.default_rng(7), [], []
    for _ in range(60):
        image = np.clip(np.rint(clean + g.normal(0, 3, clean.shape)), 0, 255).astype(np.uint8)
        _, x, y, sigma, *_ = fit_disc(read_only(image), 48.0, 40.0, 8.0, 6.0, 1, 1e-3, 12)
        errors.append((x - 48.3, y - 39.8))
        sigmas.append(sigma)
    assert np.sqrt(np.mean(np.square(errors))) == pytest.approx(np.mean(sigmas), rel=0.35)
