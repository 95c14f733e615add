from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from vaoi_station.marks.candidate_kernels import RING, ring_offsets, scan_candidates, suppress_non_maxima
from vaoi_station.marks.mark_shape import coverage
from vaoi_station.stitching.matching.frames import read_only

Paint = Callable[..., Any]
COMPILES = settings(deadline=None)
"""The first call waits for the compiler."""


def test_every_pixel_with_a_bare_rim_and_no_other_is_correlated(paint: Paint) -> None:
    image = paint([("circle", 30.2, 25.7, 7.0), ("square", 60.1, 30.4, 7.0)], noise=2.0)
    template = coverage("circle", 7.0, 11)
    template -= template.mean()
    template /= np.sqrt((template**2).sum())
    ring = ring_offsets(5.0)
    found = scan_candidates(read_only(image), template, ring, 1, 0.5)
    expected = []
    for y in range(5, image.shape[0] - 5):
        for x in range(5, image.shape[1] - 5):
            core = [int(image[y + v, x + u]) for u, v in ((0, 0), (1, 0), (-1, 0), (0, 1), (0, -1))]
            axes = sorted(int(image[y + v, x + u]) for u, v in ((5, 0), (-5, 0), (0, 5), (0, -5)))
            rim = np.array([int(image[y + v, x + u]) for u, v in ring])
            lighter = axes[2] <= min(core) - 8 and (rim <= min(core) - 8).sum() >= RING - 4
            darker = axes[1] >= max(core) + 8 and (rim >= max(core) + 8).sum() >= RING - 4
            window = image[y - 5 : y + 6, x - 5 : x + 6].astype(float)
            window -= window.mean()
            score = abs((window * template).sum()) / max(np.sqrt((window**2).sum()), 1e-9)
            if (lighter or darker) and score >= 0.5:
                expected.append((x, y, score))
    assert len(expected) > 3
    assert np.allclose(found, expected, atol=1e-4)


def test_the_best_of_neighbouring_hits_is_kept() -> None:
    hits = np.array([[10.0, 10, 0.9], [12, 11, 0.8], [20, 10, 0.7], [10, 14, 0.6]])
    assert suppress_non_maxima(hits, 3, 9).tolist() == [0, 2, 3]
    assert suppress_non_maxima(hits, 3, 2).tolist() == [0, 2]


@COMPILES
@given(st.integers(0, 2**31), st.integers(1, 8), st.integers(1, 20))
def test_kept_hits_are_apart_and_each_lost_one_has_a_better_neighbour(seed: int, apart: int, count: int) -> None:
    g = np.random.default_rng(seed)
    hits = np.column_stack([g.integers(0, 30, (count, 2)), np.sort(g.uniform(0, 1, count))[::-1]])
    kept = suppress_non_maxima(hits, apart, 50)
    distance = np.abs(hits[:, None, :2] - hits[None, :, :2]).max(-1)
    for n in range(count):
        better = [k for k in kept if k < n]
        near = [k for k in better if distance[n, k] <= apart]
        assert (n in kept) is not bool(near)


def test_the_ring_is_a_circle_of_whole_pixels() -> None:
    offsets = ring_offsets(7.0)
    assert offsets.shape == (RING, 2)
    assert offsets[0].tolist() == [7, 0]
    assert np.abs(np.hypot(*offsets.T) - 7).max() <= 0.75
    assert np.array_equal(np.sort(offsets, axis=0), np.sort(-offsets, axis=0))


def test_more_hits_than_the_first_buffer_holds_are_all_returned() -> None:
    """A regular pattern of dots gives several hundred hits."""
    y, x = np.mgrid[:200, :240]
    image = np.where((x % 8 < 2) & (y % 8 < 2), 200, 60).astype(np.uint8)
    template = coverage("square", 2.0, 5)
    template -= template.mean()
    template /= np.sqrt((template**2).sum())
    found = scan_candidates(read_only(image), template, ring_offsets(3.0), 1, 0.0)
    assert len(found) == 0
    wide = np.where((x % 8 < 4) & (y % 8 < 4), 200, 60).astype(np.uint8)
    template = coverage("square", 4.0, 7)
    template -= template.mean()
    template /= np.sqrt((template**2).sum())
    found = scan_candidates(read_only(wide), template, ring_offsets(3.0), 1, 0.2)
    assert len(found) > 256
    assert len(np.unique(found[:, :2], axis=0)) == len(found)
