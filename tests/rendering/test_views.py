"""Views of components, against the model step by step: C, D_j, pinhole, lens."""

from __future__ import annotations

import math
from dataclasses import replace
from itertools import product
from typing import Any, Literal

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.rendering.computed import compute_views
from vaoi_station.errors import InputError
from vaoi_station.geometry import Camera, Lens, Projective, System, apply
from vaoi_station.model import BoardType, Component
from vaoi_station.rendering import Framing, View, ViewCalculator
from vaoi_station.rendering.views import MOST_PIXELS, Crops, cut_tiles, lay_out, sigma_px

BENT = (0.012, 0.001)
HARDLY_BENT = (0.0002,)


def pixels(view: View, n: int = 7) -> Any:
    x, y = np.linspace(0, view.width - 1, n), np.linspace(0, view.height - 1, n)
    return np.stack(np.meshgrid(x, y), -1).reshape(-1, 2)


def raw_from_crop(view: View, at: Any) -> Any:
    """Through the tiles where there are any: the matrix of the tile a pixel lies in."""
    if not view.tiles:
        return view.image_from_crop(at)
    out = np.full(at.shape, np.nan)
    for t in view.tiles:
        mine = (at >= (t.x0 - 0.5, t.y0 - 0.5)).all(-1) & (at <= (t.x1 - 0.5, t.y1 - 0.5)).all(-1)
        out[mine] = apply(t.matrix, at[mine] - (t.x0, t.y0))
    return out


@pytest.mark.parametrize("lens", [(), HARDLY_BENT, BENT])
@pytest.mark.parametrize("surface", [False, True])
@pytest.mark.parametrize(("y_axis", "side"), list(product(("up", "down"), ("top", "bottom"))))
def test_matrices_match_the_model_step_by_step(make: Any, y_axis: str, side: str, surface: bool, lens: Any) -> None:
    s = make(y_axis=y_axis, side=side, surface=surface, lens=lens)
    calculator, seen = ViewCalculator(s.board_type, s.stitch, s.cameras), 0
    for component in s.board_type.components:
        height = float(s.stitch.surface.height_mm(component.center)) if surface else 0.0
        for view in calculator.compute(component):
            at = pixels(view)
            cad = view.cad_from_crop(at)
            np.testing.assert_allclose(view.crop_from_cad(cad), at, atol=1e-9)
            truth = s.raw_px(view.camera, view.row, cad, height)
            limit = 1e-6 if not lens else 0.05
            assert np.abs(raw_from_crop(view, at) - truth).max() < limit
            if not view.distorted:
                back = view.image_from_crop.inverse()(truth)
                assert np.abs(back - at).max() < limit
            seen += 1
    assert seen > 20


@pytest.mark.parametrize(("y_axis", "side", "y_up"), list(product(("up", "down"), ("top", "bottom"), (False, True))))
def test_pictures_are_upright_and_never_mirrored(make: Any, y_axis: str, side: str, y_up: bool) -> None:
    s = make(y_axis=y_axis, side=side, y_up_in_tester=y_up)
    for view in compute_views(s.board_type.components[4], s.board_type, s.stitch, s.cameras):
        linear = view.image_from_crop.matrix[:2, :2]
        assert np.linalg.det(linear) > 0
        assert linear[0, 0] > 0.9
        assert linear[1, 1] > 0.9


@pytest.mark.parametrize("lens", [(), BENT])
@pytest.mark.parametrize("least", [0.0, 0.3, 0.5, 1.0])
def test_every_frame_that_shows_enough_and_no_other(make: Any, least: float, lens: Any) -> None:
    s = make(lens=lens)
    for component in s.board_type.components:
        views = compute_views(component, s.board_type, s.stitch, s.cameras, min_coverage=least)
        given = {(v.camera, v.row): v.coverage for v in views}
        assert len(given) == len(views)
        half = np.array([component.width, component.height]) / 2
        t = np.linspace(-1, 1, 41) * (1 - 1 / 40)
        grid = np.stack(np.meshgrid(t, t), -1).reshape(-1, 2) * half + component.center
        for i, j in product(range(2), range(4)):
            share = float(s.cameras[i].sees(s.raw_px(i, j, grid)).mean())
            if (i, j) in given:
                assert given[i, j] == pytest.approx(share, abs=0.13)
                assert given[i, j] >= least
            else:
                assert (
                    share <= max(least, 0.02) + 0.13
                    if least < 1
                    else share < 1 or s.cameras[i].sees(s.raw_px(i, j, grid), 3.0).mean() < 1
                )


