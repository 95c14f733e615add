"""Components on the stitched board: which link lies on which, and where their centres are in the frames."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from vaoi_station.geometry import Camera, Euclidean
from vaoi_station.geometry.transforms import Floats, apply
from vaoi_station.model import BoardType, Surface
from vaoi_station.stitching.cad import Frame
from vaoi_station.stitching.observations import Ints

_AROUND_MM = 0.3
"""A part's solder and shadow belong to it."""
_MOST_CELLS = 1000
"""Per axis, of the grid that finds points on footprints."""
_BEYOND_PX = 3.0
"""Views are listed until the centre is so far outside the frame."""


def component_of(frame: Frame, c: Floats, board_mm: Floats) -> Ints:
    """Number of the component on whose footprint each board point (k, 2) lies; −1 for none; the smallest wins."""
    board_type = frame.board_type
    cad = apply(np.linalg.inv(frame.matrix(c)), board_mm)
    bodies = [(n, p) for n, p in enumerate(board_type.components) if p.body_height is None or p.body_height > 0]
    out = np.full(len(cad), -1)
    if not bodies or not len(cad):
        return out
    numbers, parts = zip(*sorted(bodies, key=lambda b: -b[1].width * b[1].height), strict=True)
    half = np.array([(p.width, p.height) for p in parts]) / 2 + _AROUND_MM / board_type.mm_per_unit
    middle = np.array([p.center for p in parts])
    a = np.radians([p.rotation if board_type.y_axis == "up" else -p.rotation for p in parts])
    axes = np.stack([np.cos(a), -np.sin(a), np.sin(a), np.cos(a)], -1).reshape(-1, 2, 2)
    reach = (np.abs(axes) @ half[..., None])[..., 0]
    point, part = _near(cad, middle - reach, middle + reach)
    offset = ((cad[point] - middle[part])[:, None] @ axes[part])[:, 0]
    inside = (np.abs(offset) <= half[part]).all(1)
    smallest = out.copy()
    np.maximum.at(smallest, point[inside], part[inside])
    out[smallest >= 0] = np.array(numbers)[smallest[smallest >= 0]]
    return out


def _near(points: Floats, low: Floats, high: Floats) -> tuple[Ints, Ints]:
    """Pairs (point, box) among which are all points (k, 2) inside boxes with corners (n, 2); by cells of a grid.

    Cells are as large as the boxes are on average, so the pairs grow with points and boxes, not with their product.
    """
    cell = np.maximum((high - low).mean(0), np.ptp(points, axis=0) / _MOST_CELLS) + np.finfo(float).tiny
    origin, rows = points.min(0), int(np.floor(np.ptp(points[:, 1]) / cell[1])) + 1
    columns = int(np.floor(np.ptp(points[:, 0]) / cell[0])) + 1
    last = np.array([columns, rows]) - 1
    at = np.minimum(np.floor((points - origin) / cell).astype(int), last)
    first, final = (
        np.clip(np.floor((corner - origin) / cell).astype(int), (-1, -1), last + 1) for corner in (low, high)
    )
    first, final = np.maximum(first, 0), np.minimum(final, last)
    wide, tall = np.maximum(final - first + 1, 0).T
    box = np.repeat(np.arange(len(low)), wide * tall)
    k = np.arange(len(box)) - np.repeat(np.cumsum(wide * tall) - wide * tall, wide * tall)
    cells = (first[box, 1] + k // wide[box]) * columns + first[box, 0] + k % wide[box]
    of_point = at[:, 1] * columns + at[:, 0]
    order = np.argsort(of_point, kind="stable")
    begin, end = (np.searchsorted(of_point[order], cells, side=side) for side in ("left", "right"))
    count = end - begin
    rank = np.arange(count.sum()) - np.repeat(np.cumsum(count) - count, count)
    return order[np.repeat(begin, count) + rank], np.repeat(box, count)


def footprint_views(
    board_type: BoardType,
    cad_matrix: Floats,
    cameras: Sequence[Camera],
    motion: Sequence[Euclidean],
    surface: Surface | None,
) -> dict[str, tuple[tuple[int, int, float, float], ...]]:
    """Raw pixels of the centre of each footprint in every frame that shows it: {address: [(camera, row, x, y)]}."""
    parts = board_type.components
    if not parts:
        return {}
    centers = np.array([p.center for p in parts])
    height = surface.height_mm(centers) if surface else np.zeros(len(parts))
    matrices = np.array([d.matrix for d in motion]) @ cad_matrix
    xs, ys = (np.ascontiguousarray(v) for v in np.moveaxis(np.stack([apply(m, centers) for m in matrices]), -1, 0))
    views: list[list[tuple[int, int, float, float]]] = [[] for _ in parts]
    for i, camera in enumerate(cameras):
        low, high = camera.view_mm(-_BEYOND_PX, (float(height.min()), float(height.max())))
        row, part = np.nonzero((xs >= low[0]) & (xs <= high[0]) & (ys >= low[1]) & (ys <= high[1]))
        px = camera.project(np.column_stack([xs[row, part], ys[row, part]]), height[part])
        seen = camera.sees(px, -_BEYOND_PX)
        rounded = np.round(px[seen], 4).tolist()
        for j, n, (x, y) in zip(row[seen].tolist(), part[seen].tolist(), rounded, strict=True):
            views[n].append((i, j, x, y))
    return {p.address: tuple(v) for p, v in zip(parts, views, strict=True)}
