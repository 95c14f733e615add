"""Seams: which frame each cell of the board is taken from.

Fronts start where each frame sees the board most vertically, and grow over the cells that the frame shows. They cross
bodies and places where frames disagree quickly and even ground slowly. Each cell belongs to the front that comes first.
So a body goes to the frame that reaches it first, as a whole, and fronts meet on even ground, half-way between two
frames. Bodies that CAD data name are assigned beforehand: to the frame that shows all of them most vertically.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from vaoi_station.compiled import compiled, inlined
from vaoi_station.steps import Steps

Labels = NDArray[np.int32]
NO_FRAME = -1
"""Label of a cell that no frame shows."""
_ENTRIES_PER_STEP = 10_000
"""Number of entries of the heap that are processed in one step, a few milliseconds."""


class FrameCells(NamedTuple):
    """Which cells every frame shows: boxes of cells, and one value per cell of each box."""

    box: NDArray[np.int32]
    """(f, 4) first column and row, width and height of the box of each of f frames."""
    start: NDArray[np.int64]
    """(f,) where the values of each box begin."""
    shown: NDArray[np.bool_]
    """(n,) whether the frame shows the whole cell with its neighbours; row by row, box after box."""
    seed: NDArray[np.int32]
    """(f, 2) column and row of the shown cell that the frame sees most vertically; -1 if it shows none."""
    delay: NDArray[np.float64]
    """(f,) when the front of each frame starts: distance of the seed from the foot of the camera, in cells."""


class _Heap(NamedTuple):
    """Storage of a binary heap, ordered by time."""

    time: NDArray[np.float64]
    cell: NDArray[np.int32]
    label: NDArray[np.int32]


def assign_cells(frames: FrameCells, cost: NDArray[np.float32], locked: Labels) -> Steps[Labels]:
    """Assign cells to frames: (h, w) numbers of frames, `NO_FRAME` where no frame shows the cell wholly.

    Args:
        frames: the cells that each frame shows.
        cost: (h, w) time to cross a cell; small in bodies and where frames disagree, about 1 elsewhere.
        locked: (h, w) frames of cells that were assigned beforehand, or `NO_FRAME`.
    """
    labels = np.full(cost.shape, NO_FRAME, np.int32)
    earliest = np.full(cost.shape, np.inf)
    # A cell enters the heap at most once from each of its eight neighbours, and once for each frame that starts there.
    room = 8 * cost.size + len(frames.start) + 1
    heap = _Heap(np.empty(room, np.float64), np.empty(room, np.int32), np.empty(room, np.int32))
    count = _plant(frames, cost.shape[1], heap)
    while count:
        count = _grow(frames, cost, locked, labels, earliest, heap, count)
        yield
    left = (labels == NO_FRAME) & (locked != NO_FRAME)
    labels[left] = locked[left]
    return labels


@compiled
def _plant(frames: FrameCells, width: int, heap: _Heap) -> int:
    """Enter the cell where the front of each frame starts, and return the number of entries in the heap."""
    count = 0
    for f in range(len(frames.start)):
        x, y = frames.seed[f, 0], frames.seed[f, 1]
        if x >= 0:
            count = _push(heap, count, frames.delay[f], y * width + x, f)
    return count


@compiled
def _grow(
    frames: FrameCells,
    cost: NDArray[np.float32],
    locked: Labels,
    labels: Labels,
    earliest: NDArray[np.float64],
    heap: _Heap,
    count: int,
) -> int:
    """Let fronts grow over some cells, and return the number of entries that are left in the heap.

    `earliest` (h, w) is the earliest time at which a front is known to reach each cell.
    """
    width = cost.shape[1]
    for _ in range(_ENTRIES_PER_STEP):
        if count == 0:
            break
        time, cell, f = heap.time[0], heap.cell[0], heap.label[0]
        count = _pop(heap, count)
        y, x = cell // width, cell % width
        if labels[y, x] >= 0:
            continue
        labels[y, x] = f
        bx, by, bw, bh = frames.box[f]
        for dy in range(-1, 2):
            for dx in range(-1, 2):
                u, v = x + dx, y + dy
                # The box of a frame lies within the grid, so this is also the test for the grid's borders.
                if (dx == 0 and dy == 0) or u < bx or v < by or u >= bx + bw or v >= by + bh:
                    continue
                if labels[v, u] >= 0 or not frames.shown[frames.start[f] + (v - by) * bw + u - bx]:
                    continue
                if locked[v, u] >= 0 and locked[v, u] != f:
                    continue
                step = 1.4142135 if dx != 0 and dy != 0 else 1.0
                arrival = time + step * 0.5 * (cost[y, x] + cost[v, u])
                # An entry that comes later than another one of the same cell would be dropped in the end.
                if arrival < earliest[v, u]:
                    earliest[v, u] = arrival
                    count = _push(heap, count, arrival, v * width + u, f)
    return count


@inlined
def _push(heap: _Heap, count: int, time: float, cell: int, label: int) -> int:
    n = count
    while n > 0:
        parent = (n - 1) // 2
        if heap.time[parent] <= time:
            break
        heap.time[n], heap.cell[n], heap.label[n] = heap.time[parent], heap.cell[parent], heap.label[parent]
        n = parent
    heap.time[n], heap.cell[n], heap.label[n] = time, cell, label
    return count + 1


@inlined
def _pop(heap: _Heap, count: int) -> int:
    count -= 1
    time, cell, label = heap.time[count], heap.cell[count], heap.label[count]
    n = 0
    while True:
        child = 2 * n + 1
        if child >= count:
            break
        if child + 1 < count and heap.time[child + 1] < heap.time[child]:
            child += 1
        if heap.time[child] >= time:
            break
        heap.time[n], heap.cell[n], heap.label[n] = heap.time[child], heap.cell[child], heap.label[child]
        n = child
    heap.time[n], heap.cell[n], heap.label[n] = time, cell, label
    return count
