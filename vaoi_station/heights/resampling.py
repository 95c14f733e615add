"""Compiled resampling of the frames of one component on a plane at a height, and the blur of the pictures."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from vaoi_station.compiled import compiled, inlined
from vaoi_station.geometry import Camera
from vaoi_station.geometry.projection_kernels import distort_point
from vaoi_station.geometry.transforms import Floats

Ints = NDArray[np.int_]
BLUR_PX = 1.1
"""Blur of the pictures before they are compared.

Interpolation between pixels removes noise, most of all half-way between two pixels. Without blur, heights at which the
pictures lie half-way would seem to fit best."""
BLUR_REACH_PX = 5
"""Distance beyond which a pixel has no influence through the blur."""
_MESH_PX = 12
"""Distance of the nodes at which positions in a frame are computed exactly. Between them they are interpolated."""
_STEPS = 1024
"""Number of fractions of a pixel with weights. The nearest one is used: values are displaced by at most 0.0005 px."""
_LEFT, _RIGHT = 3, 5
"""Pixels beside the positions of the nodes that are cut out: one more than the kernel reaches on each side.

Interpolated positions are rounded."""


class Cameras(NamedTuple):
    """The cameras of a run as compiled functions take them."""

    image_from_row: Floats
    """(cameras, 3, 3) N_i."""
    viewpoint: Floats
    """(cameras, 3) foot, mm, and inverse working distance, 1/mm."""
    radial: Floats
    """(cameras, coefficients) of the lenses' distortion; 0 where a lens has fewer."""
    lens: Floats
    """(cameras, 5) `Lens.shape`."""


class Cuts(NamedTuple):
    """What k frames show of one component, cut out of them, and the way there from its grid."""

    grey: NDArray[np.float32]
    """The cut-out parts, line by line, one after the other."""
    place: Ints
    """(k, 5) first pixel in `grey`; first column and row in the frame; columns and rows of the part."""
    camera: Ints
    """(k,)."""
    row_from_grid: Floats
    """(k, 2, 3) affine maps."""
    surface_mm: float
    """Height of the board's surface above the calibrated plane."""
    reduction: float
    """Pixels of the frame's copy per pixel of the frame, along a line."""


def camera_arrays(cameras: Sequence[Camera]) -> Cameras:
    """Return cameras as compiled functions take them."""
    radial = np.zeros((len(cameras), max(len(c.lens.coefficients) for c in cameras)))
    for n, camera in enumerate(cameras):
        radial[n, : len(camera.lens.coefficients)] = camera.lens.coefficients
    return Cameras(
        np.array([c.image_from_row.matrix for c in cameras]),
        np.array([c.viewpoint for c in cameras]),
        radial,
        np.array([c.lens.shape for c in cameras]),
    )


def _table() -> NDArray[np.float32]:
    """Compute the weights (1025, 6) of Lanczos' kernel of three lobes at fractions of a pixel; their sums are 1."""
    x = np.arange(-2, 4)[None] - np.arange(_STEPS + 1)[:, None] / _STEPS
    weights = np.sinc(x) * np.sinc(x / 3) * (np.abs(x) < 3)
    return np.asarray(weights / weights.sum(1, keepdims=True), np.float32)


def _bell() -> NDArray[np.float32]:
    """Compute the weights (6,) of the blur, from the middle outwards; the sum over both sides is 1."""
    weights = np.exp(-(np.arange(BLUR_REACH_PX + 1) ** 2) / (2 * BLUR_PX**2))
    return np.asarray(weights / (2 * weights.sum() - 1), np.float32)


_TABLE, _BELL = _table(), _bell()


@compiled
def surface_boxes(width: int, height: int, feet_px: Floats, distance_mm: Floats, ends_mm: tuple[float, float]) -> Ints:
    """Compute which box (k, 4) of each picture on the board's surface shows a grid at all heights between two."""
    boxes = np.empty((len(feet_px), 4), np.int64)
    for k in range(len(feet_px)):
        for axis in range(2):
            low, high, last = 1e9, -1e9, (width, height)[axis] - 1.0
            for mm in ends_mm:
                share = mm / distance_mm[k]
                for at in (0.0, last):
                    place = (at - share * feet_px[k, axis]) / (1 - share)
                    low, high = min(low, place), max(high, place)
            boxes[k, axis] = int(np.floor(low)) - BLUR_REACH_PX
            boxes[k, 2 + axis] = int(np.ceil(high)) + 2 + BLUR_REACH_PX
    return boxes


