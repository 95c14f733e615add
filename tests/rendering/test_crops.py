"""Sizes and transforms of component pictures."""

from __future__ import annotations

import math
from typing import Any, Literal

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from vaoi_station.errors import InputError
from vaoi_station.geometry import apply
from vaoi_station.model import BoardType, Component
from vaoi_station.rendering.crops import MOST_PIXELS, Crops, Footprints, compute_crops
from vaoi_station.rendering.framing import Framing

SIDES = [(y, s) for y in ("up", "down") for s in ("top", "bottom")]


def board(y_axis: str = "up", side: str = "top", unit: str = "mm") -> BoardType:
    return BoardType.model_validate({"name": "b", "y_axis": y_axis, "side": side, "unit": unit})


def crops_of(parts: list[Component], board_type: BoardType, px_per_mm: Any, **framed: Any) -> Crops:
    return compute_crops(Footprints.of(parts, board_type), px_per_mm, Framing(**framed))


def part(rotation: float = 0.0, width: float = 4.0, height: float = 2.0) -> Component:
    return Component(ref="U1", center=(10.0, 20.0), width=width, height=height, rotation=rotation)


@pytest.mark.parametrize(("y_axis", "side"), SIDES)
def test_the_edges_of_the_box_are_the_outer_edges_of_the_border_pixels(y_axis: str, side: str) -> None:
    crops = crops_of([part()], board(y_axis, side), 10.0)
    assert crops.size.tolist() == [[40, 20]]
    corners = apply(crops.crop_from_cad[0], [[8, 19], [12, 21]])
    assert np.sort(corners[:, 0]) == pytest.approx([-0.5, 39.5])
    assert np.sort(corners[:, 1]) == pytest.approx([-0.5, 19.5])
    assert apply(crops.crop_from_cad[0], (10, 20)) == pytest.approx([19.5, 9.5])


@pytest.mark.parametrize(("y_axis", "side"), SIDES)
def test_pictures_are_upright_on_the_side_of_the_camera(y_axis: str, side: str) -> None:
    """CAD x runs to the right on the top and to the left on the bottom; CAD up is up."""
    m = crops_of([part()], board(y_axis, side), 10.0).crop_from_cad[0]
    assert m[0, 0] == pytest.approx(10 if side == "top" else -10)
    assert m[1, 1] == pytest.approx(-10 if y_axis == "up" else 10)
    assert (np.linalg.det(m) < 0) == ((y_axis == "up") != (side == "bottom")), "mirrors when CAD → image does"


@pytest.mark.parametrize("rotation", [0.0, 90.0, 180.0, 270.0, -90.0, 450.0])
def test_quarter_turns_swap_the_sides(rotation: float) -> None:
    size = crops_of([part(rotation)], board(), 10.0).size[0].tolist()
    assert size == ([40, 20] if rotation % 180 == 0 else [20, 40])


def test_at_45_degrees_the_box_holds_the_part() -> None:
    crops = crops_of([part(45.0)], board(), 100.0)
    assert crops.size[0].tolist() == pytest.approx([6 / math.sqrt(2) * 100] * 2, abs=0.5)


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
    fitting = Footprints.of(parts, board()).fitting(20.0)
    assert fitting[0] == 20.0
    assert fitting[1] < 2.0
    sizes = crops_of(parts, board(), fitting).size.prod(1)
    assert 0.99 * MOST_PIXELS < sizes[1] <= MOST_PIXELS
    with pytest.raises(InputError, match="megapixels"):
        crops_of(parts, board(), 20.0)


def test_the_matrix_states_the_scale_and_px_per_mm_what_was_asked() -> None:
    """The sides are whole pixels: 4 × 2 mm at 33.3 px/mm are 133 × 67 px."""
    crops = crops_of([part()], board(), 33.3)
    assert crops.size.tolist() == [[133, 67]]
    assert crops.px_per_mm[0] == 33.3
    assert np.abs(np.diag(crops.crop_from_cad[0])[:2]) == pytest.approx([133 / 4, 67 / 2])


def test_a_tiny_component_has_one_pixel() -> None:
    assert crops_of([part(width=1e-4, height=1e-4)], board(), 10.0).size.tolist() == [[1, 1]]


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


def test_a_margin_is_added_on_all_sides() -> None:
    crops = crops_of([part(unit) for unit in (0.0, 90.0)], board(unit="inch"), 10.0, margin_mm=2.54)
    assert crops.size.tolist() == [[1016 + 51, 508 + 51], [508 + 51, 1016 + 51]]
    assert apply(crops.crop_from_cad[0], (10, 20)) == pytest.approx((crops.size[0] - 1) / 2)
    assert not crops.bare.any()


def test_a_margin_that_makes_the_picture_too_large_is_refused_with_the_largest() -> None:
    with pytest.raises(InputError, match=r"U1: margin_mm is 90.0, but must be at most 18.5 at 100 px/mm") as refused:
        crops_of([part()], board(), 100.0, margin_mm=90.0)
    assert "18400×18200" in str(refused.value)
    assert crops_of([part()], board(), 100.0, margin_mm=18.5).size.prod() <= MOST_PIXELS
