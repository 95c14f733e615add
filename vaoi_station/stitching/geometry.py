"""Where components lie on the board, and which frames show a point, a line or a region of it, and how.

`ComponentIndex` finds the component under a point; its lengths are in CAD units, its angles refer to the CAD axes of
the board type. `FrameIndex` answers all questions about frames: the views of points, the frame that shows a place best,
its pixels there, and how much of every footprint the frames show together.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from vaoi_station.compiled import compiled, inlined
from vaoi_station.geometry import Camera
from vaoi_station.geometry.projection_kernels import distort_point
from vaoi_station.geometry.transforms import Floats, apply
from vaoi_station.marks.candidate_search import SURROUND
from vaoi_station.model import BoardType, Surface
from vaoi_station.stitching.adjustment.problem import Ints
from vaoi_station.stitching.matching.evidence import FrameKey
from vaoi_station.stitching.matching.frames import Scene

_AROUND_MM = 0.3
"""Margin around a footprint, mm. Points in it count as on the component, because solder and shadow lie there."""
_MOST_CELLS = 400  # largest number of cells along each axis of the grid


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
        return replace(self, size=self.size + 2 * by_mm / self.mm_per_unit)

    def take(self, at: Ints) -> ComponentIndex:
        """Return an index of only the components with the numbers `at`."""
        addresses = tuple(self.addresses[k] for k in at.tolist())
        values = (self.center[at], self.size[at], self.angle_rad[at], self.stands_out[at])
        return ComponentIndex(addresses, *values, self.mm_per_unit)

    def moved(self, moves: Mapping[str, Floats]) -> ComponentIndex:
        """Return an index with some components displaced and turned, by (3, 3) matrices in CAD coordinates."""
        center, angle = self.center.copy(), self.angle_rad.copy()
        at = [n for n, address in enumerate(self.addresses) if address in moves]
        if at:
            move = np.array([moves[self.addresses[n]] for n in at])
            center[at] = (move[:, :2, :2] @ center[at, :, None])[:, :, 0] + move[:, :2, 2]
            angle[at] += np.arctan2(move[:, 1, 0], move[:, 0, 0])
        return replace(self, center=center, angle_rad=angle)

    def find(self, cad_from_board: Floats, board_mm: Floats) -> Ints:
        """Return for each of k board points the number of the component on which it lies, or −1 for none: (k,).

        If components overlap, the smallest one is returned. Components that do not stand above the board are ignored.

        Args:
            cad_from_board: (3, 3) affine matrix, the inverse of C.
            board_mm: (k, 2) points on the board, tester coordinates.
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


_BEYOND_PX = 3.0  # a footprint's centre up to this far outside a frame still counts as a view
_BORDER_PX = 6.0
"""Least distance of a fiducial's bare rim from the border of a frame: nearer to the border it may not be detected."""
_MARGIN_MM = 1.0  # least distance of a point from the border of its best frame
_FAINT = 1 / 3
"""A frame whose grey levels scatter less than this share of those of another frame is exposed too short or too long."""
_DEEPEST, _DEEPEST_VIEW = 7, 4
"""Number of times that a footprint is divided into quarters at its border: for its share, and to count its views."""
_VIEW_SHARE = 0.5  # least share of a footprint that a frame must show, for the frame to count as a view

View = tuple[int, int, float, float]  # one view of a point: camera, row, and raw pixels x and y


