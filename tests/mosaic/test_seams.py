"""The growth of fronts over cells."""

from __future__ import annotations

import numpy as np

from vaoi_station.mosaic.seams import NO_FRAME, FrameCells, assign_cells
from vaoi_station.steps import completed


def two_frames(shape: tuple[int, int], width: int) -> FrameCells:
    """Two frames that overlap in the middle columns, each starting at its outer end."""
    h, w = shape
    box = np.array([(0, 0, width, h), (w - width, 0, width, h)], np.int32)
    start = np.array([0, width * h], np.int64)
    seed = np.array([(0, h // 2), (w - 1, h // 2)], np.int32)
    return FrameCells(box, start, np.ones(2 * width * h, bool), seed, np.zeros(2))


def test_fronts_meet_half_way_on_even_ground() -> None:
    labels = completed(
        assign_cells(two_frames((9, 21), 15), np.ones((9, 21), np.float32), np.full((9, 21), NO_FRAME, np.int32))
    )
    assert (labels[4, :10] == 0).all()
    assert (labels[4, 11:] == 1).all()


def test_body_in_the_middle_belongs_to_one_frame() -> None:
    cost = np.ones((9, 21), np.float32)
    cost[2:7, 7:12] = 0.05
    labels = completed(assign_cells(two_frames((9, 21), 15), cost, np.full((9, 21), NO_FRAME, np.int32)))
    assert len(np.unique(labels[3:6, 8:11])) == 1


def test_every_cell_has_the_frame_whose_front_comes_first() -> None:
    """Compared with the shortest paths of each frame alone, by Bellman and Ford, over ground of random cost."""
    g = np.random.default_rng(1)
    cost = g.uniform(0.05, 1.0, (17, 29)).astype(np.float32)
    frames = two_frames((17, 29), 22)
    frames.delay[:] = 0.7, 3.1
    times = np.full((2, 17, 29), np.inf)
    for f, ((x, y), delay) in enumerate(zip(frames.seed.tolist(), frames.delay.tolist(), strict=True)):
        left = int(frames.box[f, 0])
        seen, price = times[f, :, left : left + 22], cost[:, left : left + 22].astype(float)
        seen[y, x - left] = delay
        for _ in range(seen.size):
            before = seen.copy()
            for dy, dx in np.ndindex(3, 3):
                a, b = (np.s_[max(d - 1, 0) : n + min(d - 1, 0)] for d, n in ((dy, 17), (dx, 22)))
                c, d = (np.s_[max(1 - d, 0) : n + min(1 - d, 0)] for d, n in ((dy, 17), (dx, 22)))
                way = np.hypot(dy - 1, dx - 1) / 2 * (price[a, b] + price[c, d])
                seen[a, b] = np.minimum(seen[a, b], before[c, d] + way)
            if (seen == before).all():
                break
    labels = completed(assign_cells(frames, cost, np.full((17, 29), NO_FRAME, np.int32)))
    np.testing.assert_array_equal(labels, times.argmin(0))


def test_locked_cells_keep_their_frame_and_cells_that_no_frame_shows_have_none() -> None:
    locked = np.full((9, 21), NO_FRAME, np.int32)
    locked[3:5, 8:10] = 1
    labels = completed(assign_cells(two_frames((9, 21), 8), np.ones((9, 21), np.float32), locked))
    assert (labels[3:5, 8:10] == 1).all()
    assert labels[0, 10] == NO_FRAME


def test_frame_that_shows_no_cell_takes_none() -> None:
    frames = two_frames((5, 10), 8)
    frames.seed[1] = -1
    labels = completed(assign_cells(frames, np.ones((5, 10), np.float32), np.full((5, 10), NO_FRAME, np.int32)))
    assert set(np.unique(labels)) == {NO_FRAME, 0}
