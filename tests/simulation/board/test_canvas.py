from __future__ import annotations

import math

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from vaoi_station.simulation.board.canvas import Canvas

FRACTION = st.floats(0, 1)


def _blank() -> Canvas:
    return Canvas.blank((-1.0, -1.0), (6.0, 5.0), 10.0, 0.0)


def _middle_mm(canvas: Canvas) -> tuple[float, float]:
    y, x = np.mgrid[: canvas.grey.shape[0], : canvas.grey.shape[1]]
    total = canvas.grey.sum()
    u, v = (canvas.grey * x).sum() / total, (canvas.grey * y).sum() / total
    return (u + 0.5) / 10 - 1, (v + 0.5) / 10 - 1


@given(FRACTION, FRACTION, st.floats(0.05, 2), st.floats(0.05, 2), st.sampled_from([0.0, 90.0, 180.0]))
def test_upright_boxes_have_exact_area_and_middle(x: float, y: float, w: float, h: float, turned: float) -> None:
    canvas = _blank()
    canvas.box((1 + x, 1 + y), (w, h), 1.0, turned_deg=turned)
    assert math.isclose(float(canvas.grey.sum()), 100 * w * h, rel_tol=1e-4)
    assert np.allclose(_middle_mm(canvas), (1 + x, 1 + y), atol=1e-5)


@given(FRACTION, FRACTION)
def test_discs_are_where_they_are_put(x: float, y: float) -> None:
    canvas = _blank()
    canvas.disc((1 + x, 1 + y), 1.3, 1.0, metal=1.0)
    assert np.allclose(_middle_mm(canvas), (1 + x, 1 + y), atol=3.5e-4)  # 0.0035 px
    assert math.isclose(float(canvas.grey.sum()), 100 * math.pi * 0.65**2, rel_tol=0.01)
    assert np.allclose(canvas.metal, canvas.grey)


@given(FRACTION, FRACTION, st.floats(1, 89))
def test_turned_boxes_keep_place_and_area(x: float, y: float, turned: float) -> None:
    canvas = _blank()
    canvas.box((1 + x, 1 + y), (1.2, 0.8), 1.0, turned_deg=turned)
    assert np.allclose(_middle_mm(canvas), (1 + x, 1 + y), atol=1e-3)
    assert math.isclose(float(canvas.grey.sum()), 96, rel_tol=0.03)