@compiled
def place_cuts(cameras: Cameras, cuts: Cuts, boxes: Ints, size: Ints) -> int:
    """Write to `cuts.place` which part of each frame shows a box of the grid; return the number of pixels of all.

    Args:
        cameras: the cameras.
        cuts: the cuts, still without pixels.
        boxes: (k, 4) first column, first row, and those after the last ones, on the board's surface.
        size: (k, 2) columns and rows of the frames' copies.
    """
    total = 0
    for k in range(len(boxes)):
        nodes = _nodes(cameras, cuts, k, boxes[k], 0.0)
        low_x = low_y = 1e9
        high_x = high_y = -1e9
        for a in range(nodes.shape[0]):
            for b in range(nodes.shape[1]):
                x, y = nodes[a, b, 0], nodes[a, b, 1]
                # comparisons, which leave out NaN
                low_x, high_x = (x if x < low_x else low_x), (x if x > high_x else high_x)
                low_y, high_y = (y if y < low_y else low_y), (y if y > high_y else high_y)
        x0, y0 = int(min(max(low_x - _LEFT, 0.0), size[k, 0])), int(min(max(low_y - _LEFT, 0.0), size[k, 1]))
        columns = int(min(max(high_x + _RIGHT, x0), size[k, 0])) - x0
        rows = int(min(max(high_y + _RIGHT, y0), size[k, 1])) - y0
        cuts.place[k, 0], cuts.place[k, 1], cuts.place[k, 2] = total, x0, y0
        cuts.place[k, 3], cuts.place[k, 4] = columns, rows
        total += columns * rows
    return total


@compiled
def lay_pictures(
    cameras: Cameras, cuts: Cuts, boxes: Ints, margin: int, height_mm: float, stack: NDArray[np.float32]
) -> None:
    """Write the blurred pictures of a grid on the plane at a height above the board's surface to `stack`.

    There is NaN outside the boxes, and where a frame does not show the place.

    Args:
        cameras: the cameras.
        cuts: what the k frames show.
        boxes: (k, 4) box of each picture: first column, first row, and those after the last ones.
        margin: columns and rows of the stack before those of the grid.
        height_mm: the height.
        stack: (k, h, w) output.
    """
    for k in range(len(stack)):
        x0, y0, x1, y1 = boxes[k, 0], boxes[k, 1], boxes[k, 2], boxes[k, 3]
        if y1 - y0 < stack.shape[1] or x1 - x0 < stack.shape[2]:
            stack[k] = np.nan
        picture = np.empty((y1 - y0, x1 - x0), np.float32)
        sample(cuts.grey, cuts.place[k], _nodes(cameras, cuts, k, boxes[k], height_mm), _MESH_PX, picture)
        _blur(picture, stack[k], x0 + margin, y0 + margin)


