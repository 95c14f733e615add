"""How much of every component the good frames of a run show: the union of the frames over its footprint.

The footprint lies at the height of the board's surface. It is divided into quarters until each part lies inside one
frame, or outside all frames, or is smaller than 1/128 of the footprint's sides. Most footprints lie wholly in one
frame; for these, a check of the four corners is enough.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from vaoi_station.compiled import compiled, inlined
from vaoi_station.geometry import Camera
from vaoi_station.geometry.projection_kernels import distort_point
from vaoi_station.geometry.transforms import Floats, apply
from vaoi_station.model import Surface
from vaoi_station.stitching.adjustment.observations import Ints
from vaoi_station.stitching.board.component_index import ComponentIndex
from vaoi_station.stitching.matching.evidence import FrameKey

_DEEPEST = 7
"""Largest number of times that a part of a footprint is divided."""
_BORDER_POINTS = 9
"""Points per side of a frame, from which the box that the frame wholly shows is computed."""
_MARGIN = 0.01
"""Margin of the box that a frame wholly shows, as a share of its size; a usable lens bends a border by less."""
_VIEW_SHARE = 0.5
"""Least share of a footprint that a frame must show, for the frame to count as a view."""


@dataclass(frozen=True, eq=False)
class Coverage:
    """How much of each of n components the frames show."""

    share: Floats
    """(n,) share of the footprint's area that the frames show together."""
    views: Ints
    """(n,) number of frames that show at least half of the footprint."""
    in_one_frame: NDArray[np.bool_]
    """(n,) whether one frame shows the whole footprint."""


class _Array(NamedTuple):
    """The poses of c cameras as arrays for compiled functions."""

    image_from_row: Floats
    radial: Floats
    lens: Floats
    viewpoint: Floats
    """(c, 3) foot x and y, mm, and the inverse working distance; 0 for an unknown distance."""
    size_px: Floats
    view_mm: Floats
    """(c, 4) lowest x and y, then highest x and y, of a box around each camera's view, mm in row coordinates."""
    inner_mm: Floats
    """(c, 4) the same numbers for a box that each camera shows wholly; an empty box has lowest values above the
    highest."""


class _Found(NamedTuple):
    """The arrays of a `Coverage` while they are filled, and whether all views are counted."""

    share: Floats
    views: Ints
    in_one_frame: NDArray[np.bool_]
    count_views: bool


def component_coverage(
    parts: ComponentIndex,
    cad_matrix: Floats,
    cameras: Sequence[Camera],
    rows: Floats,
    present: Collection[FrameKey],
    surface: Surface | None,
    *,
    count_views: bool = True,
) -> Coverage:
    """Compute how much of every component the frames show.

    Args:
        parts: the n components.
        cad_matrix: C, (3, 3) from CAD to tester coordinates.
        cameras: the cameras.
        rows: (m, 3, 3) the matrices D_j.
        present: camera and row of the frames to count.
        surface: surface of the board; None for a board in the calibrated plane.
        count_views: whether to count all views. If false, a component that one frame shows wholly may get a lower
            count.
    """
    height = surface.height_mm(parts.center) if surface else np.zeros(len(parts.center))
    there = np.zeros((len(rows), len(cameras)), np.bool_)
    for camera, row in present:
        there[row, camera] = True
    found = _Found(np.zeros(len(height)), np.zeros(len(height), np.int64), np.zeros(len(height), np.bool_), count_views)
    if len(height) and len(rows):
        heights = float(height.min()), float(height.max())
        corners = np.ascontiguousarray(apply(cad_matrix, parts.corners))
        _cover(corners, height, np.ascontiguousarray(rows), there, _array_of(cameras, heights), found)
    return Coverage(found.share, found.views, found.in_one_frame)


