"""The share of footprints that frames show together, against a dense search, with lenses, heights and lost frames."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from vaoi_station.frame_index import FrameIndex
from vaoi_station.geometry import Lens, apply
from vaoi_station.model import BoardType, Surface
from vaoi_station.stitching.geometry import ComponentIndex

C = np.array([[1.0, 0.02, -8.0], [0.02, -1.0, 20.0], [0, 0, 1]])


def index(*parts: tuple[float, float, float, float, float]) -> ComponentIndex:
    components = [
        {"ref": f"P{n}", "center": [x, y], "width": w, "height": h, "rotation": a}
        for n, (x, y, w, h, a) in enumerate(parts)
    ]
    return ComponentIndex.of(BoardType.model_validate({"name": "b", "components": components}))


def rows(count: int, step_mm: float = 7.0) -> np.ndarray:
    out = np.repeat(np.eye(3)[None], count, 0)
    out[:, 1, 2] = np.arange(count) * step_mm
    return out


def searched(parts: ComponentIndex, cameras: Any, motion: np.ndarray, present: Any, height: float) -> np.ndarray:
    """Return the shares by 200 × 200 points on each footprint."""
    t = (np.arange(200) + 0.5) / 200
    u, v = (g.reshape(-1, 1) for g in np.meshgrid(t, t))
    out = []
    for a, b, _, d in parts.corners:
        board = apply(C, a + u * (b - a) + v * (d - a))
        seen = np.zeros(len(board), bool)
        for i, j in present:
            seen |= cameras[i].sees(cameras[i].project(apply(motion[j], board), height))
        out.append(seen.mean())
    return np.array(out)


place = st.tuples(
    st.floats(-5, 45), st.floats(-5, 40), st.floats(0.5, 30), st.floats(0.5, 12), st.sampled_from([0, 90, 33.0])
)


@settings(max_examples=25, deadline=None)
@given(st.lists(place, min_size=1, max_size=4), st.sets(st.tuples(st.integers(0, 1), st.integers(0, 3))), st.booleans())
def test_shares_are_those_of_a_dense_search(workshop: Any, parts: Any, present: Any, raised: bool) -> None:
    lens = Lens((99.5, 79.5), 128.0, (-0.01,))
    cameras = [workshop.camera((x, 0.0), distance_mm=150.0, lens=lens) for x in (0.0, 19.0)]
    surface = Surface(lift_mm=2.0) if raised else None
    found = index(*parts)
    coverage = FrameIndex(cameras, rows(4), sorted(present), surface, C).coverage(found.corners)
    expected = searched(found, cameras, rows(4), present, 2.0 if raised else 0.0)
    assert coverage.share == pytest.approx(expected, abs=0.012)
    assert (coverage.share[coverage.in_one_frame] == 1).all()


def test_views_and_wholeness_are_counted_by_frame(workshop: Any) -> None:
    cameras = [workshop.camera((x, 0.0)) for x in (0.0, 19.0)]
    # one in the middle of camera 0, one across the seam, one off to the side
    parts = index((8, 20, 2, 2, 0), (17.5, 20.4, 6, 2, 0), (60, 20, 2, 2, 0))
    coverage = FrameIndex(cameras, rows(1), [(0, 0), (1, 0)], None, C).coverage(parts.corners)
    assert coverage.share.tolist() == pytest.approx([1, 1, 0])
    assert coverage.views.tolist() == [1, 2, 0]
    assert coverage.in_one_frame.tolist() == [True, False, False]
    half = FrameIndex(cameras, rows(1), [(1, 0)], None, C).coverage(parts.corners)
    assert half.share[0] == 0
    assert 0.5 < half.share[1] < 0.7
