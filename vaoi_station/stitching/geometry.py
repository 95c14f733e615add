"""Where components lie on the board: which of them is under a point. Lengths are in CAD units."""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from vaoi_station.compiled import compiled
from vaoi_station.frame_index import FootprintViews
from vaoi_station.geometry import Camera
from vaoi_station.geometry.transforms import Floats
from vaoi_station.marks.candidate_search import SURROUND
from vaoi_station.model import BoardType
from vaoi_station.stitching.adjustment.problem import Ints
from vaoi_station.stitching.matching.evidence import FrameKey

_AROUND_MM = 0.3
"""Margin around a footprint, mm. Points in it count as on the component, because solder and shadow lie there."""
_MOST_CELLS = 400  # largest number of cells along each axis of the grid
_BORDER_PX = 6.0
"""Least distance of a fiducial's bare rim from the border of a frame: nearer to the border it may not be detected."""


@dataclass(frozen=True, eq=False)
class ComponentIndex:
    """The n components of a board type as arrays, in the order of the board type."""

    addresses: tuple[str, ...]
    center: Floats  # (n, 2) centres of the footprints
    size: Floats  # (n, 2) width and height of the footprints before rotation
    angle_rad: Floats  # (n,) rotation of the footprints
    stands_out: NDArray[np.bool_]
    """(n,) whether the component stands above the board; true too if its height is unknown."""
    mm_per_unit: float
    _wider: dict[float, ComponentIndex] = field(default_factory=dict, repr=False)
    """What `widened` has made, by the margin."""

    @staticmethod
    def of(board_type: BoardType) -> ComponentIndex:
        """Make the index of a board type's components."""
        parts, sign = board_type.components, 1.0 if board_type.y_axis == "up" else -1.0
        return ComponentIndex(
            tuple(p.address for p in parts),
            np.array([p.center for p in parts], dtype=np.float64).reshape(-1, 2),
            np.array([(p.width, p.height) for p in parts], dtype=np.float64).reshape(-1, 2),
            np.radians(np.array([sign * p.rotation for p in parts], dtype=np.float64)),
            np.array([p.body_height is None or p.body_height > 0 for p in parts], dtype=np.bool_),
            board_type.mm_per_unit,
        )

    @property
    def corners(self) -> Floats:
        """Corners (n, 4, 2) of the footprints, going round, in CAD coordinates."""
        (cos, sin), (w, h) = self._turn.T, self.size.T / 2
        along, across = np.stack([cos * w, sin * w], -1), np.stack([-sin * h, cos * h], -1)
        signs = ((-1, -1), (1, -1), (1, 1), (-1, 1))
        return np.stack([self.center + a * along + b * across for a, b in signs], 1)

    def widened(self, by_mm: float) -> ComponentIndex:
        """Return an index of the same components with footprints that are larger by `by_mm` on all sides."""
        # Every board needs the same few, whose search grids take milliseconds with thousands of components.
        if by_mm not in self._wider:
            self._wider[by_mm] = replace(self, size=self.size + 2 * by_mm / self.mm_per_unit, _wider={})
        return self._wider[by_mm]

    def take(self, at: Ints) -> ComponentIndex:
        """Return an index of only the components with the numbers `at`."""
        addresses = tuple(self.addresses[k] for k in at.tolist())
        values = (self.center[at], self.size[at], self.angle_rad[at], self.stands_out[at])
        return ComponentIndex(addresses, *values, self.mm_per_unit)

    def moved(self, moves: Mapping[str, Floats]) -> ComponentIndex:
        """Return an index with some components displaced and turned, by (3, 3) matrices in CAD coordinates."""
        if not moves:
            return self
        center, angle = self.center.copy(), self.angle_rad.copy()
        at = [n for n, address in enumerate(self.addresses) if address in moves]
        if at:
            move = np.array([moves[self.addresses[n]] for n in at])
            center[at] = (move[:, :2, :2] @ center[at, :, None])[:, :, 0] + move[:, :2, 2]
            angle[at] += np.arctan2(move[:, 1, 0], move[:, 0, 0])
        return replace(self, center=center, angle_rad=angle, _wider={})

    def find(self, cad_from_board: Floats, board_mm: Floats) -> Ints:
        """Return for each of k board points (k, 2) the number of the component on which it lies, or −1 for none: (k,).

        If components overlap, the smallest one is returned. Components that do not stand above the board are ignored.
        `cad_from_board` (3, 3) is the inverse of C.
        """
        out = np.full(len(board_mm), -1)
        cells = self._cells
        if len(cells.numbers):
            boxes = _Boxes(self.center, self._turn, self._half)
            _find(np.ascontiguousarray(cad_from_board), np.ascontiguousarray(board_mm), cells, boxes, out)
        return out

    @cached_property
    def _turn(self) -> Floats:
        """Cosine and sine (n, 2) of the footprints' rotations."""
        return np.stack([np.cos(self.angle_rad), np.sin(self.angle_rad)], -1)

    @cached_property
    def _half(self) -> Floats:
        """Half of the width and height (n, 2) of each footprint, margin included."""
        return self.size / 2 + _AROUND_MM / self.mm_per_unit

    @cached_property
    def _cells(self) -> _Cells:
        """The search grid over the components that stand above the board."""
        # Components without height count as bare board, since links on them lie on its surface.
        use = np.flatnonzero(self.stands_out)
        # Small components come first, since the smallest one is returned. Of two with equal area, the later one comes
        # first.
        use = use[np.argsort(-self.size[use].prod(1), kind="stable")[::-1]]
        cos, sin = np.abs(self._turn[use]).T
        w, h = self._half[use].T
        reach = np.stack([cos * w + sin * h, sin * w + cos * h], -1)
        return _Cells.of(use, self.center[use] - reach, self.center[use] + reach)


