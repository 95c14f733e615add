"""Bodies stand where the CAD data put the parts, with a texture that covers their top."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from vaoi_station.simulation.board.bodies import Body, build_bodies
from vaoi_station.simulation.board.layout import Part, place_parts
from vaoi_station.simulation.board.packages import BIG, MIDDLE, Finish, chip
from vaoi_station.simulation.scenario import BoardSection

PX_PER_MM = 12.0
CHIP = chip("1206", "C", (3.2, 1.6), 1.2, Finish.CERAMIC)


def body_of(part: Part) -> Body:
    [body] = build_bodies((part,), PX_PER_MM)
    return body


def by_finish(finish: Finish) -> Part:
    package = next(p for p in (make() for make in (*BIG, *MIDDLE)) if p.finish is finish)
    return Part("X7", package, (10.0, 8.0), 0.0, package.body_height)


@given(st.floats(5, 6), st.floats(5, 6), st.sampled_from([0.0, 45.0, 90.0, 180.0, 270.0]))
def test_the_cover_has_the_area_and_the_centre_of_the_body(x: float, y: float, turned: float) -> None:
    body = body_of(Part("C1", CHIP, (x, y), turned, 1.2))
    cover = body.cover / 255.0
    assert cover.sum() / PX_PER_MM**2 == pytest.approx(3.2 * 1.6, rel=0.01)
    rows, columns = np.mgrid[: cover.shape[0], : cover.shape[1]]
    center = np.array([(cover * columns).sum(), (cover * rows).sum()]) / cover.sum()
    assert np.abs(center - body.to_px(np.array([x, y]))).max() < 0.05


@pytest.mark.parametrize("finish", [f for f in Finish if f is not Finish.RESISTOR])
def test_every_finish_paints_a_top(finish: Finish) -> None:
    body = body_of(by_finish(finish))
    assert body.top.shape == body.metal.shape == body.cover.shape
    assert np.ptp(body.top[body.cover == 255]) > 20


def test_end_caps_of_a_chip_are_bright_metal() -> None:
    body = body_of(Part("C1", CHIP, (5.0, 6.0), 0.0, 1.2))
    for u in (-1.2, 1.2):
        x, y = body.to_px(np.array([5.0 + u, 6.0])).round().astype(int)
        assert (body.top[y, x], body.metal[y, x]) == (194, 255)
    x, y = body.to_px(np.array([5.0, 6.0])).round().astype(int)
    assert (body.top[y, x], body.metal[y, x]) == (112, 0)


def test_flat_parts_have_no_body() -> None:
    flat = place_parts(BoardSection(height_scale=0.0))
    assert build_bodies(flat, PX_PER_MM) == ()
    parts = place_parts(BoardSection(height_scale=2.0))
    bodies = build_bodies(parts, 4.0)
    assert [body.ref for body in bodies] == [part.ref for part in parts]
    assert all(body.height_mm == part.body_height_mm for body, part in zip(bodies, parts, strict=True))
