"""Route the copper of a generated board: short traces from pads to vias, and bundles of parallel traces.

A raster of occupied cells prevents crossings of traces. Its cells are coarse, because no measurement depends on the
exact course of a trace.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import cv2
import numpy as np
from numpy.typing import NDArray

from vaoi_station.geometry.transforms import Floats
from vaoi_station.simulation.board.layout import Part, mounting_holes
from vaoi_station.simulation.scenario import BoardSection

_CELLS_PER_MM = 8
_CLEARANCE_MM = 0.22
_DIRECTIONS = np.array([[1, 0], [1, 1], [0, 1], [-1, 1], [-1, 0], [-1, -1], [0, -1], [1, -1]], dtype=np.float64)


@dataclass(frozen=True)
class Copper:
    """The copper of a board: traces as polylines (k, 2), and centres of vias, in board coordinates (mm)."""

    traces: tuple[Floats, ...]
    vias: tuple[tuple[float, float], ...]


def route(section: BoardSection, parts: tuple[Part, ...]) -> Copper:
    """Route the copper of a board wherever there is room."""
    # On boards of equal parts the traces lie in inner layers.
    if section.grid_mm is not None:
        return Copper((), ())
    router = _Router(section)
    for part in parts:
        router.reserve_pads(part)
    for part in parts:
        router.fan_out(part)
    router.route_bundles(round(section.density * section.width_mm * section.length_mm / 400))
    for part in parts:
        router.reserve_body(part)
    router.place_stitching_vias(round(section.density * section.width_mm * section.length_mm / 60))
    return Copper(tuple(router.traces), tuple(router.vias))


class _Router:
    """Routes the copper of one board. It holds the occupied cells, and the traces and vias so far."""

    def __init__(self, section: BoardSection) -> None:
        self.random = np.random.default_rng([section.seed, 7020])
        self.size = np.array([section.width_mm, section.length_mm])
        w, h = (int(s * _CELLS_PER_MM) + 1 for s in self.size)
        self.taken: NDArray[np.uint8] = np.zeros((h, w), np.uint8)
        self.traces: list[Floats] = []
        self.vias: list[tuple[float, float]] = []
        for mark in section.marks:
            self._take_disc((mark.x_mm, mark.y_mm), 1.5 * mark.diameter_mm)
        for hole in mounting_holes(section):
            self._take_disc(hole, 2.6)

    def reserve_pads(self, part: Part) -> None:
        """Mark the cells under the pads of a part as occupied."""
        for u, v, w, h in part.package.pads:
            corners = np.array([[-w, -h], [w, -h], [w, h], [-w, h]]) / 2 + (u, v)
            cv2.fillConvexPoly(self.taken, self._cells(part.to_board(corners)), 1)

    def reserve_body(self, part: Part) -> None:
        """Mark the cells under a part and its printed name as occupied, so that no stitching via lies there."""
        (x, y), (w, h) = part.place, part.half_extent
        box = np.array([[x - w - 1.6, y - h - 1.6], [x + w, y - h - 1.6], [x + w, y + h], [x - w - 1.6, y + h]])
        cv2.fillConvexPoly(self.taken, self._cells(box), 1)

    def fan_out(self, part: Part) -> None:
        """Route traces with bends from the pads of a part to vias. About 15 % of the pads get no trace."""
        for u, v, w, h in part.package.pads:
            if self.random.random() < 0.15:
                continue
            outward = (
                np.array([u, 0.0])
                if abs(u) / part.package.size[0] >= abs(v) / part.package.size[1]
                else np.array([0.0, v])
            )
            if not outward.any():
                outward = np.array([0.0, 1.0])
            start = part.to_board(np.array([u, v]))
            heading = part.to_board(np.array([u, v]) + outward / np.abs(outward).max()) - start
            k = int(np.argmax(_DIRECTIONS / np.linalg.norm(_DIRECTIONS, axis=1, keepdims=True) @ heading))
            # Three attempts limit the computing time. A pad may remain without a trace.
            for _ in range(3):
                lengths = self.random.uniform([0.6, 0.5, 0.5], [3, 4, 9])
                count = int(self.random.integers(1, 4))
                path = _path(start, k, lengths[:count], self.random.choice([-1, 1], 2))
                if self._is_free(path, skip_mm=max(w, h) / 2 + 0.3):
                    self._add_trace(path)
                    break

    def route_bundles(self, count: int) -> None:
        """Route `count` bundles of parallel traces at random positions. Traces that would cross others are omitted."""
        for _ in range(count):
            start, k = self.random.uniform(2, self.size - 2), int(self.random.integers(8))
            lengths, bends = self.random.uniform([3, 1, 3], [14, 6, 14]), self.random.choice([-1, 1], 2)
            side = _DIRECTIONS[(k + 2) % 8] / np.linalg.norm(_DIRECTIONS[k])
            for n in range(int(self.random.integers(3, 9))):
                path = _path(start + n * 0.45 * side, k, lengths, bends)
                if self._is_free(path, 0.0):
                    self._add_trace(path)

    def place_stitching_vias(self, count: int) -> None:
        """Place `count` vias that connect copper areas at random positions. Vias at occupied positions are omitted."""
        for _ in range(count):
            place = self.random.uniform(1, self.size - 1)
            if self._is_free(np.array([place, place + 0.01]), 0.0):
                self.vias.append((float(place[0]), float(place[1])))
                self._take_disc(self.vias[-1], 0.7)

    def _is_free(self, path: Floats, skip_mm: float) -> bool:
        """Return whether a path is on the board and crosses no occupied cell further than `skip_mm` from its start."""
        steps = [np.linspace(a, b, max(int(np.hypot(*(b - a)) * _CELLS_PER_MM * 1.4), 2)) for a, b in pairwise(path)]
        points = np.vstack(steps)
        if (points < 0.8).any() or (points > self.size - 0.8).any():
            return False
        # The start of the path lies on the pad itself, whose cells are marked as occupied.
        points = points[np.hypot(*(points - path[0]).T) >= skip_mm]
        x, y = (points * _CELLS_PER_MM).astype(int).T
        return not self.taken[y, x].any()

    def _add_trace(self, path: Floats) -> None:
        """Add a trace with a via at its end, and mark the cells that they and their clearance occupy."""
        self.traces.append(path)
        width = max(round(2 * _CLEARANCE_MM * _CELLS_PER_MM), 2) + 1
        cv2.polylines(self.taken, [self._cells(path)], False, 1, width)
        self.vias.append((float(path[-1][0]), float(path[-1][1])))
        self._take_disc(self.vias[-1], 0.7)

    def _take_disc(self, place: tuple[float, float], radius_mm: float) -> None:
        middle = self._cells(np.array(place)).tolist()
        cv2.circle(self.taken, middle, int(np.ceil(radius_mm * _CELLS_PER_MM)), 1, -1)

    def _cells(self, places: Floats) -> NDArray[np.int32]:
        return np.asarray(np.round(places * _CELLS_PER_MM - 0.5), np.int32)


def _path(start: Floats, k: int, lengths: Floats, bends: NDArray[np.int64]) -> Floats:
    """Return a polyline (points, 2) of up to three segments that begins in direction k and bends by 45° and back."""
    turns = [k, k + int(bends[0]), k + int(bends[0]) + (int(bends[1]) if bends[0] != bends[1] else -int(bends[0]))]
    points = [start]
    for length, turn in zip(lengths, turns, strict=False):
        d = _DIRECTIONS[turn % 8]
        points.append(points[-1] + length * d / np.linalg.norm(d))
    return np.array(points)