@inlined
def _nodes(cameras: Cameras, cuts: Cuts, k: int, box: Ints, height_mm: float) -> Floats:
    """Return the positions (ny, nx, 2) of every twelfth column and row of a box in a frame's copy."""
    camera, m = cuts.camera[k], cuts.row_from_grid[k]
    n, radial = cameras.image_from_row[camera], cameras.radial[camera]
    x0, y0, radius, edge, furthest = cameras.lens[camera]
    lens = (x0, y0, radius, edge, furthest)
    foot_x, foot_y, inverse = cameras.viewpoint[camera]
    share = (cuts.surface_mm + height_mm) * inverse
    nodes = np.empty(((box[3] - box[1] - 2) // _MESH_PX + 2, (box[2] - box[0] - 2) // _MESH_PX + 2, 2))
    for a in range(nodes.shape[0]):
        for b in range(nodes.shape[1]):
            column, row = box[0] + b * _MESH_PX, box[1] + a * _MESH_PX
            x = (m[0, 0] * column + m[0, 1] * row + m[0, 2] - share * foot_x) / (1 - share)
            y = (m[1, 0] * column + m[1, 1] * row + m[1, 2] - share * foot_y) / (1 - share)
            w = n[2, 0] * x + n[2, 1] * y + n[2, 2]
            u, v = (n[0, 0] * x + n[0, 1] * y + n[0, 2]) / w, (n[1, 0] * x + n[1, 1] * y + n[1, 2]) / w
            u, v = distort_point(u, v, radial, lens)
            nodes[a, b, 0] = (u + 0.5) * cuts.reduction - 0.5
            nodes[a, b, 1] = (v + 0.5) * cuts.reduction - 0.5
    return nodes


@inlined
def sample(grey: NDArray[np.float32], place: Ints, nodes: Floats, step: int, out: NDArray[np.float32]) -> None:
    """Sample a part of an image with a windowed sinc of 6×6 pixels and write the values to `out` (h, w).

    There is NaN where the part does not contain all 6×6 pixels. A narrower kernel displaces fine texture, by up to
    0.02 px for waves of 5 px, and alike in a whole small component.

    Args:
        grey: grey levels of parts of images.
        place: (5,) first pixel in `grey`; first column and row in the image; columns and rows of the part.
        nodes: (ny, nx, 2) positions in the image of every `step`-th pixel of `out`; between them they are bilinear.
        step: distance of the nodes in pixels of `out`.
        out: output.
    """
    x0, y0, columns, rows = place[1], place[2], place[3], place[4]
    part, last = grey[place[0] : place[0] + columns * rows], nodes.shape[1] - 2
    for y in range(out.shape[0]):
        a = min(y // step, nodes.shape[0] - 2)
        ty = min((y - a * step) / step, 1.0)
        for b in range(last + 1):
            u = nodes[a, b, 0] + ty * (nodes[a + 1, b, 0] - nodes[a, b, 0])
            v = nodes[a, b, 1] + ty * (nodes[a + 1, b, 1] - nodes[a, b, 1])
            du = (nodes[a, b + 1, 0] + ty * (nodes[a + 1, b + 1, 0] - nodes[a, b + 1, 0]) - u) / step
            dv = (nodes[a, b + 1, 1] + ty * (nodes[a + 1, b + 1, 1] - nodes[a, b + 1, 1]) - v) / step
            for x in range(b * step, out.shape[1] if b == last else min((b + 1) * step, out.shape[1])):
                n = min(x - b * step, step)
                px, py = u + n * du - x0, v + n * dv - y0
                if px >= 2 and py >= 2 and px < columns - 3 and py < rows - 3:
                    out[y, x] = _value(part, columns, px, py)
                else:
                    out[y, x] = np.nan


@inlined
def _value(grey: NDArray[np.float32], columns: int, px: float, py: float) -> float:
    """Return the weighted sum of the 6×6 pixels around a position of a part whose lines follow each other."""
    left, top = int(px), int(py)
    wx, wy = _TABLE[int((px - left) * _STEPS + 0.5)], _TABLE[int((py - top) * _STEPS + 0.5)]
    w0, w1, w2, w3, w4, w5 = wy[0], wy[1], wy[2], wy[3], wy[4], wy[5]
    # Unsigned: indexes that cannot be negative are read without a test, which halves the time.
    pitch = np.uint64(columns)
    line0 = np.uint64(top - 2) * pitch + np.uint64(left - 2)
    line1, line2, line3 = line0 + pitch, line0 + np.uint64(2) * pitch, line0 + np.uint64(3) * pitch
    line4, line5 = line0 + np.uint64(4) * pitch, line0 + np.uint64(5) * pitch
    total = np.float32(0)
    for k in range(6):
        n = np.uint64(k)
        column = w0 * grey[line0 + n] + w1 * grey[line1 + n] + w2 * grey[line2 + n]
        column += w3 * grey[line3 + n] + w4 * grey[line4 + n] + w5 * grey[line5 + n]
        total += wx[n] * column
    return float(total)


@inlined
def _blur(picture: NDArray[np.float32], out: NDArray[np.float32], left: int, top: int) -> None:
    """Write a picture (h, w), blurred, to `out` from a column and row on. Beyond its borders it is mirrored."""
    h, w = picture.shape
    line, half = np.empty(w + 2 * BLUR_REACH_PX, np.float32), np.empty((h, w), np.float32)
    for y in range(h):
        source, target = picture[y], half[y]
        for x in range(w):
            line[x + BLUR_REACH_PX] = source[x]
        for x in range(BLUR_REACH_PX):
            line[x], line[w + BLUR_REACH_PX + x] = source[BLUR_REACH_PX - x], source[w - 2 - x]
        for x in range(w):
            middle = np.uint64(x + BLUR_REACH_PX)
            total = _BELL[0] * line[middle]
            for d in range(1, BLUR_REACH_PX + 1):
                total += _BELL[d] * (line[middle - np.uint64(d)] + line[middle + np.uint64(d)])
            target[x] = total
    total_line = line[:w]
    for y in range(h):
        source, target = half[y], out[top + y, left : left + w]
        for x in range(w):
            total_line[x] = _BELL[0] * source[x]
        for d in range(1, BLUR_REACH_PX + 1):
            above, below = half[abs(y - d)], half[min(y + d, 2 * h - 2 - y - d)]
            for x in range(w):
                total_line[x] += _BELL[d] * (above[x] + below[x])
        for x in range(w):
            target[x] = total_line[x]