class _Cells(NamedTuple):
    """A search grid of cells, with the list of boxes that reach into each cell."""

    origin: Floats  # (2,) lowest corner of the grid
    size: Floats  # (2,) width and height of one cell
    first: Ints  # (rows, columns + 1): cell (r, c) holds the boxes `numbers[first[r, c] : first[r, c + 1]]`
    numbers: Ints  # numbers of the boxes, cell by cell; within a cell in the order in which the boxes were given

    @staticmethod
    def of(numbers: Ints, low: Floats, high: Floats) -> _Cells:
        """Build the grid over n boxes with these numbers (n,), lowest corners (n, 2) and highest corners (n, 2)."""
        if not len(numbers):
            return _Cells(np.zeros(2), np.ones(2), np.zeros((1, 2), np.int_), np.zeros(0, np.int_))
        origin, span = low.min(0), high.max(0) - low.min(0)
        # Cells have the size of an average box: a point is then compared with few boxes, and a box lies in few cells.
        size = np.maximum((high - low).mean(0), span / _MOST_CELLS)
        columns, rows = (np.floor(span / size).astype(int) + 1).tolist()
        (x0, y0), (x1, y1) = (np.floor((corner - origin) / size).astype(int).T for corner in (low, high))
        wide, tall = x1 - x0 + 1, y1 - y0 + 1
        box = np.repeat(np.arange(len(numbers)), wide * tall)
        k = np.arange(len(box)) - np.repeat(np.cumsum(wide * tall) - wide * tall, wide * tall)
        cell = (y0[box] + k // wide[box]) * columns + x0[box] + k % wide[box]
        ends = np.append(0, np.cumsum(np.bincount(cell, minlength=rows * columns)))
        first = ends[np.arange(rows)[:, None] * columns + np.arange(columns + 1)]
        # The sort is stable: boxes keep their order within a cell. A search returns the first box that contains the
        # point.
        return _Cells(origin, size, first, numbers[box[np.argsort(cell, kind="stable")]])


class _Boxes(NamedTuple):
    """n rotated rectangles, in CAD coordinates."""

    center: Floats  # (n, 2) centres of the rectangles
    turn: Floats  # (n, 2) cosine and sine of the rectangles' rotations
    half: Floats  # (n, 2) half the width and half the height of the rectangles


@compiled
def _find(cad_from_board: Floats, board_mm: Floats, cells: _Cells, boxes: _Boxes, out: Ints) -> None:
    """Write to `out` (k,) the number of the first box around each point; where there is none, `out` is unchanged."""
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


def frames_of_marks(
    board_type: BoardType, views: FootprintViews, cameras: Sequence[Camera], confirmed: Collection[FrameKey]
) -> dict[int, FrameKey]:
    """Return one frame for each fiducial that a confirmed frame shows with its bare rim, by number of the fiducial."""
    found: dict[int, FrameKey] = {}
    for n, (i, j), px in zip(views.point.tolist(), views.frames, views.px, strict=True):
        reach_px = SURROUND / 2 * board_type.fiducials[n].diameter * board_type.mm_per_unit * cameras[i].px_per_mm
        if (i, j) in confirmed and cameras[i].sees(px[None], reach_px + _BORDER_PX)[0]:
            found.setdefault(n, (i, j))
    return found
