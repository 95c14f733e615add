from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from vaoi_station.geometry import Lens

pixels = st.lists(st.tuples(st.floats(0, 1391), st.floats(0, 1039)), min_size=1, max_size=8).map(np.array)
RADIUS = math.hypot(1392, 1040) / 2


@given(
    pixels,
    st.tuples(st.floats(600, 800), st.floats(400, 600)),
    st.lists(st.floats(-0.05, 0.15), min_size=1, max_size=3),
)
def test_distort_inverts_undistort(raw: np.ndarray, center: tuple[float, float], radial: list[float]) -> None:
    lens = Lens(center, RADIUS, tuple(radial))
    assume(lens.turning_point > 1.05 * np.hypot(*(raw - center).T).max() / RADIUS)
    np.testing.assert_allclose(lens.distort(lens.undistort(raw)), raw, atol=1e-9)


@given(pixels, st.floats(-0.25, 1.0))
def test_undistort_inverts_distort_even_for_a_fisheye(undistorted: np.ndarray, a1: float) -> None:
    lens = Lens((695.5, 519.5), RADIUS, (a1,))
    inside = np.hypot(*(undistorted - lens.center_px).T) < 0.9 * RADIUS * min(1.0, lens.turning_point * 2 / 3)
    np.testing.assert_allclose(lens.undistort(lens.distort(undistorted))[inside], undistorted[inside], atol=1e-9)


@pytest.mark.parametrize("a1", [-0.00115, -0.02, -0.1])
def test_points_beyond_the_turning_point_never_fall_back_into_the_frame(a1: float) -> None:
    """Points that only a distant camera films project far outside the frame."""
    lens = Lens((695.5, 519.5), RADIUS, (a1,))
    out = np.geomspace(RADIUS, 100 * RADIUS, 200)
    raw = lens.distort(np.column_stack([695.5 + out, np.full_like(out, 519.5)]))[:, 0] - 695.5
    assert (np.diff(raw) > 0).all()
    assert raw.min() >= RADIUS