@dataclass(frozen=True, eq=False)
class FootprintViews:
    """k views of points of the board, ordered by point, then by camera, then by row."""

    point: Ints  # (k,) number of the point that each view shows
    camera: Ints
    row: Ints
    place_mm: Floats
    """(k, 2) position of the point in the conveyor's plane, mm in row coordinates, in the row of the view."""
    px: Floats  # (k, 2) raw pixels. Some lie a little outside the frame

    @property
    def frames(self) -> list[FrameKey]:
        """Camera and row of each of the k views."""
        return list(zip(self.camera.tolist(), self.row.tolist(), strict=True))

    def without_rows(self, rows: Sequence[int]) -> FootprintViews:
        """Return the views in all rows except the given ones."""
        return self._where(~np.isin(self.row, rows)) if rows else self

    def without_frames(self, frames: Collection[FrameKey]) -> FootprintViews:
        """Return the views in all frames except the given ones."""
        return self._where(np.array([key not in frames for key in self.frames], np.bool_)) if frames else self

    def without_points(self, points: Sequence[int]) -> FootprintViews:
        """Return the views of all points except the given ones."""
        return self._where(~np.isin(self.point, points)) if points else self

    def _where(self, keep: NDArray[np.bool_]) -> FootprintViews:
        return FootprintViews(self.point[keep], self.camera[keep], self.row[keep], self.place_mm[keep], self.px[keep])

    def by_address(self, addresses: Sequence[str]) -> dict[str, tuple[View, ...]]:
        """Return the views by the address of each point: {address: ((camera, row, x, y), …)}, rounded raw pixels."""
        x, y = np.round(self.px, 4).T.tolist()
        every = list(zip(self.camera.tolist(), self.row.tolist(), x, y, strict=True))
        ends = [0, *np.cumsum(np.bincount(self.point, minlength=len(addresses))).tolist()]
        return {address: tuple(every[a:b]) for address, (a, b) in zip(addresses, pairwise(ends), strict=True)}


@dataclass(frozen=True, eq=False)
class Coverage:
    """How much of each of n components the frames show."""

    share: Floats  # (n,) share of the footprint's area that the frames show together
    views: Ints  # (n,) number of frames that show at least half of the footprint
    in_one_frame: NDArray[np.bool_]  # (n,) whether one frame shows the whole footprint


