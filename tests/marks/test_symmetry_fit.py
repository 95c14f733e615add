from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from vaoi_station.marks.symmetry_fit import FITTED, TOO_FAR, UNDETERMINED, fit_symmetry

COMPILES = settings(deadline=None)
"""The first call waits for the compiler."""


def test_a_symmetric_picture_is_centred_and_its_gain_may_slope() -> None:
    y, x = np.mgrid[:120, :120]
    u, v = x - 60.3, y - 58.8
    picture = (50 + 90 * np.exp(-(u**2 + 0.4 * u * v + 2 * v**2) / 150)) * (1 + 0.003 * u - 0.002 * v)
    code, px, py, sigma = fit_symmetry(picture.astype(np.float32), 62.0, 58.0, 20, 8.0, 2)
    assert code == 0
    assert np.hypot(px - 60.3, py - 58.8) < 2e-3
    assert 0 <= sigma < 0.01


def blob(x0: float, y0: float) -> Any:
    y, x = np.mgrid[:120, :120]
    u, v = x - x0, y - y0
    return (50 + 90 * np.exp(-(u**2 + 0.4 * u * v + 2 * v**2) / 150)).astype(np.float32)


@COMPILES
@given(st.floats(-0.5, 0.5), st.floats(-0.5, 0.5), st.tuples(st.floats(-3, 3), st.floats(-3, 3)))
def test_the_centre_is_found_at_each_fraction_of_a_pixel(fx: float, fy: float, off: tuple[float, float]) -> None:
    code, x, y, _ = fit_symmetry(blob(60 + fx, 60 + fy), 60 + off[0], 60 + off[1], 20, 8.0, 2)
    assert code == FITTED
    assert np.hypot(x - 60 - fx, y - 60 - fy) < 2e-3


@pytest.mark.parametrize("turn", [False, True])
def test_an_edge_and_a_plain_image_leave_the_centre_undetermined(turn: bool) -> None:
    edge = np.full((120, 120), 60, np.float32)
    edge[:, 60:] = 200
    picture = np.ascontiguousarray(edge.T) if turn else edge
    assert fit_symmetry(picture, 60.0, 60.0, 20, 8.0, 2)[0] == UNDETERMINED
    assert fit_symmetry(np.full((120, 120), 90, np.float32), 60.0, 60.0, 20, 8.0, 2)[0] == UNDETERMINED


def test_a_centre_beyond_the_reach_is_refused() -> None:
    assert fit_symmetry(blob(69.0, 60.0), 60.0, 60.0, 20, 3.0, 2)[0] == TOO_FAR
