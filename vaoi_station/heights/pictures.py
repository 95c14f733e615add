"""The pictures of one component: the same footprint in all frames that show it, on one plane and blurred alike.

A grid is aligned with the footprint and lies on the board's surface. Its pixels are about as large as those of the
frames, or a power of two larger on large components. Coordinates of a grid: column and row, whose centres are integers;
the origin is the centre of the top-left pixel of the footprint's part without margin.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from vaoi_station.compiled import compiled, inlined
from vaoi_station.frame_index import FrameIndex
from vaoi_station.geometry import Camera
from vaoi_station.geometry.projection_kernels import distort_point
from vaoi_station.geometry.transforms import Floats, apply
from vaoi_station.model import BoardType, Stitch
from vaoi_station.pixel_formats import eight_bit_grey

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


FrameKey = tuple[int, int]
LONGEST_PX = 160
"""Longest side of a grid; larger footprints get larger pixels."""
_MOST_LEVEL = 4
_LEAST_SIDE_PX = 6
"""Least side of a grid. Smaller footprints have no height."""


class Frames:
    """The frames of one run in reduced copies, each computed when it is first used."""

    def __init__(self, frame: Callable[[int, int], NDArray[Any] | None]) -> None:
        """Create it from a function that returns the pixels of a camera and row; None for a missing frame."""
        self._frame = frame
        self._copies: dict[tuple[int, int, int], NDArray[Any] | None] = {}

    def get(self, key: FrameKey, level: int) -> NDArray[Any] | None:
        """Return the grey frame reduced by 2 to the power of `level`; None if it is missing."""
        at = (*key, level)
        if at not in self._copies:
            self._copies[at] = self._reduced(key, level)
        return self._copies[at]

    def _reduced(self, key: FrameKey, level: int) -> NDArray[Any] | None:
        if level == 0:
            pixels = self._frame(*key)
            if pixels is None:
                return None
            # 32-bit floats are grey levels that were divided by a flat field.
            return np.ascontiguousarray(pixels if pixels.dtype == np.float32 else eight_bit_grey(pixels))
        finer = self.get(key, level - 1)
        if finer is None:
            return None
        h, w = finer.shape[0] // 2 * 2, finer.shape[1] // 2 * 2
        return np.asarray(cv2.resize(finer[:h, :w], (w // 2, h // 2), interpolation=cv2.INTER_AREA))


class PartGrid(NamedTuple):
    """The grid of one component."""

    address: str
    width: int
    height: int
    """Columns and rows of the footprint's part without margin."""
    level: int
    """Frames are reduced by 2 to the power of this."""
    mm_per_px: float
    surface_mm: float
    """Height of the board's surface above the calibrated plane."""
    tester_from_grid: Floats
    """(2, 3) affine map."""
    keys: Ints
    """(v, 2) camera and row of the frames that show it."""
    feet_px: Floats
    """(v, 2) feet of their cameras in grid coordinates: the points of the surface's plane below the camera centres."""
    distance_mm: Floats
    """(v,) heights of the cameras above the board's surface at the component."""


class Places:
    """Where the components of one run lie in its frames."""

    def __init__(self, board_type: BoardType, stitch: Stitch, cameras: Sequence[Camera]) -> None:
        """Store the matrices of a run; `cameras` are those of its calibration."""
        index = FrameIndex.of_result(stitch, cameras)
        # Rows that a repeated pattern may have displaced by a period show other parts than their matrices say.
        doubtful = [row for rows in stitch.quality.get("rows_apart", ()) for row in rows]
        used = ~np.isin(index.key[:, 1], doubtful)
        self.board_type, self.stitch, self._key = board_type, stitch, index.key[used]
        arrays = index.arrays
        self.cameras = Cameras(arrays.image_from_row, arrays.viewpoint, arrays.radial, arrays.lens)
        self.tester_from_cad = index.tester_from_cad
        """C (3, 3)."""
        self._px_per_mm, self._row_from_tester = index.px_per_mm, index.row_from_tester
        i, row = self._key.T
        eye_mm, self._size_px = index.eye_mm[used], index.size_px[used]
        self._image_from_tester = arrays.image_from_row[i] @ index.row_from_tester[row]
        self._distance_mm = eye_mm[:, 2]
        feet = np.column_stack([eye_mm[:, :2], np.ones(len(row))])
        self._foot_mm = (np.linalg.inv(index.row_from_tester)[row] @ feet[:, :, None])[:, :2, 0]
        """(f, 2) in tester coordinates."""

    def grid(self, address: str, corners_cad: Floats, longest_px: int = LONGEST_PX) -> PartGrid | None:
        """Return the grid of a component with these corners (4, 2), or None if it is too small for one.

        Its longest side is at most `longest_px`.
        """
        matrix = self.stitch.component_matrix(address)
        assert matrix is not None
        corners = apply(matrix, corners_cad)
        # Plain numbers: numpy takes ten times as long for so few.
        (ax, ay), (bx, by), (cx, cy), (dx, dy) = corners.tolist()
        sides = ((bx - ax, by - ay), (dx - ax, dy - ay))
        length = [math.hypot(*side) for side in sides]
        longest = max(length) * self._px_per_mm
        level = min(max(0, math.ceil(math.log2(longest / longest_px))), _MOST_LEVEL) if longest > 0 else 0
        pitch = 2**level / self._px_per_mm
        width, height = (int(v / pitch + 1e-6) for v in length)
        if min(width, height) < _LEAST_SIDE_PX:
            return None
        (ux, uy), (vx, vy) = ((x / v * pitch, y / v * pitch) for (x, y), v in zip(sides, length, strict=True))
        x = (ax + bx + cx + dx) / 4 - ux * (width - 1) / 2 - vx * (height - 1) / 2
        y = (ay + by + cy + dy) / 4 - uy * (width - 1) / 2 - vy * (height - 1) / 2
        affine = np.array([[ux, vx, x], [uy, vy, y]])
        surface = self.stitch.surface
        z = 0.0 if surface is None else float(surface.height_mm(corners_cad.sum(0) / 4))
        at = self._image_from_tester @ np.column_stack([corners, np.ones(4)]).T
        px = at[:, :2] / at[:, 2:]
        inside = (px.max(2) > 0) & (px.min(2) < self._size_px)
        shown = np.flatnonzero(inside.all(1) & (self._distance_mm > z))
        feet = (self._foot_mm[shown] - affine[:, 2]) @ np.linalg.inv(affine[:, :2]).T
        return PartGrid(
            address, width, height, level, pitch, z, affine, self._key[shown], feet, self._distance_mm[shown] - z
        )

    def row_from_grid(self, grid: PartGrid) -> Floats:
        """Return the affine maps (v, 2, 3) from a grid to row coordinates at the rows of its frames."""
        # The row's motion after the grid's place.
        way = self._row_from_tester[grid.keys[:, 1], :2, :2] @ grid.tester_from_grid
        way[:, :, 2] += self._row_from_tester[grid.keys[:, 1], :2, 2]
        return way


