"""Bodies stand where the CAD data put the parts, with a texture that covers their top."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from vaoi_station.simulation.board.bodies import Body, build_bodies
from vaoi_station.simulation.board.canvas import Canvas
from vaoi_station.simulation.board.layout import Part, place_parts
from vaoi_station.simulation.board.packages import BIG, MIDDLE, Finish, chip, sot23
from vaoi_station.simulation.scenario import BoardSection

PX_PER_MM = 12.0
CHIP = chip("1206", "C", (3.2, 1.6), 1.2, Finish.CERAMIC)


def body_of(part: Part, photograph: Canvas | None = None) -> Body:
    [body] = build_bodies((part,), PX_PER_MM, photograph)
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


@given(st.sampled_from([0.0, 45.0, 90.0, 180.0, 270.0]))
def test_the_outline_is_the_rotated_rectangle(turned: float) -> None:
    body = body_of(Part("C1", CHIP, (5.0, 6.0), turned, 1.2))
    edges = np.roll(body.outline_mm, -1, axis=0) - body.outline_mm
    assert sorted(np.hypot(*edges.T).round(9)) == [1.6, 1.6, 3.2, 3.2]
    assert np.allclose(body.outline_mm.mean(0), (5.0, 6.0))
    assert body.center_mm == (5.0, 6.0)


def test_a_can_is_a_cylinder() -> None:
    part = by_finish(Finish.CAN)
    body = body_of(part)
    radius = part.package.body[0] / 2
    assert np.allclose(np.hypot(*(body.outline_mm - part.place).T), radius)
    assert (body.cover / 255.0).sum() / PX_PER_MM**2 == pytest.approx(math.pi * radius**2, rel=0.02)


@pytest.mark.parametrize("finish", [f for f in Finish if f is not Finish.RESISTOR])
def test_every_finish_paints_a_top(finish: Finish) -> None:
    body = body_of(by_finish(finish))
    assert body.top.shape == body.metal.shape == body.cover.shape
    assert np.ptp(body.top[body.cover == 255]) > 20


@pytest.mark.parametrize(("finish", "metallic"), [(Finish.CAN, True), (Finish.CRYSTAL, True), (Finish.EPOXY, False)])
def test_metal_tops_are_metallic(finish: Finish, metallic: bool) -> None:
    body = body_of(by_finish(finish))
    assert bool(np.median(body.metal[body.cover == 255]) > 100) == metallic


def test_end_caps_of_a_chip_are_bright_metal() -> None:
    body = body_of(Part("C1", CHIP, (5.0, 6.0), 0.0, 1.2))
    for u in (-1.2, 1.2):
        x, y = body.to_px(np.array([5.0 + u, 6.0])).round().astype(int)
        assert (body.top[y, x], body.metal[y, x]) == (194, 255)
    x, y = body.to_px(np.array([5.0, 6.0])).round().astype(int)
    assert (body.top[y, x], body.metal[y, x]) == (112, 0)


def test_lettering_depends_on_the_name_alone() -> None:
    package = BIG[4]()
    first, moved, other = (
        body_of(Part(ref, package, place, 0.0, 1.5))
        for ref, place in (("U1", (10.0, 10.0)), ("U1", (22.0, 22.0)), ("U2", (10.0, 10.0)))
    )
    assert np.array_equal(first.top, moved.top)
    assert not np.array_equal(first.top, other.top)


def test_flat_parts_have_no_body() -> None:
    flat = place_parts(BoardSection(height_scale=0.0))
    assert build_bodies(flat, PX_PER_MM, None) == ()
    parts = place_parts(BoardSection(height_scale=2.0))
    bodies = build_bodies(parts, 4.0, None)
    assert [body.ref for body in bodies] == [part.ref for part in parts]
    assert all(body.height_mm == part.body_height_mm for body, part in zip(bodies, parts, strict=True))


def test_walls_are_darker_than_the_top_they_carry() -> None:
    assert body_of(by_finish(Finish.CAN)).side_grey == pytest.approx(0.75 * 176)


def test_on_a_photograph_the_top_shows_its_pixels() -> None:
    photograph = Canvas.blank((-1.0, -1.0), (20.0, 16.0), PX_PER_MM, 0.0)
    photograph.grey[:] = np.arange(photograph.grey.shape[1], dtype=np.float32)[None] % 200
    part = Part("Q1", sot23(), (8.0, 7.0), 0.0, 1.0)
    body = body_of(part, photograph)
    x = photograph.to_px(np.array([8.0, 7.0]))[0]
    column, row = body.to_px(np.array([8.0, 7.0])).round().astype(int)
    assert abs(float(body.top[row, column]) - float(x)) <= 1.0


def test_at_the_edge_of_a_photograph_its_border_is_continued() -> None:
    photograph = Canvas.blank((0.0, 0.0), (10.0, 10.0), PX_PER_MM, 77.0)
    assert set(np.unique(body_of(Part("Q1", sot23(), (0.2, 0.2), 0.0, 1.0), photograph).top)) == {77}