def _array_of(cameras: Sequence[Camera], heights_mm: tuple[float, float]) -> _Array:
    # All lenses share one array, so shorter polynomials are filled up with zeros.
    most = max(len(c.lens.coefficients) for c in cameras)
    return _Array(
        np.array([c.image_from_row.matrix for c in cameras]),
        np.array([[*c.lens.coefficients, *[0.0] * (most - len(c.lens.coefficients))] for c in cameras]),
        np.array([c.lens.shape for c in cameras]),
        np.array([(*c.foot_mm, 1 / c.working_distance_mm if c.working_distance_mm else 0.0) for c in cameras]),
        np.array([(c.width_px, c.height_px) for c in cameras], dtype=np.float64),
        np.array([np.concatenate(c.view_mm(0.0, heights_mm)) for c in cameras]),
        np.array([_inner_box(c, heights_mm) for c in cameras]),
    )


def _inner_box(camera: Camera, heights_mm: tuple[float, float]) -> Floats:
    """Return a box that a camera shows wholly: lowest x and y, highest x and y, mm; an empty box if none."""
    t, (right, bottom) = np.linspace(0, 1, _BORDER_POINTS), (camera.width_px - 1, camera.height_px - 1)
    sides = [np.stack([t * right, np.full_like(t, y)], -1) for y in (0, bottom)]
    sides += [np.stack([np.full_like(t, x), t * bottom], -1) for x in (0, right)]
    middle, box = camera.ground(camera.center_px), np.array([-np.inf, -np.inf, np.inf, np.inf])
    for side in sides:
        at = np.concatenate([camera.ground(side, h) for h in heights_mm])
        # Each side of a frame limits the box at the side where it lies: images may be turned or mirrored.
        off = at.mean(0) - middle
        axis = int(np.abs(off).argmax())
        if off[axis] > 0:
            box[axis + 2] = min(box[axis + 2], at[:, axis].min())
        else:
            box[axis] = max(box[axis], at[:, axis].max())
    margin = _MARGIN * (box[2:] - box[:2])
    box += np.concatenate([margin, -margin])
    corners = np.array([(box[a], box[b]) for a in (0, 2) for b in (1, 3)])
    if np.isfinite(box).all() and all(camera.sees(camera.project(corners, h)).all() for h in heights_mm):
        return box
    return np.array([0.0, 0.0, -1.0, -1.0])


@inlined
def _to_pixel(x: float, y: float, height: float, i: int, d: Floats, array: _Array) -> tuple[float, float]:
    """Project a board point at a height to raw pixels of camera i, with the matrix D_j of the row."""
    m, place = array.image_from_row[i], array.viewpoint[i]
    share = height * place[2]
    u = (d[0, 0] * x + d[0, 1] * y + d[0, 2] - share * place[0]) / (1 - share)
    v = (d[1, 0] * x + d[1, 1] * y + d[1, 2] - share * place[1]) / (1 - share)
    w = m[2, 0] * u + m[2, 1] * v + m[2, 2]
    s = array.lens[i]
    a, b = (m[0, 0] * u + m[0, 1] * v + m[0, 2]) / w, (m[1, 0] * u + m[1, 1] * v + m[1, 2]) / w
    return distort_point(a, b, array.radial[i], (s[0], s[1], s[2], s[3], s[4]))


@inlined
def _on_footprint(corners: Floats, u: float, v: float) -> tuple[float, float]:
    """Return the point of a footprint (4, 2) at the shares u and v of its sides."""
    a, b, d = corners[0], corners[1], corners[3]
    return a[0] + u * (b[0] - a[0]) + v * (d[0] - a[0]), a[1] + u * (b[1] - a[1]) + v * (d[1] - a[1])


