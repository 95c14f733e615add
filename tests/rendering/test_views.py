"""Views of components, against the model step by step: C, D_j, pinhole, lens."""

from __future__ import annotations

from dataclasses import replace
from itertools import product
from typing import Any

import numpy as np
import pytest

from vaoi_station.errors import InputError, StateError
from vaoi_station.geometry import apply
from vaoi_station.rendering import View, ViewCalculator, compute_views

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


def test_the_best_comes_first(make: Any) -> None:
    s = make()
    for component in s.board_type.components:
        views = compute_views(component, s.board_type, s.stitch, s.cameras, min_coverage=0.1)
        order = [(-round(v.coverage, 3), v.off_center) for v in views]
        assert order == sorted(order)
        for v in views:
            middle = s.raw_px(v.camera, v.row, np.array(component.center))
            off = np.hypot(*(middle - s.cameras[v.camera].center_px)) / np.hypot(*s.cameras[v.camera].center_px)
            assert v.off_center == pytest.approx(off, abs=1e-3)


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


def test_frames_that_were_not_placed_show_nothing(make: Any) -> None:
    s = make()
    matrices = [list(rows) for rows in s.stitch.image_matrices]
    matrices[0][1] = None
    stitch = s.stitch.model_copy(update={"image_matrices": tuple(map(tuple, matrices))})
    for component in s.board_type.components:
        before = compute_views(component, s.board_type, s.stitch, s.cameras)
        after = compute_views(component, s.board_type, stitch, s.cameras)
        assert [(v.camera, v.row) for v in after] == [(v.camera, v.row) for v in before if (v.camera, v.row) != (0, 1)]


def test_a_component_out_of_view_has_no_views(make: Any) -> None:
    far = [{"ref": "X", "center": [500, 500], "width": 2, "height": 2}]
    s = make(components=far)
    assert compute_views(s.board_type.components[0], s.board_type, s.stitch, s.cameras, min_coverage=0.0) == ()


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


def test_without_a_cad_mapping_there_is_nothing_to_cut(make: Any) -> None:
    s = make()
    stitch = s.stitch.model_copy(update={"cad_matrix": None, "reasons": ("the fiducials were not found",)})
    with pytest.raises(StateError, match="no CAD mapping") as refused:
        compute_views(s.board_type.components[0], s.board_type, stitch, s.cameras)
    assert refused.value.code == "no-cad-mapping"
    assert "the fiducials were not found" in str(refused.value)


def test_tiles_cover_the_picture_once(make: Any) -> None:
    big = [{"ref": "ALL", "center": [20, 15], "width": 26, "height": 20}]
    s = make(lens=BENT, components=big)
    views = compute_views(
        s.board_type.components[0], s.board_type, s.stitch, s.cameras, px_per_mm=30.0, min_coverage=0.1
    )
    assert any(v.distorted for v in views)
    for view in views:
        if not view.distorted:
            continue
        count = np.zeros((view.height, view.width), dtype=int)
        for t in view.tiles:
            count[t.y0 : t.y1, t.x0 : t.x1] += 1
        assert (count == 1).all()
        assert len(view.tiles) > 1


def test_a_lens_that_hardly_bends_is_in_the_matrix(make: Any) -> None:
    s = make(lens=HARDLY_BENT)
    views = compute_views(s.board_type.components[0], s.board_type, s.stitch, s.cameras)
    assert views
    assert not any(v.distorted for v in views)


def test_without_working_distance_there_is_no_parallax(make: Any) -> None:
    s = make(surface=True)
    blind = tuple(replace(c, working_distance_mm=None) for c in s.cameras)
    view = compute_views(s.board_type.components[0], s.board_type, s.stitch, blind)[0]
    flat = s.raw_px(view.camera, view.row, view.cad_from_crop(pixels(view)))
    assert np.abs(view.image_from_crop(pixels(view)) - flat).max() < 1e-6