def test_all_components_at_once_match_each_alone(make: Any) -> None:
    s = make(lens=BENT, surface=True)
    calculator = ViewCalculator(s.board_type, s.stitch, s.cameras)
    whole = calculator.compute_all(s.board_type.components)
    assert set(whole) == {c.address for c in s.board_type.components}
    for component in s.board_type.components:
        alone = calculator.compute(component)
        assert len(alone) == len(whole[component.address])
        for a, b in zip(alone, whole[component.address], strict=True):
            assert (a.camera, a.row, a.width, a.height, a.distorted) == (
                b.camera,
                b.row,
                b.width,
                b.height,
                b.distorted,
            )
            np.testing.assert_allclose(a.matrix, b.matrix, atol=1e-9)
    assert calculator.compute_all([]) == {}


def test_resolution_is_the_cameras_unless_asked_for(make: Any) -> None:
    s = make(unit="inch")
    component = s.board_type.components[4]
    own = compute_views(component, s.board_type, s.stitch, s.cameras)[0]
    assert own.px_per_mm == pytest.approx(8.0, rel=0.001)
    assert (own.width, own.height) == (40, 24)
    fine = compute_views(component, s.board_type, s.stitch, s.cameras, px_per_mm=20.0)[0]
    assert (fine.width, fine.height) == (100, 60)
    with pytest.raises(InputError, match="px_per_mm"):
        compute_views(component, s.board_type, s.stitch, s.cameras, px_per_mm=2000.0)


def test_a_component_with_a_c_of_its_own_is_in_the_frames_that_show_it_there(make: Any) -> None:
    s = make()
    part, move = s.board_type.components[4], np.array([[1.0, 0, 6.0], [0, 1.0, -9.0], [0, 0, 1.0]])
    there = part.model_copy(update={"center": tuple(apply(move, np.array(part.center)).tolist())})
    own = s.stitch.model_copy(update={"local_matrices": {part.address: s.stitch.tester_from_cad.matrix @ move}})
    expected = compute_views(there, s.board_type, s.stitch, s.cameras)
    found = compute_views(part, s.board_type, own, s.cameras)
    assert [(v.camera, v.row, round(v.coverage, 6)) for v in found] == [
        (v.camera, v.row, round(v.coverage, 6)) for v in expected
    ]
    assert {(v.camera, v.row) for v in found} != {
        (v.camera, v.row) for v in compute_views(part, s.board_type, s.stitch, s.cameras)
    }


@pytest.mark.parametrize(("y_axis", "side"), list(product(("up", "down"), ("top", "bottom"))))
@pytest.mark.parametrize("surface", [False, True])
def test_the_direction_is_that_of_the_line_of_sight(make: Any, y_axis: str, side: str, surface: bool) -> None:
    """The line of sight: the CAD points that one pixel shows at two heights lie on it."""
    s = make(y_axis=y_axis, side=side, surface=surface, unit="inch")
    for component in s.board_type.components[::3]:
        center = np.array(component.center)
        height = float(s.stitch.surface.height_mm(center)) if surface else 0.0
        for view in compute_views(component, s.board_type, s.stitch, s.cameras):
            camera, d = s.cameras[view.camera], s.stitch.row_motion[view.row]
            pixel = s.raw_px(view.camera, view.row, center, height)
            above = camera.ground(pixel, height + 10.0)
            cad = s.stitch.tester_from_cad.inverse()((above - d[:2, 2]) @ d[:2, :2])
            along_mm = (cad - center) * s.board_type.mm_per_unit
            assert view.angle_deg is not None
            assert view.angle_deg == pytest.approx(math.degrees(math.atan2(np.hypot(*along_mm), 10.0)), abs=0.05)
            if view.azimuth_deg is not None and view.angle_deg > 0.5:
                expected = math.degrees(math.atan2(along_mm[1], along_mm[0]))
                assert abs((view.azimuth_deg - expected + 180) % 360 - 180) < 0.5