@compiled
def _relation(corners: Floats, height: float, box: Floats, i: int, d: Floats, array: _Array) -> int:
    """Return 1 if a frame shows a part of a footprint wholly, −1 if it shows none of it, 0 if undecided.

    `box` (4,) holds the lowest u and v of the part, then the highest, as shares of the footprint's sides.
    """
    right, bottom = array.size_px[i, 0] - 1, array.size_px[i, 1] - 1
    inside, left_of, right_of, above, below = 0, 0, 0, 0, 0
    for k in range(4):
        u = box[0] if k in (0, 3) else box[2]
        v = box[1] if k < 2 else box[3]
        x, y = _on_footprint(corners, u, v)
        px, py = _to_pixel(x, y, height, i, d, array)
        left_of += px < 0
        right_of += px > right
        above += py < 0
        below += py > bottom
        inside += px >= 0 and px <= right and py >= 0 and py <= bottom
    if inside == 4:
        return 1
    return -1 if max(left_of, right_of, above, below) == 4 else 0


@compiled
def _share_in_frame(corners: Floats, height: float, i: int, d: Floats, array: _Array) -> float:
    """Return the share of a footprint that a frame shows; the frame's border is taken as straight there."""
    polygon, clipped = np.empty((8, 2)), np.empty((8, 2))
    for k in range(4):
        polygon[k, 0], polygon[k, 1] = _to_pixel(corners[k, 0], corners[k, 1], height, i, d, array)
    count, whole = 4, _area(polygon, 4)
    # The polygon is clipped at one border of the frame after the other (Sutherland and Hodgman).
    for border in range(4):
        axis, sign = border % 2, 1.0 if border < 2 else -1.0
        limit = 0.0 if border < 2 else 1.0 - array.size_px[i, axis]
        found = 0
        for k in range(count):
            a, b = polygon[k], polygon[(k + 1) % count]
            u, v = sign * a[axis] - limit, sign * b[axis] - limit
            if u >= 0:
                clipped[found, 0], clipped[found, 1] = a[0], a[1]
                found += 1
            if (u >= 0) != (v >= 0):
                for c in range(2):
                    clipped[found, c] = a[c] + (u / (u - v)) * (b[c] - a[c])
                found += 1
        count = found
        for k in range(count):
            polygon[k, 0], polygon[k, 1] = clipped[k, 0], clipped[k, 1]
    return _area(polygon, count) / whole


@inlined
def _area(polygon: Floats, count: int) -> float:
    total = 0.0
    for k in range(count):
        a, b = polygon[k], polygon[(k + 1) % count]
        total += a[0] * b[1] - b[0] * a[1]
    return abs(total) / 2