@dataclass(frozen=True, eq=False)
class FrameIndex:
    """The frames of a run, with their poses above the board: cameras N_i, rows D_j, and the board's surface."""

    cameras: Sequence[Camera]
    rows: Floats  # (m, 3, 3) the matrices D_j of all rows
    present: Sequence[FrameKey] = ()
    """Camera and row of the frames that count; `views` gives those of all cameras and rows."""
    surface: Surface | None = None  # surface of the board; None for a board in the calibrated plane
    scene: Scene | None = None  # the pixels of the frames, for those questions that read them

    @staticmethod
    def of(scene: Scene, rows: Floats) -> FrameIndex:
        """Make the index of a scene whose rows have the matrices D_j (m, 3, 3), for a board in the calibrated plane."""
        return FrameIndex(scene.cameras, rows, scene.present, None, scene)

    def views(self, cad: Floats, cad_matrix: Floats) -> FootprintViews:
        """Return the views of points (n, 2) in CAD coordinates in the frames of all rows; `cad_matrix` is C (3, 3)."""
        height = self.surface.height_mm(cad) if self.surface else np.zeros(len(cad))
        # First, one box around all cameras' views is tested: in most rows no camera sees a given point.
        between = float(height.min(initial=0.0)), float(height.max(initial=0.0))
        boxes = np.array([camera.view_mm(-_BEYOND_PX, between) for camera in self.cameras])
        row, point, place = points_in_box(self.rows, apply(cad_matrix, cad), boxes[:, 0].min(0), boxes[:, 1].max(0))
        found = []
        for i, (camera, (low, high)) in enumerate(zip(self.cameras, boxes, strict=True)):
            near = np.flatnonzero(((place >= low) & (place <= high)).all(1))
            px = camera.project(place[near], height[point[near]])
            seen = camera.sees(px, -_BEYOND_PX)
            at = near[seen]
            found.append((point[at], np.full(len(at), i), row[at], place[at], px[seen]))
        point, *others = (np.concatenate(of_cameras) for of_cameras in zip(*found, strict=True))
        # Views were found camera by camera; the stable sort orders them by point and keeps cameras and rows.
        order = np.argsort(point, kind="stable")
        return FootprintViews(point[order], *(values[order] for values in others))

    def coverage(self, parts: ComponentIndex, cad_matrix: Floats, *, count_views: bool = True) -> Coverage:
        """Compute how much of every component the frames show; without `count_views`, a count may be too low.

        The footprint lies at the height of the board's surface. It is divided into quarters until each part lies inside
        one frame, or outside all frames, or is smaller than 1/128 of the footprint's sides.
        """
        n = len(parts.center)
        height = self.surface.height_mm(parts.center) if self.surface else np.zeros(n)
        there = np.zeros((len(self.rows), len(self.cameras)), np.bool_)
        for camera, row in self.present:
            there[row, camera] = True
        coverage = Coverage(np.zeros(n), np.zeros(n, np.int64), np.zeros(n, np.bool_))
        if n and len(self.rows):
            corners = np.ascontiguousarray(apply(cad_matrix, parts.corners))
            poses = _poses_of(self.cameras, self.rows, (float(height.min()), float(height.max())))
            seen = _Seen(coverage.share, coverage.views, coverage.in_one_frame)
            _cover(corners, height, there, poses, count_views, seen)
        return coverage

    def nearest(self, board_mm: Floats) -> Ints:
        """Return for each board point (k, 2) the number of the frame that shows it nearest to its centre; −1: none.

        A frame that is almost black or saturated everywhere shows no edges: it is taken for points that no other frame
        shows. A program may give every row and camera its own exposure.
        """
        assert self.scene is not None
        points, frame = np.ascontiguousarray(board_mm), self._frame
        faint, contrast = np.zeros(len(frame), np.bool_), dict[int, float]()
        chosen = first = _nearest(points, frame, self._poses, faint)
        # Only the contrast of frames that are chosen is computed: their pixels are read next in any case.
        while new := set(np.unique(chosen[chosen >= 0]).tolist()) - set(contrast):
            contrast |= {n: self.scene.prepared(self.present[n]).contrast for n in new}
            least = _FAINT * max(contrast.values())
            faint[[n for n, found in contrast.items() if found < least]] = True
            better = _nearest(points, frame, self._poses, faint) if faint.any() else first
            chosen = np.where(better >= 0, better, first)
        return chosen

    def project(self, number: Ints, board_mm: Floats) -> Floats:
        """Project board points (k, s, 2) to raw pixels, s each to the frames numbered `number` (k,); NaN for −1."""
        return _projected(np.ascontiguousarray(board_mm), number, self._frame, self._poses)

    def grey(self, number: Ints, px: Floats) -> Floats:
        """Read grey levels at raw pixels (k, s, 2) of the frames numbered `number` (k,), bilinearly: (k, s).

        They are NaN outside the frame, and where the number is −1.
        """
        return self.read_samples(number, px.shape[1], lambda image, mine: _bilinear(image, px[mine]))

    def read_samples(self, number: Ints, samples: int, read: Callable[[NDArray[np.uint8], Ints], Floats]) -> Floats:
        """Read s grey levels at each of k places, from the frames numbered `number` (k,): (k, samples); NaN for −1.

        `read` takes the pixels of a frame and the indices (j,) of its places, and returns their samples (j, samples).
        """
        assert self.scene is not None
        # The loop goes frame by frame, so that each frame is fetched and prepared only once.
        out = np.full((len(number), samples), np.nan)
        for n in np.unique(number[number >= 0]).tolist():
            mine = np.flatnonzero(number == n)
            out[mine] = read(self.scene.prepared(self.present[n]).grey, mine)
        return out

    @cached_property
    def _frame(self) -> Ints:
        return np.array(self.present, dtype=np.int_).reshape(-1, 2)

    @cached_property
    def _poses(self) -> _Poses:
        return _poses_of(self.cameras, self.rows, (0.0, 0.0))


