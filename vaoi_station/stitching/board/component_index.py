"""The components of a board type as arrays, with a grid that finds the one on which a point lies.

Lengths are in CAD units and angles in CAD's axes, y as the board type has it.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from vaoi_station.compiled import compiled
from vaoi_station.geometry.transforms import Floats
from vaoi_station.model import BoardType
from vaoi_station.stitching.adjustment.observations import Ints

_AROUND_MM = 0.3
"""Margin around a footprint: solder and shadow of a component belong to it."""
_MOST_CELLS = 400
"""Largest number of cells along each axis of the grid."""


@dataclass(frozen=True, eq=False)
class ComponentIndex:
    """n components, in the order of the board type."""

    addresses: tuple[str, ...]
    center: Floats
    """(n, 2)."""
    size: Floats
    """(n, 2) width and height before they are turned."""
    angle_rad: Floats
    """(n,)."""
    stands_out: NDArray[np.bool_]
    """(n,) whether a component is, or may be, higher than the board."""
    mm_per_unit: float

    @staticmethod
    def of(board_type: BoardType) -> ComponentIndex:
        """Make the index of a board type."""
        parts, sign = board_type.components, 1.0 if board_type.y_axis == "up" else -1.0
        return ComponentIndex(
            tuple(p.address for p in parts),
            np.array([p.center for p in parts], dtype=np.float64).reshape(-1, 2),
            np.array([(p.width, p.height) for p in parts], dtype=np.float64).reshape(-1, 2),
            np.radians(np.array([sign * p.rotation for p in parts], dtype=np.float64)),
            np.array([p.body_height is None or p.body_height > 0 for p in parts], dtype=np.bool_),
            board_type.mm_per_unit,
        )

    def find(self, cad_from_board: Floats, board_mm: Floats) -> Ints:
        """Find the number of the component on which each board point (k, 2) lies; −1 for none; the smallest wins.

        Args:
            cad_from_board: (3, 3) affine, the inverse of C.
            board_mm: (k, 2) tester coordinates.
        """
        out = np.full(len(board_mm), -1)
        cells = self._cells
        if len(cells.numbers):
            boxes = _Boxes(self.center, self._turn, self._half)
            _find(np.ascontiguousarray(cad_from_board), np.ascontiguousarray(board_mm), cells, boxes, out)
        return out

    @cached_property
    def _turn(self) -> Floats:
        """Cosine and sine (n, 2) of the angles."""
        return np.stack([np.cos(self.angle_rad), np.sin(self.angle_rad)], -1)

    @cached_property
    def _half(self) -> Floats:
        """Half of width and height (n, 2), with the margin."""
        return self.size / 2 + _AROUND_MM / self.mm_per_unit

    @cached_property
    def _cells(self) -> _Cells:
        """The grid over the components that stand out."""
        # Flat components are board: their links lie on its surface.
        use = np.flatnonzero(self.stands_out)
        # Small ones first, since the smallest wins; of two alike, the later one of the board type.
        use = use[np.argsort(-self.size[use].prod(1), kind="stable")[::-1]]
        cos, sin = np.abs(self._turn[use]).T
        w, h = self._half[use].T
        reach = np.stack([cos * w + sin * h, sin * w + cos * h], -1)
        return _Cells.of(use, self.center[use] - reach, self.center[use] + reach)


class _Cells(NamedTuple):
    """A grid, and for every cell the boxes that reach into it."""

    origin: Floats
    size: Floats
    """(2,) of a cell."""
    first: Ints
    """(rows, columns + 1): start and end of each cell's boxes in `numbers`."""
    numbers: Ints
    """Numbers of the boxes, cell by cell, in the order in which they were given."""

    @staticmethod
    def of(numbers: Ints, low: Floats, high: Floats) -> _Cells:
        """Build the grid over boxes with corners (n, 2)."""
        if not len(numbers):
            return _Cells(np.zeros(2), np.ones(2), np.zeros((1, 2), np.int_), np.zeros(0, np.int_))
        origin, span = low.min(0), high.max(0) - low.min(0)
        # Cells as large as an average box: a point is compared with few boxes, and a box lies in few cells.
        size = np.maximum((high - low).mean(0), span / _MOST_CELLS)
        columns, rows = (np.floor(span / size).astype(int) + 1).tolist()
        (x0, y0), (x1, y1) = (np.floor((corner - origin) / size).astype(int).T for corner in (low, high))
        wide, tall = x1 - x0 + 1, y1 - y0 + 1
        box = np.repeat(np.arange(len(numbers)), wide * tall)
        k = np.arange(len(box)) - np.repeat(np.cumsum(wide * tall) - wide * tall, wide * tall)
        cell = (y0[box] + k // wide[box]) * columns + x0[box] + k % wide[box]
        ends = np.append(0, np.cumsum(np.bincount(cell, minlength=rows * columns)))
        first = ends[np.arange(rows)[:, None] * columns + np.arange(columns + 1)]
        # Stable: within a cell the boxes keep their order, and the first hit is the one that wins.
        return _Cells(origin, size, first, numbers[box[np.argsort(cell, kind="stable")]])


class _Boxes(NamedTuple):
    """Rotated rectangles."""

    center: Floats
    turn: Floats
    """(n, 2) cosine and sine."""
    half: Floats
    """(n, 2)."""


@compiled
def _find(cad_from_board: Floats, board_mm: Floats, cells: _Cells, boxes: _Boxes, out: Ints) -> None:
    """Write into `out` (k,) the number of the first box of its cell in which each point lies."""
    origin, size, first, numbers = cells.origin, cells.size, cells.first, cells.numbers
    center, turn, half = boxes.center, boxes.turn, boxes.half
    rows, columns = first.shape[0], first.shape[1] - 1
    m = cad_from_board
    for n in range(len(board_mm)):
        x = m[0, 0] * board_mm[n, 0] + m[0, 1] * board_mm[n, 1] + m[0, 2]
        y = m[1, 0] * board_mm[n, 0] + m[1, 1] * board_mm[n, 1] + m[1, 2]
        column, row = math.floor((x - origin[0]) / size[0]), math.floor((y - origin[1]) / size[1])
        if column < 0 or row < 0 or column >= columns or row >= rows:
            continue
        for at in range(first[row, column], first[row, column + 1]):
            k = numbers[at]
            u, v = x - center[k, 0], y - center[k, 1]
            cos, sin = turn[k, 0], turn[k, 1]
            if abs(cos * u + sin * v) <= half[k, 0] and abs(cos * v - sin * u) <= half[k, 1]:
                out[n] = k
                break
