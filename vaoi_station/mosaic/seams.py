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
_ENTRIES_PER_STEP = 20_000
"""Number of entries that are taken in one step, a few milliseconds."""


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


class _Queue(NamedTuple):
    """Cells that fronts will reach, in buckets of equal width by time.

    No front crosses a cell in less than the width of a bucket. So whatever order the cells of one bucket are taken in,
    none of them is reached earlier from another one, and the result is that of a heap, in a fraction of its time.
    """

    width: float
    """Width of a bucket."""
    top: NDArray[np.int32]
    """The last entry of each bucket, −1 for none. Buckets are used in turn: all that wait lie within their number."""
    below: NDArray[np.int32]
    """The entry below each one in its bucket; of a free one the next that is free."""
    time: NDArray[np.float64]
    cell: NDArray[np.int32]
    label: NDArray[np.int32]
    state: NDArray[np.int64]
    """(4,) number of the present bucket, number of entries that wait, a free entry or −1, number of entries used."""


def assign_cells(frames: FrameCells, cost: NDArray[np.float32], locked: Labels) -> Steps[Labels]:
    """Assign cells to frames: (h, w) numbers of frames, `NO_FRAME` where no frame shows the cell wholly.

    Args:
        frames: the cells that each frame shows.
        cost: (h, w) time to cross a cell; small in bodies and where frames disagree, about 1 elsewhere.
        locked: (h, w) frames of cells that were assigned beforehand, or `NO_FRAME`.
    """
    labels = np.full(cost.shape, NO_FRAME, np.int32)
    earliest = np.full(cost.shape, np.inf)
    # A little less than the shortest time, for the rounding of sums.
    width = 0.999 * float(cost.min())
    furthest = max(1.5 * float(cost.max()), float(frames.delay.max(initial=0.0)))
    # A cell is entered at most once from each of its eight neighbours, and once for each frame that starts there.
    room = 8 * cost.size + len(frames.start) + 1
    queue = _Queue(
        width,
        np.full(int(furthest / width) + 2, -1, np.int32),
        np.empty(room, np.int32),
        np.empty(room, np.float64),
        np.empty(room, np.int32),
        np.empty(room, np.int32),
        np.array([0, 0, -1, 0], np.int64),
    )
    _plant(frames, earliest, queue)
    while queue.state[1]:
        _grow(frames, cost, locked, labels, earliest, queue)
        yield
    left = (labels == NO_FRAME) & (locked != NO_FRAME)
    labels[left] = locked[left]
    return labels


@compiled
def _plant(frames: FrameCells, earliest: NDArray[np.float64], queue: _Queue) -> None:
    """Enter the cell where the front of each frame starts."""
    for f in range(len(frames.start)):
        x, y = frames.seed[f, 0], frames.seed[f, 1]
        if x >= 0 and frames.delay[f] < earliest[y, x]:
            earliest[y, x] = frames.delay[f]
            _enter(queue, frames.delay[f], y * earliest.shape[1] + x, f)


@compiled
def _grow(
    frames: FrameCells,
    cost: NDArray[np.float32],
    locked: Labels,
    labels: Labels,
    earliest: NDArray[np.float64],
    queue: _Queue,
) -> None:
    """Let fronts grow over some cells.

    `earliest` (h, w) is the earliest time at which a front is known to reach each cell.
    """
    width, state = cost.shape[1], queue.state
    taken = 0
    while taken < _ENTRIES_PER_STEP and state[1] > 0:
        bucket = state[0] % len(queue.top)
        entry = queue.top[bucket]
        if entry < 0:
            state[0] += 1
            continue
        taken += 1
        time, cell, f = queue.time[entry], queue.cell[entry], queue.label[entry]
        queue.top[bucket] = queue.below[entry]
        queue.below[entry], state[2] = state[2], entry
        state[1] -= 1
        y, x = cell // width, cell % width
        # An entry that comes later than another one of the same cell is left over.
        if labels[y, x] >= 0 or time > earliest[y, x]:
            continue
        labels[y, x] = f
        bx, by, bw, bh = frames.box[f, 0], frames.box[f, 1], frames.box[f, 2], frames.box[f, 3]
        for dy in range(-1, 2):
            for dx in range(-1, 2):
                u, v = x + dx, y + dy
                # The box of a frame lies within the grid, so this is also the test for the grid's borders.
                if (dx == 0 and dy == 0) or u < bx or v < by or u >= bx + bw or v >= by + bh:
                    continue
                step = 1.4142135 if dx != 0 and dy != 0 else 1.0
                arrival = time + step * 0.5 * (cost[y, x] + cost[v, u])
                # Cells that have a frame were reached earlier.
                if arrival >= earliest[v, u] or not frames.shown[frames.start[f] + (v - by) * bw + u - bx]:
                    continue
                if locked[v, u] < 0 or locked[v, u] == f:
                    earliest[v, u] = arrival
                    _enter(queue, arrival, v * width + u, f)


@inlined
def _enter(queue: _Queue, time: float, cell: int, label: int) -> None:
    state = queue.state
    entry = state[2]
    if entry >= 0:
        state[2] = queue.below[entry]
    else:
        entry = state[3]
        state[3] += 1
    bucket = int(time / queue.width) % len(queue.top)
    queue.time[entry], queue.cell[entry], queue.label[entry] = time, cell, label
    queue.below[entry], queue.top[bucket] = queue.top[bucket], entry
    state[1] += 1
