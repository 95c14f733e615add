"""The compiled choice of frames, against the camera model."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from vaoi_station.geometry import Lens
from vaoi_station.model import BoardType
from vaoi_station.stitching.adjustment.motion import Motion
from vaoi_station.stitching.geometry import ComponentIndex
from vaoi_station.stitching.matching.frames import PreparedFrame, Scene

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


MOTION = Motion(np.array([0.0, 0.004, -0.003]), np.array([[0.0, 0], [0.2, -9.0], [-0.1, -18.0]]), np.array([5.0, 1.0]))


def scene(workshop: Any) -> Scene:
    bent = Lens((99.5, 79.5), 128.0, (-0.004, 0.001))
    cameras = (
        workshop.camera((0, 0), angle_rad=0.01, lens=bent),
        workshop.camera((17, 1), angle_rad=-0.006, lens=Lens((99.5, 79.5), 128.0, (0.003,))),
        workshop.camera((34, 0), tilt=(1e-4, -2e-4)),
    )
    present = tuple((i, j) for i in range(3) for j in range(3) if (i, j) != (1, 1))
    frames = {key: PreparedFrame(np.full((160, 200), 10 * n + 5, dtype=np.uint8)) for n, key in enumerate(present)}
    return Scene(cameras, present, frames.__getitem__)


def test_a_frame_of_little_contrast_is_taken_where_no_other_shows_the_point(workshop: Any) -> None:
    s, noise = scene(workshop), np.random.default_rng(3)
    points = noise.uniform((-12, -28), (46, 12), (400, 2))
    near = s.index(MOTION.rows_from_tester).nearest(points)
    faint = 0
    frames = {
        key: PreparedFrame(noise.integers(0, 10 if n == faint else 100, (160, 200)).astype(np.uint8))
        for n, key in enumerate(s.present)
    }
    number = Scene(s.cameras, s.present, frames.__getitem__).index(MOTION.rows_from_tester).nearest(points)
    others = tuple(key for n, key in enumerate(s.present) if n != faint)
    elsewhere = Scene(s.cameras, others, frames.__getitem__).index(MOTION.rows_from_tester).nearest(points)
    np.testing.assert_array_equal(number, np.where(elsewhere >= 0, elsewhere + 1, near))
    assert 0 < (number == faint).sum() < (near == faint).sum()
