"""The predicted overlap contains the points that both frames show, and no others."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from vaoi_station.geometry import Lens
from vaoi_station.stitching.matching.frame_pair import overlap_box, overlap_polygon, overlap_share, predict


def test_a_shift_cuts_off_the_part_that_leaves_the_frame(workshop: Any) -> None:
    camera = workshop.camera()
    assert overlap_box(camera, camera, np.array([3.0, 0.0])) == (0, 0, 170, 160)
    assert overlap_box(camera, camera, np.array([-3.0, -4.0])) == (30, 40, 200, 160)
    assert overlap_box(camera, camera, np.array([0.0, 4.0]), margin_px=10) == (10, 10, 190, 110)
    assert overlap_share(camera, np.array([10.0, 0.0])) == pytest.approx(0.5)


def test_frames_without_overlap_have_no_box(workshop: Any) -> None:
    camera = workshop.camera()
    assert overlap_box(camera, camera, np.array([0.0, 16.5])) is None
    assert overlap_share(camera, np.array([25.0, 0.0])) == 0


@given(
    angles=st.tuples(st.floats(-0.01, 0.01), st.floats(-0.01, 0.01)),
    shift=st.tuples(st.floats(-18, 18), st.floats(-14, 14)),
    bend=st.floats(-0.002, 0.002),
)
def test_both_frames_show_the_points_in_the_box(
    workshop: Any, angles: tuple[float, float], shift: tuple[float, float], bend: float
) -> None:
    lens = Lens((99.5, 79.5), 128.0, (bend,))
    a = workshop.camera((0, 0), angle_rad=angles[0], lens=lens)
    b = workshop.camera((4, 1), angle_rad=angles[1], lens=lens)
    box = overlap_box(a, b, np.array(shift), margin_px=3.0)
    y, x = np.mgrid[0:160:4, 0:200:4]
    px = np.stack([x.ravel(), y.ravel()], -1).astype(float)
    both = b.sees(predict(px, a, b, np.array(shift)), 8.0) & a.sees(px, 8.0)
    if box is None:
        assert not both.any()
        return
    inside = np.asarray(((px >= box[:2]) & (px < box[2:])).all(1))
    assert b.sees(predict(px[inside], a, b, np.array(shift))).all()
    assert inside[both].all(), "no point that both see well is outside the box"


@pytest.mark.parametrize("degrees", [-170.0, -90.0, -8.0, 5.0, 90.0, 180.0])
def test_the_polygon_holds_the_points_that_both_frames_show(workshop: Any, degrees: float) -> None:
    """The box of frames that are turned against each other is the smallest one around the polygon."""
    a = workshop.camera((0, 0))
    b = workshop.camera((9, 3), angle_rad=np.radians(degrees), px_per_mm=8.0, size_px=(180, 170))
    at = np.zeros(2)
    polygon, box = overlap_polygon(a, b, at), overlap_box(a, b, at)
    assert box is not None
    assert np.abs(np.array(box[:2]) - polygon.min(0)).max() <= 1
    assert np.abs(np.array(box[2:]) - polygon.max(0)).max() <= 1
    seen = predict(polygon, a, b, at)
    assert a.sees(polygon, -0.01).all()
    assert b.sees(seen, -0.01).all()
    inner = overlap_polygon(a, b, at, (5.0, 7.0))
    assert a.sees(inner, 4.99).all()
    assert b.sees(predict(inner, a, b, at), 6.99).all()


def test_frames_that_share_nothing_have_no_polygon(workshop: Any) -> None:
    a, b = workshop.camera((0, 0)), workshop.camera((30, 0), angle_rad=np.pi)
    assert overlap_polygon(a, b, np.zeros(2)).shape == (0, 2)
    assert overlap_box(a, b, np.zeros(2)) is None
    assert overlap_polygon(a, a, np.zeros(2), (90.0, 0.0)).shape == (0, 2)