@compiled
def _share_of_union(corners: Floats, height: float, near: Ints, rows: Floats, array: _Array) -> float:
    """Return the share of a footprint that several frames show together; `near` (f, 2) holds camera and row of each."""
    # Parts that are still to be examined lie on a stack as (lowest u, lowest v, side, depth); a division adds three.
    stack = np.empty((3 * _DEEPEST + 4, 4))
    stack[0, 0], stack[0, 1], stack[0, 2], stack[0, 3] = 0.0, 0.0, 1.0, 0.0
    waiting, share, box = 1, 0.0, np.empty(4)
    while waiting:
        waiting -= 1
        u, v, side, depth = stack[waiting, 0], stack[waiting, 1], stack[waiting, 2], stack[waiting, 3]
        box[0], box[1], box[2], box[3] = u, v, u + side, v + side
        covered, touched = False, False
        for f in range(len(near)):
            relation = _relation(corners, height, box, near[f, 0], rows[near[f, 1]], array)
            covered |= relation > 0
            touched |= relation == 0
            if covered:
                break
        if covered:
            share += side * side
        elif touched and depth < _DEEPEST:
            half = side / 2
            for k in range(4):
                stack[waiting + k, 0], stack[waiting + k, 1] = u + half * (k % 2), v + half * (k // 2)
                stack[waiting + k, 2], stack[waiting + k, 3] = half, depth + 1
            waiting += 4
        elif touched:
            # At the border of the frames, the middle of a smallest part decides whether the part is seen.
            box[0] = box[2] = u + side / 2
            box[1] = box[3] = v + side / 2
            for f in range(len(near)):
                if _relation(corners, height, box, near[f, 0], rows[near[f, 1]], array) > 0:
                    share += side * side
                    break
    return share


@compiled
def _cover(
    corners: Floats, height: Floats, rows: Floats, there: NDArray[np.bool_], array: _Array, found: _Found
) -> None:
    """Compute how much of each of n footprints the frames show, and write the values to `found`.

    Args:
        corners: (n, 4, 2) corners of the footprints, mm, tester coordinates.
        height: (n,) height of the board's surface at the footprints, mm.
        rows: (m, 3, 3) the matrices D_j.
        there: (m, c) which frames count, by row and camera.
        array: the cameras.
        found: written.
    """
    view = array.view_mm
    unit = np.array([0.0, 0.0, 1.0, 1.0])
    outer = np.array([np.inf, np.inf, -np.inf, -np.inf])
    for i in range(len(view)):
        for k in range(2):
            outer[k], outer[2 + k] = min(outer[k], view[i, k]), max(outer[2 + k], view[i, 2 + k])
    near = np.empty((there.size, 2), np.int64)
    for n in range(len(corners)):
        part, whole, views = corners[n], 0, 0
        border = 0
        for k in range(_frames_near(part, rows, there, array, outer, near)):
            i, j = near[k, 0], near[k, 1]
            if i >= 0:
                near[border, 0], near[border, 1] = i, j
                border += 1
                continue
            whole += 1
        if found.count_views or not whole:
            partly = 0
            for k in range(border):
                i, j = near[k, 0], near[k, 1]
                relation = _relation(part, height[n], unit, i, rows[j], array)
                whole += relation > 0
                if relation == 0:
                    near[partly, 0], near[partly, 1] = i, j
                    partly += 1
                    views += _share_in_frame(part, height[n], i, rows[j], array) >= _VIEW_SHARE
            if not whole and partly:
                found.share[n] = _share_of_union(part, height[n], near[:partly], rows, array)
        found.views[n] = views + whole
        if whole:
            found.share[n], found.in_one_frame[n] = 1.0, True


@compiled
def _frames_near(part: Floats, rows: Floats, there: NDArray[np.bool_], array: _Array, outer: Floats, near: Ints) -> int:
    """Write to `near` the frames that may show a footprint, and return their number.

    A frame is written as camera and row, or as −1 and −1 if it surely shows the whole footprint.
    """
    view, inner = array.view_mm, array.inner_mm
    x, y = (part[0, 0] + part[2, 0]) / 2, (part[0, 1] + part[2, 1]) / 2
    ax, ay = part[0, 0] - part[1, 0], part[0, 1] - part[1, 1]
    bx, by = part[0, 0] - part[3, 0], part[0, 1] - part[3, 1]
    reach = (np.hypot(ax, ay) + np.hypot(bx, by)) / 2
    count = 0
    for j in range(len(rows)):
        d = rows[j]
        a, b = d[0, 0] * x + d[0, 1] * y + d[0, 2], d[1, 0] * x + d[1, 1] * y + d[1, 2]
        # In most rows no camera sees a given component: one comparison rules these rows out.
        if a + reach < outer[0] or a - reach > outer[2] or b + reach < outer[1] or b - reach > outer[3]:
            continue
        # half the extent of the footprint along the axes of row coordinates
        w = (abs(d[0, 0] * ax + d[0, 1] * ay) + abs(d[0, 0] * bx + d[0, 1] * by)) / 2
        v = (abs(d[1, 0] * ax + d[1, 1] * ay) + abs(d[1, 0] * bx + d[1, 1] * by)) / 2
        for i in range(there.shape[1]):
            if not there[j, i] or a + w < view[i, 0] or a - w > view[i, 2]:
                continue
            if b + v < view[i, 1] or b - v > view[i, 3]:
                continue
            near[count, 0], near[count, 1] = i, j
            if a - w >= inner[i, 0] and a + w <= inner[i, 2] and b - v >= inner[i, 1] and b + v <= inner[i, 3]:
                near[count, 0] = near[count, 1] = -1
            count += 1
    return count