@pytest.mark.parametrize(("y_axis", "side"), list(product(("up", "down"), ("top", "bottom"))))
def test_a_raised_point_moves_away_from_the_side_the_part_is_seen_from(make: Any, y_axis: str, side: str) -> None:
    s = make(y_axis=y_axis, side=side)
    for component in s.board_type.components:
        for view in compute_views(component, s.board_type, s.stitch, s.cameras):
            if view.picture_azimuth_deg is None or (view.angle_deg or 0) < 0.5:
                continue
            center = np.array(component.center)
            raised = view.image_from_crop.inverse()(s.raw_px(view.camera, view.row, center, 2.0))
            shift = raised - view.crop_from_cad(center)
            away = math.degrees(math.atan2(-shift[1], shift[0])) + 180
            assert abs((view.picture_azimuth_deg - away + 180) % 360 - 180) < 1.0


def test_a_picture_at_the_top_of_the_part_is_right_there(make: Any) -> None:
    s = make(surface=True)
    component = s.board_type.components[4]
    calculator = ViewCalculator(s.board_type, s.stitch, s.cameras)
    height = float(s.stitch.surface.height_mm(np.array(component.center)))
    views = calculator.compute(component, framing=Framing(plane="top"), height_mm=3.0)
    assert views
    for view in views:
        assert (view.plane, view.height_mm) == ("top", 3.0)
        corner = np.array([view.width - 1.0, 0.0])
        truth = s.raw_px(view.camera, view.row, view.cad_from_crop(corner), height + 3.0)
        assert view.image_from_crop(corner) == pytest.approx(truth, abs=1e-6)
    unknown = calculator.compute(component, framing=Framing(plane="top"))
    assert {(v.plane, v.height_mm) for v in unknown} == {("board", 0.0)}


def test_without_working_distance_the_direction_is_unknown(make: Any) -> None:
    s = make()
    blind = tuple(replace(c, working_distance_mm=None) for c in s.cameras)
    view = compute_views(s.board_type.components[0], s.board_type, s.stitch, blind)[0]
    assert (view.angle_deg, view.azimuth_deg, view.picture_azimuth_deg) == (None, None, None)


def test_the_uncertainty_of_a_height_adds_along_the_parallax(make: Any) -> None:
    s = make()
    view = compute_views(s.board_type.components[0], s.board_type, s.stitch, s.cameras)[0]
    flat = np.diag([0.0004, 0.0001])
    assert sigma_px(flat) == pytest.approx(0.02)
    assert view.covariance_px2(None) is None
    assert sigma_px(None) is None
    level = view.covariance_px2(flat)
    raised = view.covariance_px2(flat, height_sigma_mm=0.5)
    assert raised is not None
    assert level is not None
    np.testing.assert_allclose(level, flat)
    assert raised.trace() - flat.trace() == pytest.approx(0.25 * (view.lift_px**2).sum())
    assert view.frame_px_per_mm == pytest.approx(8.0, rel=0.01)


SIDES = [(y, s) for y in ("up", "down") for s in ("top", "bottom")]


def board(y_axis: str = "up", side: str = "top", unit: str = "mm") -> BoardType:
    return BoardType.model_validate({"name": "b", "y_axis": y_axis, "side": side, "unit": unit})


def crops_of(parts: list[Component], board_type: BoardType, px_per_mm: Any, **framed: Any) -> Crops:
    return lay_out(parts, board_type, Framing(px_per_mm, **framed), 1.0)


def part(rotation: float = 0.0, width: float = 4.0, height: float = 2.0) -> Component:
    return Component(ref="U1", center=(10.0, 20.0), width=width, height=height, rotation=rotation)


@given(
    rotation=st.floats(-360, 360),
    size=st.tuples(st.floats(0.01, 30), st.floats(0.01, 30)),
    px_per_mm=st.floats(0.5, 60),
    unit=st.sampled_from(["mm", "inch", "mil"]),
    kind=st.sampled_from(SIDES),
)
def test_the_whole_footprint_is_in_the_picture_and_pixels_are_square_within_rounding(
    rotation: float,
    size: tuple[float, float],
    px_per_mm: float,
    unit: Literal["mm", "inch", "mil"],
    kind: tuple[str, str],
) -> None:
    k = {"mm": 1.0, "inch": 25.4, "mil": 0.0254}[unit]
    board_type = board(*kind, unit)
    component = part(rotation, size[0] / k, size[1] / k)
    crops = crops_of([component], board_type, px_per_mm)
    w, h = crops.size[0]
    corners = apply(crops.crop_from_cad[0], board_type.footprint(component))
    assert corners.min(0) == pytest.approx([-0.5, -0.5], abs=1e-6 * max(w, h))
    assert corners.max(0) == pytest.approx([w - 0.5, h - 0.5], abs=1e-6 * max(w, h))
    np.testing.assert_allclose(crops.cad_from_crop[0] @ crops.crop_from_cad[0], np.eye(3), atol=1e-8)
    scale = np.abs(np.diag(crops.crop_from_cad[0])[:2]) / k
    extent = (corners.max(0) - corners.min(0)) / scale
    assert (np.abs(scale - px_per_mm) * extent <= 0.5 + 1e-6).all() or (crops.size[0] == 1).any()