@compiled
def points_in_box(rows: Floats, board_mm: Floats, low: Floats, high: Floats) -> tuple[Ints, Ints, Floats]:
    """Find in which rows which points of the board lie inside a box on the conveyor's plane.

    Args:
        board_mm: (k, 2) points of the board in tester coordinates.
        low: (2,) the corner of the box with the smallest x and y, in row coordinates.
        high: (2,) the corner with the largest x and y.

    Returns:
        For each of v hits, row by row: the row (v,), the index of the point (v,), its row coordinates (v, 2).
    """
    most = len(rows) * len(board_mm)
    row, point, place = np.empty(most, np.int64), np.empty(most, np.int64), np.empty((most, 2))
    count = 0
    for j in range(len(rows)):
        d = rows[j]
        for n in range(len(board_mm)):
            x = d[0, 0] * board_mm[n, 0] + d[0, 1] * board_mm[n, 1] + d[0, 2]
            y = d[1, 0] * board_mm[n, 0] + d[1, 1] * board_mm[n, 1] + d[1, 2]
            if low[0] <= x <= high[0] and low[1] <= y <= high[1]:
                row[count], point[count], place[count, 0], place[count, 1] = j, n, x, y
                count += 1
    return row[:count].copy(), point[:count].copy(), place[:count].copy()


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


class _Poses(NamedTuple):
    """The poses of c cameras in m rows, in the form that compiled functions take."""

    rows: Floats  # (m, 3, 3) the matrices D_j
    image_from_row: Floats
    radial: Floats  # (c, r) radial coefficients of the lenses; shorter polynomials are filled up with zeros
    lens: Floats  # (c, 5) other parameters of each lens, in the form of `geometry.projection_kernels`
    viewpoint: Floats  # (c, 3) foot x and y, mm, and the inverse working distance; 0 for an unknown distance
    size_px: Floats  # (c, 3) width and height of each camera's frame, and the margin at its border
    view_mm: Floats
    """(c, 4) lowest x and y, then highest x and y, of a box around each camera's view, mm in row coordinates."""


class _Seen(NamedTuple):
    """The arrays of a `Coverage` while they are filled."""

    share: Floats
    views: Ints
    in_one_frame: NDArray[np.bool_]


def _poses_of(cameras: Sequence[Camera], rows: Floats, heights_mm: tuple[float, float]) -> _Poses:
    most = max(len(c.lens.coefficients) for c in cameras)
    return _Poses(
        np.ascontiguousarray(rows),
        np.array([c.image_from_row.matrix for c in cameras]),
        np.array([np.pad(c.lens.coefficients, (0, most - len(c.lens.coefficients))) for c in cameras]),
        np.array([c.lens.shape for c in cameras]),
        np.array([(*c.foot_mm, 1 / c.working_distance_mm if c.working_distance_mm else 0.0) for c in cameras]),
        np.array([(c.width_px, c.height_px, _MARGIN_MM * c.px_per_mm) for c in cameras], dtype=np.float64),
        np.array([np.concatenate(c.view_mm(0.0, heights_mm)) for c in cameras]),
    )


@inlined
def _to_pixel(x: float, y: float, height: float, i: int, j: int, poses: _Poses) -> tuple[float, float]:
    """Project a board point at a height to raw pixels of camera i in row j."""
    m, d, place, s = poses.image_from_row[i], poses.rows[j], poses.viewpoint[i], poses.lens[i]
    share = height * place[2]
    u = (d[0, 0] * x + d[0, 1] * y + d[0, 2] - share * place[0]) / (1 - share)
    v = (d[1, 0] * x + d[1, 1] * y + d[1, 2] - share * place[1]) / (1 - share)
    w = m[2, 0] * u + m[2, 1] * v + m[2, 2]
    a, b = (m[0, 0] * u + m[0, 1] * v + m[0, 2]) / w, (m[1, 0] * u + m[1, 1] * v + m[1, 2]) / w
    return distort_point(a, b, poses.radial[i], (s[0], s[1], s[2], s[3], s[4]))


