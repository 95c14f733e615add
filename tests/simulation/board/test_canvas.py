from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from vaoi_station.simulation.board.canvas import Canvas, bands, to_bytes

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


def test_crosses_have_two_arms() -> None:
    canvas = _blank()
    canvas.cross((1.05, 1.05), 2.0, 0.5, 1.0)
    assert math.isclose(float(canvas.grey.sum()), 100 * (2 * 2 * 0.5 - 0.25), rel_tol=1e-5)
    assert canvas.grey[20, 20] == 1
    assert canvas.grey[12:16, 12:16].sum() == 0


def test_shapes_off_the_canvas_leave_it_alone() -> None:
    canvas = _blank()
    canvas.disc((50, 50), 1.0, 1.0)
    canvas.box((-50, 2), (1, 1), 1.0)
    canvas.text("U1", (50, 50), 1.0, 1.0)
    assert not canvas.grey.any()


def test_text_turns_counter_clockwise() -> None:
    flat, turned = _blank(), _blank()
    flat.text("L", (2.0, 1.5), 2.0, 1.0)
    turned.text("L", (2.0, 1.5), 2.0, 1.0, 90.0)
    # the foot of an upright L is below; turned counter-clockwise it is to the right
    assert flat.grey[:25].sum() < flat.grey[25:].sum()
    assert turned.grey[:, :30].sum() < turned.grey[:, 30:].sum()


def test_a_blank_canvas_covers_at_least_its_rectangle() -> None:
    canvas = Canvas.blank((2.0, 3.0), (1.04, 2.06), 10.0, 7.0)
    assert canvas.grey.shape == canvas.metal.shape == (21, 11)
    assert set(np.unique(canvas.grey)) == {7.0}
    assert canvas.to_px(np.array([2.05, 3.05])).tolist() == pytest.approx([0.0, 0.0])


@given(st.floats(0.3, 1.5), st.floats(10, 250))
def test_blending_the_same_shape_again_changes_only_its_edge(size: float, grey: float) -> None:
    once, twice = _blank(), _blank()
    once.box((2.0, 1.5), (size, size), grey)
    for _ in range(2):
        twice.box((2.0, 1.5), (size, size), grey)
    whole = once.grey == np.float32(grey)
    assert (twice.grey[whole] == np.float32(grey)).all()
    assert (twice.grey >= once.grey).all()
    assert not twice.grey[once.grey == 0].any()


@given(st.floats(0, 80))
def test_large_turned_boxes_have_their_area_too(turned: float) -> None:
    canvas = Canvas.blank((0.0, 0.0), (30.0, 30.0), 10.0, 0.0)
    canvas.box((15.0, 15.0), (14.0, 9.0), 1.0, turned_deg=turned)
    assert float(canvas.grey.sum()) == pytest.approx(100 * 14 * 9, rel=2e-3)


def test_strokes_have_their_width_and_their_ends() -> None:
    canvas = _blank()
    canvas.strokes([np.array([[0.0, 1.0], [3.0, 1.0]])], 0.5, 100.0, metal=1.0)
    column = canvas.grey[:, 25]
    assert column.sum() / 100 == pytest.approx(5 + 2.7, abs=0.2)
    assert canvas.grey[19, 5] == 0
    assert canvas.metal.max() == 1.0
    before = canvas.grey.copy()
    canvas.strokes([], 0.5, 200.0)
    assert np.array_equal(canvas.grey, before)


def test_closed_strokes_return_to_their_start() -> None:
    corners = np.array([[0.0, 0.0], [3.0, 0.0], [3.0, 2.0], [0.0, 2.0]])
    open_, closed = _blank(), _blank()
    open_.strokes([corners], 0.3, 1.0)
    closed.strokes([corners], 0.3, 1.0, closed=True)
    x, y = open_.to_px(np.array([0.0, 1.0])).round().astype(int)
    assert (open_.grey[y, x], closed.grey[y, x]) == (0, 1)


@given(st.integers(0, 1000))
def test_bands_cover_every_row_once(rows: int) -> None:
    found = [row for band in bands(rows) for row in range(rows)[band]]
    assert found == list(range(rows))


def test_bytes_are_rounded_clipped_and_read_only() -> None:
    plane = np.array([[-3.0, 0.4, 0.6, 254.7, 300.0]], np.float32)
    assert to_bytes(plane).tolist() == [[0, 0, 1, 255, 255]]
    assert to_bytes(plane, 0.5).tolist() == [[0, 0, 0, 127, 150]]
    with pytest.raises(ValueError, match="read-only"):
        to_bytes(plane)[0, 0] = 1


def test_longer_text_is_wider_and_as_tall() -> None:
    def extent(text: str) -> tuple[int, int]:
        canvas = Canvas.blank((0.0, 0.0), (20.0, 5.0), 10.0, 0.0)
        canvas.text(text, (10.0, 2.5), 2.0, 1.0)
        rows, columns = np.nonzero(canvas.grey > 0.5)
        return int(np.ptp(rows)), int(np.ptp(columns))

    (tall, wide), (tall_two, wide_two) = extent("H"), extent("HH")
    assert tall == pytest.approx(0.75 * 20, abs=2)
    assert abs(tall - tall_two) <= 1
    assert wide_two > 1.8 * wide
