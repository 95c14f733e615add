"""The index of components: the one under a point, against a search through all of them."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from vaoi_station.geometry import apply
from vaoi_station.model import BoardType
from vaoi_station.stitching.geometry import ComponentIndex

MARGIN_MM = 0.3
"""Solder and shadow around a footprint belong to its component."""


def board(components: list[dict[str, object]], y_axis: str = "up", unit: str = "mm") -> BoardType:
    return BoardType.model_validate({"name": "b", "unit": unit, "y_axis": y_axis, "components": components})


def part(ref: str, x: float, y: float, w: float = 2.0, h: float = 1.0, **keys: object) -> dict[str, object]:
    return {"ref": ref, "center": [x, y], "width": w, "height": h} | keys


def searched(index: ComponentIndex, place: np.ndarray) -> int:
    """Search the smallest component that holds a CAD point; of two alike the later one."""
    best, area = -1, math.inf
    for k in range(len(index.addresses)):
        u, v = place - index.center[k]
        cos, sin = math.cos(index.angle_rad[k]), math.sin(index.angle_rad[k])
        half = index.size[k] / 2 + MARGIN_MM / index.mm_per_unit
        inside = abs(cos * u + sin * v) <= half[0] and abs(cos * v - sin * u) <= half[1]
        if inside and index.stands_out[k] and index.size[k].prod() <= area:
            best, area = k, float(index.size[k].prod())
    return best


@pytest.mark.parametrize("y_axis", ["up", "down"])
def test_components_move_with_their_corners(y_axis: str) -> None:
    index = ComponentIndex.of(board([part("A", 1, 2), part("B", 5, 6, rotation=30)], y_axis))
    cos, sin = math.cos(0.2), math.sin(0.2)
    move = np.array([[cos, -sin, 0.5], [sin, cos, -1.0], [0, 0, 1]])
    moved = index.moved({"B": move, "elsewhere": np.eye(3)})
    np.testing.assert_array_equal(moved.corners[0], index.corners[0])
    np.testing.assert_allclose(moved.corners[1], apply(move, index.corners[1]), atol=1e-12)


def test_arrays_are_those_of_the_board_type() -> None:
    kind = board([part("U1", 1, 2, rotation=30), part("R1", 5, 6, 3, 4, body_height=0.0)], unit="inch")
    index = ComponentIndex.of(kind)
    assert index.addresses == ("U1", "R1")
    assert index.center.tolist() == [[1, 2], [5, 6]]
    assert index.size.tolist() == [[2, 1], [3, 4]]
    assert index.angle_rad == pytest.approx([math.pi / 6, 0.0])
    assert index.stands_out.tolist() == [True, False]
    assert index.mm_per_unit == 25.4


def test_rotations_run_against_the_y_axis_that_points_down() -> None:
    assert ComponentIndex.of(board([part("U1", 0, 0, rotation=30)], "down")).angle_rad == pytest.approx([-math.pi / 6])


@pytest.mark.parametrize("components", [[], [part("PAD", 0, 0, body_height=0.0)]])
def test_without_bodies_all_points_are_board(components: list[dict[str, object]]) -> None:
    assert ComponentIndex.of(board(components)).find(np.eye(3), np.zeros((2, 2))).tolist() == [-1, -1]


def test_points_are_mapped_to_cad_first() -> None:
    index = ComponentIndex.of(board([part("U1", 10, 10)]))
    cad_from_board = np.array([[0.0, -1, 10], [1, 0, 10], [0, 0, 1]])
    assert index.find(cad_from_board, np.array([[0.0, 0.0], [0.0, 1.2], [0.9, 0.0]])).tolist() == [0, 0, -1]


@settings(max_examples=40)
@given(seed=st.integers(0, 10_000), count=st.integers(1, 40), alike=st.booleans())
def test_the_grid_finds_what_a_search_through_all_finds(seed: int, count: int, alike: bool) -> None:
    g = np.random.default_rng(seed)
    size = np.full((count, 2), 3.0) if alike else g.uniform(0.2, 8, (count, 2))
    places, turns = g.uniform(0, 30, (count, 2)), g.uniform(-180, 180, count)
    parts = [
        part(f"P{k}", *places[k], *size[k], rotation=turns[k], **({"body_height": 0.0} if k % 7 == 3 else {}))
        for k in range(count)
    ]
    index = ComponentIndex.of(board(parts))
    points = g.uniform(-5, 35, (80, 2))
    assert index.find(np.eye(3), points).tolist() == [searched(index, p) for p in points]