@compiled
def _nearest(board_mm: Floats, frame: Ints, poses: _Poses, faint: NDArray[np.bool_]) -> Ints:
    chosen = np.full(len(board_mm), -1)
    for k in range(len(board_mm)):
        best = np.inf
        for n in range(len(frame)):
            if faint[n]:
                continue
            i, d, view = frame[n, 0], poses.rows[frame[n, 1]], poses.view_mm[frame[n, 0]]
            x = d[0, 0] * board_mm[k, 0] + d[0, 1] * board_mm[k, 1] + d[0, 2]
            y = d[1, 0] * board_mm[k, 0] + d[1, 1] * board_mm[k, 1] + d[1, 2]
            # The comparison in mm is cheap and rules out most frames before projection and lens are computed.
            if not (view[0] <= x <= view[2] and view[1] <= y <= view[3]):
                continue
            last_x, last_y, margin = poses.size_px[i, 0] - 1, poses.size_px[i, 1] - 1, poses.size_px[i, 2]
            u, v = _to_pixel(board_mm[k, 0], board_mm[k, 1], 0.0, i, frame[n, 1], poses)
            if min(u, v) < margin or u > last_x - margin or v > last_y - margin:
                continue
            off = (u - last_x / 2) ** 2 + (v - last_y / 2) ** 2
            if off < best:
                best, chosen[k] = off, n
    return chosen


@compiled
def _projected(board_mm: Floats, number: Ints, frame: Ints, poses: _Poses) -> Floats:
    out = np.full(board_mm.shape, np.nan)
    for k in range(len(board_mm)):
        if number[k] >= 0:
            i, j = frame[number[k], 0], frame[number[k], 1]
            for s in range(board_mm.shape[1]):
                out[k, s, 0], out[k, s, 1] = _to_pixel(board_mm[k, s, 0], board_mm[k, s, 1], 0.0, i, j, poses)
    return out


@compiled
def _relation(corners: Floats, height: float, box: Floats, i: int, j: int, poses: _Poses) -> int:
    """Return 1 if a frame shows a part of a footprint (4, 2) wholly, −1 if it shows none of it, 0 if undecided.

    `box` (4,) holds the lowest u and v of the part, then the highest, as shares of the footprint's sides.
    """
    right, bottom = poses.size_px[i, 0] - 1, poses.size_px[i, 1] - 1
    a, b, d = corners[0], corners[1], corners[3]
    inside, left_of, right_of, above, below = 0, 0, 0, 0, 0
    for k in range(4):
        u = box[0] if k in (0, 3) else box[2]
        v = box[1] if k < 2 else box[3]
        x, y = a[0] + u * (b[0] - a[0]) + v * (d[0] - a[0]), a[1] + u * (b[1] - a[1]) + v * (d[1] - a[1])
        px, py = _to_pixel(x, y, height, i, j, poses)
        left_of += px < 0
        right_of += px > right
        above += py < 0
        below += py > bottom
        inside += px >= 0 and px <= right and py >= 0 and py <= bottom
    if inside == 4:
        return 1
    return -1 if max(left_of, right_of, above, below) == 4 else 0