def test_a_picture_too_large_is_refused_by_name_with_the_largest_resolution() -> None:
    says = r"U1: px_per_mm is 5000.0, but must be at most 1412.79, small enough for 16 megapixels"
    with pytest.raises(InputError, match=says):
        crops_of([part()], board(), 5000.0)
    assert crops_of([part()], board(), 1412.79).size.prod() <= MOST_PIXELS
    with pytest.raises(InputError, match=r"px_per_mm is 5000.0, but must be at most 92.95, small enough"):
        crops_of([part()], board(), 5000.0, margin_mm=20.0)
    assert crops_of([part()], board(), 92.95, margin_mm=20.0).size.prod() <= MOST_PIXELS


def test_a_large_component_gets_the_resolution_that_fits() -> None:
    parts = [part(), part(width=4000.0, height=3000.0)]
    crops = lay_out(parts, board(), Framing(), 20.0)
    assert crops.px_per_mm[0] == 20.0
    assert crops.px_per_mm[1] < 2.0
    assert 0.99 * MOST_PIXELS < crops.size.prod(1)[1] <= MOST_PIXELS
    with pytest.raises(InputError, match="megapixels"):
        crops_of(parts, board(), 20.0)


@pytest.mark.parametrize(("y_axis", "side"), SIDES)
@pytest.mark.parametrize("rotation", [0.0, 30.0, 90.0, 200.0])
def test_a_turned_picture_shows_the_part_as_at_rotation_0(y_axis: str, side: str, rotation: float) -> None:
    board_type = board(y_axis, side)
    crops = crops_of([part(rotation)], board_type, 10.0, align="part")
    straight = crops_of([part(0.0)], board_type, 10.0)
    assert crops.size.tolist() == [[40, 20]]
    corners, plain = (board_type.footprint(part(r)) for r in (rotation, 0.0))
    turned = apply(crops.crop_from_cad[0], corners)
    np.testing.assert_allclose(turned, apply(straight.crop_from_cad[0], plain), atol=1e-9)
    np.testing.assert_allclose(crops.cad_from_crop[0] @ crops.crop_from_cad[0], np.eye(3), atol=1e-9)
    assert np.sign(np.linalg.det(crops.crop_from_cad[0])) == np.sign(np.linalg.det(straight.crop_from_cad[0]))


MATRIX = np.array([[1.02, 0.03, 20.0], [-0.02, 0.97, 15.0], [2e-5, -3e-5, 1.0]])


@pytest.mark.parametrize("bend_px", [0.03, 0.4, np.inf])
def test_tiles_follow_the_lens(bend_px: float) -> None:
    """A lens of 1 px at the corner of the frame, in a picture of nearly the whole frame."""
    n = Projective(np.diag([8.0, 8.0, 1.0]), System.IMAGE, System.ROW)
    camera = Camera(640, 480, n, Lens((319.5, 239.5), 400.0, (0.0025,)))
    size = np.array([[560.0, 400.0], [40.0, 30.0]])
    bends = np.array([bend_px, bend_px])
    [whole, small] = cut_tiles(np.stack([MATRIX, MATRIX]), size, bends, lambda _, points: camera.lens.distort(points))
    assert len(whole) >= len(small) >= 4
    covered = np.zeros((400, 560), dtype=int)
    for tile in whole:
        covered[tile.y0 : tile.y1, tile.x0 : tile.x1] += 1
        y, x = np.mgrid[tile.y0 : tile.y1, tile.x0 : tile.x1]
        at = np.stack([x, y], -1).reshape(-1, 2).astype(float)
        exact = camera.lens.distort(apply(MATRIX, at))
        if bend_px >= 0.4:
            assert np.abs(apply(tile.matrix, at - (tile.x0, tile.y0)) - exact).max() < 0.01
    assert (covered == 1).all()