class Pictures(NamedTuple):
    """What a component's frames have in common, for k frames."""

    grid: PartGrid
    """The grid; `keys`, `feet_px` and `distance_mm` are those of the k frames."""
    group: Ints
    """(k,) number of the light."""
    spread: float
    """Largest displacement between two pictures, px of the grid per mm of height."""
    images: tuple[NDArray[Any], ...]


def collect_pictures(grid: PartGrid, frames: Frames, light: Callable[[int], int]) -> Pictures | None:
    """Collect the frames that show a grid; None if there are fewer than two.

    `light` gives the number of the light of a row.
    """
    keys = [(camera, row) for camera, row in grid.keys.tolist()]
    images = [frames.get(key, grid.level) for key in keys]
    there = [n for n, image in enumerate(images) if image is not None]
    if len(there) < 2:
        return None
    if len(there) < len(keys):
        grid = grid._replace(keys=grid.keys[there], feet_px=grid.feet_px[there], distance_mm=grid.distance_mm[there])
    feet = [complex(x, y) for x, y in grid.feet_px.tolist()]
    spread = max(abs(a - b) for a in feet for b in feet) / (sum(grid.distance_mm.tolist()) / len(feet))
    if spread <= 0:
        return None
    group = np.array([light(keys[n][1]) for n in there])
    return Pictures(grid, group, spread, tuple(image for image in images if image is not None))


class CutPictures(NamedTuple):
    """The parts of the frames that a range of heights needs."""

    cuts: Cuts
    boxes: Ints
    """(k, 4) what the heights need of each picture on the board's surface, as a box of the grid."""


def cut_pictures(places: Places, pictures: Pictures, lowest_mm: float, highest_mm: float) -> CutPictures:
    """Cut out of the frames what shows the grid at all heights between two over the board's surface."""
    grid, images = pictures.grid, pictures.images
    boxes = surface_boxes(grid.width, grid.height, grid.feet_px, grid.distance_mm, (lowest_mm, highest_mm))
    place, size = np.empty((len(images), 5), np.int64), np.array([image.shape[::-1] for image in images])
    way = places.row_from_grid(grid)
    cuts = Cuts(
        np.empty(0, np.float32), place, np.ascontiguousarray(grid.keys[:, 0]), way, grid.surface_mm, 0.5**grid.level
    )
    grey = np.empty(place_cuts(places.cameras, cuts, boxes, size), np.float32)
    for (first, x, y, columns, rows), image in zip(place.tolist(), images, strict=True):
        part = image[y : y + rows, x : x + columns]
        grey[first : first + part.size].reshape(part.shape)[...] = part
    return CutPictures(cuts._replace(grey=grey), boxes)


def surface_stack(places: Places, pictures: Pictures, cut: CutPictures) -> tuple[NDArray[np.float32], int]:
    """Return the pictures (k, h, w) on the board's surface where heights need them, else NaN; and their margin."""
    grid, boxes = pictures.grid, cut.boxes
    margin = max(0, -int(boxes[:, :2].min()), int((boxes[:, 2:] - (grid.width, grid.height)).max()))
    return _stack(places, grid, cut.cuts, boxes, margin, 0.0), margin


def picture_stack(
    places: Places, pictures: Pictures, cut: CutPictures, margin: int, height_mm: float
) -> NDArray[np.float32]:
    """Return the pictures (k, h, w) of a grid on the plane at a height above the board, with a margin."""
    grid = pictures.grid
    boxes = np.array([(-margin, -margin, grid.width + margin, grid.height + margin)] * len(pictures.images))
    return _stack(places, grid, cut.cuts, boxes, margin, height_mm)


def _stack(
    places: Places, grid: PartGrid, cuts: Cuts, boxes: Ints, margin: int, height_mm: float
) -> NDArray[np.float32]:
    stack = np.empty((len(boxes), grid.height + 2 * margin, grid.width + 2 * margin), np.float32)
    lay_pictures(places.cameras, cuts, boxes, margin, height_mm, stack)
    return stack