@compiled
def _share_of_union(corners: Floats, height: float, near: Ints, poses: _Poses, deepest: int) -> float:
    """Return the share of a footprint that several frames show together; `near` (f, 2) holds camera and row of each."""
    # Parts that are still to be examined lie on a stack as (lowest u, lowest v, side, depth); a division adds three.
    stack = np.empty((3 * deepest + 4, 4))
    stack[0, 0], stack[0, 1], stack[0, 2], stack[0, 3] = 0.0, 0.0, 1.0, 0.0
    waiting, share, box = 1, 0.0, np.empty(4)
    while waiting:
        waiting -= 1
        u, v, side, depth = stack[waiting, 0], stack[waiting, 1], stack[waiting, 2], stack[waiting, 3]
        box[0], box[1], box[2], box[3] = u, v, u + side, v + side
        if depth == deepest:
            # At the border of the frames, the middle of a smallest part decides whether the part is seen.
            box[0] = box[2] = u + side / 2
            box[1] = box[3] = v + side / 2
        covered, touched = False, False
        for f in range(len(near)):
            relation = _relation(corners, height, box, near[f, 0], near[f, 1], poses)
            covered |= relation > 0
            touched |= relation == 0
            if covered:
                break
        if covered:
            share += side * side
        elif touched and depth < deepest:
            half = side / 2
            for k in range(4):
                stack[waiting + k, 0], stack[waiting + k, 1] = u + half * (k % 2), v + half * (k // 2)
                stack[waiting + k, 2], stack[waiting + k, 3] = half, depth + 1
            waiting += 4
    return share


@compiled
def _cover(
    corners: Floats, height: Floats, there: NDArray[np.bool_], poses: _Poses, count_views: bool, seen: _Seen
) -> None:
    """Compute how much of each of n footprints the frames show, and write the values to `seen`.

    `corners` (n, 4, 2) and `height` (n,) are those of the footprints, mm; `there` (m, c) says which frames count.
    """
    view, unit = poses.view_mm, np.array([0.0, 0.0, 1.0, 1.0])
    outer = np.array([view[:, 0].min(), view[:, 1].min(), view[:, 2].max(), view[:, 3].max()])
    near = np.empty((there.size, 2), np.int64)
    for n in range(len(corners)):
        part, whole, border = corners[n], 0, 0
        x, y = (part[0, 0] + part[2, 0]) / 2, (part[0, 1] + part[2, 1]) / 2
        reach = math.hypot(part[0, 0] - part[2, 0], part[0, 1] - part[2, 1]) / 2
        for j in range(len(poses.rows)):
            d = poses.rows[j]
            a, b = d[0, 0] * x + d[0, 1] * y + d[0, 2], d[1, 0] * x + d[1, 1] * y + d[1, 2]
            # In most rows no camera sees a given component: one comparison rules these rows out.
            if a + reach < outer[0] or a - reach > outer[2] or b + reach < outer[1] or b - reach > outer[3]:
                continue
            for i in range(there.shape[1]):
                if not there[j, i] or a + reach < view[i, 0] or a - reach > view[i, 2]:
                    continue
                if b + reach < view[i, 1] or b - reach > view[i, 3]:
                    continue
                relation = _relation(part, height[n], unit, i, j, poses)
                whole += relation > 0
                if relation == 0:
                    near[border, 0], near[border, 1] = i, j
                    border += 1
            if whole and not count_views:
                break
        seen.views[n] = whole
        if whole:
            seen.share[n], seen.in_one_frame[n] = 1.0, True
        elif border:
            seen.share[n] = _share_of_union(part, height[n], near[:border], poses, _DEEPEST)
        if count_views:
            for k in range(border):
                shown = _share_of_union(part, height[n], near[k : k + 1], poses, _DEEPEST_VIEW)
                seen.views[n] += shown >= _VIEW_SHARE


@compiled
def _bilinear(image: NDArray[np.uint8], px: Floats) -> Floats:
    """Interpolate the grey levels (k, s) at pixels (k, s, 2) of an image; NaN outside of it."""
    h, w = image.shape
    out = np.empty(px.shape[:2])
    for k in range(len(px)):
        for s in range(px.shape[1]):
            x, y = px[k, s, 0], px[k, s, 1]
            if not (0 <= x <= w - 1 and 0 <= y <= h - 1):
                out[k, s] = np.nan
                continue
            j, i = min(int(x), w - 2), min(int(y), h - 2)
            u, v = x - j, y - i
            above = image[i, j] * (1 - u) + image[i, j + 1] * u
            below = image[i + 1, j] * (1 - u) + image[i + 1, j + 1] * u
            out[k, s] = above * (1 - v) + below * v
    return out
