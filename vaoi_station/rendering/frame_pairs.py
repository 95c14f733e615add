"""Compiled search for the frames that show components: what a frame shows of a footprint, and the matrix to it.

For each component it takes all frames in turn, as a picture of a board is short: numpy would need some hundred calls,
which take longer than the arithmetic, however few components there are. For the same reason footprints and the matrices
of pictures are computed here; `crops` states what they are. The module is imported on first use, because Numba takes a
moment to load.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from vaoi_station.compiled import compiled, inlined
from vaoi_station.geometry.projection_kernels import distort_point
from vaoi_station.geometry.transforms import Floats

GRID = 9
"""Points per side of the grid on which the coverage of a component is computed if the frame shows only a part of it."""
_SHARES = np.arange(GRID * GRID + 1) / (GRID * GRID)
"""Coverage by number of points of that grid that a frame shows."""


class Frames(NamedTuple):
    """The f frames of a run, and the lenses of its cameras."""

    image_from_cad: Floats
    """(f, 3, 3) from CAD to undistorted pixels, in the calibrated plane."""
    lean: Floats
    """(f, 3) decrease of the third column of that matrix per mm of height."""
    size: Floats
    """(f, 2) width and height, px."""
    bend: Floats
    """(f,) largest shift that the lens causes, px."""
    scale: Floats
    """(f,) px per CAD unit, at most."""
    key: NDArray[np.int_]
    """(f, 2) camera and row."""
    radial: Floats
    """(cameras, coefficients) of the lenses' distortion; 0 where a lens has fewer."""
    lens: Floats
    """(cameras, 5) `Lens.shape`."""
    lensed: NDArray[np.bool_]
    """(cameras,) whether the lens distorts at all."""


class Parts(NamedTuple):
    """n components and their pictures."""

    center: Floats
    """(n, 2) centres of the footprints, CAD."""
    half: Floats
    """(n, 2) half the width and half the height before rotation."""
    inner: Floats
    """(n, 2, 2) half the width and half the height as vectors (columns), between the centres of the border pixels."""
    height_mm: Floats
    """(n,) height of the plane of the picture above the calibrated plane."""
    own: Floats
    """(n, 3, 3) displacements of components with a C of their own; empty (0, 3, 3) if no component has one."""
    size: Floats
    """(n, 2) width and height of the pictures."""
    cad_from_crop: Floats
    """(n, 3, 3)."""
    bare: NDArray[np.bool_]
    """(n,) whether a picture shows the footprint and nothing else."""


class Pairs(NamedTuple):
    """p pairs of a component and a frame that shows it, ordered by component, those of one component best first."""

    component: NDArray[np.int_]
    """(p,) number of the component of each pair."""
    frame: NDArray[np.int_]
    """(p,) number of the frame of each pair."""
    image_from_cad: Floats
    """(p, 3, 3) from CAD to undistorted pixels of the frame, in the plane of the picture."""
    image_from_crop: Floats
    """(p, 3, 3) from pixels of the picture to undistorted pixels of the frame."""
    coverage: Floats
    """(p,) share of the footprint inside the frame."""
    off_center: Floats
    """(p,) distance of the footprint's centre from that of the frame, in half diagonals."""
    outline_px: Floats
    """(p, 4, 2) corners of the footprint in raw pixels, going round."""
    picture_px: Floats
    """(p, 9, 2) raw pixels of 3×3 points over the picture, row by row."""


class Boxes(NamedTuple):
    """Rectangles in CAD, as the fields of `Footprints`."""

    center: Floats
    half: Floats
    along: Floats
    box: Floats


class Upright(NamedTuple):
    """Matrices between CAD and upright pictures, as the fields of `Crops`."""

    crop_from_cad: Floats
    cad_from_crop: Floats
    bare: NDArray[np.bool_]


@compiled
def turn_boxes(rows: Floats, way: float) -> Boxes:
    """Return rectangles and their bounding boxes.

    Args:
        rows: (n, 5) centres, width and height before rotation, rotation in degrees.
        way: 1 if rotations count from x towards y, −1 if they count the other way.
    """
    n = len(rows)
    boxes = Boxes(np.empty((n, 2)), np.empty((n, 2)), np.empty((n, 2, 2)), np.empty((n, 2)))
    for k in range(n):
        angle, w, h = math.radians(rows[k, 4]) * way, rows[k, 2] / 2, rows[k, 3] / 2
        c, s, along = math.cos(angle), math.sin(angle), boxes.along[k]
        along[0, 0], along[0, 1], along[1, 0], along[1, 1] = c * w, -s * h, s * w, c * h
        boxes.half[k, 0], boxes.half[k, 1] = w, h
        for i in range(2):
            boxes.center[k, i], boxes.box[k, i] = rows[k, i], abs(along[i, 0]) + abs(along[i, 1])
    return boxes


@compiled
def upright(
    center: Floats, half: Floats, along: Floats, reach: Floats, size: Floats, way: tuple[float, float], turned: bool
) -> Upright:
    """Return the matrices between CAD and upright pictures of rectangles.

    Args:
        center: (n, 2) centres of the rectangles.
        half: (n, 2) half of the width and height that are shown, without margin.
        along: (n, 2, 2) as the field of `Footprints`.
        reach: (n, 2) half of the width and height that are shown, with margin.
        size: (n, 2) width and height of the pictures.
        way: direction of the pictures' axes along those of CAD, 1 or −1, or along those of the rectangles if `turned`.
        turned: whether the pictures are turned as the rectangles are.
    """
    n = len(center)
    there, back, bare = np.zeros((n, 3, 3)), np.zeros((n, 3, 3)), np.empty(n, np.bool_)
    for k in range(n):
        # The scale uses the rounded size, so that the box fills the picture exactly: sides change by less than a pixel.
        for i in range(2):
            scale = way[i] * size[k, i] / (2 * reach[k, i])
            for j in range(2):
                # The direction in CAD that runs along axis i of the picture.
                axis = along[k, j, i] / half[k, i] if turned else (1.0 if i == j else 0.0)
                there[k, i, j], back[k, j, i] = scale * axis, axis / scale
        x, y = (size[k, 0] - 1) / 2, (size[k, 1] - 1) / 2
        there[k, 0, 2] = x - (there[k, 0, 0] * center[k, 0] + there[k, 0, 1] * center[k, 1])
        there[k, 1, 2] = y - (there[k, 1, 0] * center[k, 0] + there[k, 1, 1] * center[k, 1])
        for i in range(2):
            back[k, i, 2] = center[k, i] - (back[k, i, 0] * x + back[k, i, 1] * y)
        there[k, 2, 2] = back[k, 2, 2] = 1.0
        # At whole quarter turns the bounding box is the footprint.
        a, limit = along[k], 1e-9 * max(half[k, 0], half[k, 1])
        straight = min(abs(a[0, 0]), abs(a[0, 1]), abs(a[1, 0]), abs(a[1, 1])) <= limit
        bare[k] = (turned or straight) and reach[k, 0] == half[k, 0] and reach[k, 1] == half[k, 1]
    return Upright(there, back, bare)


@inlined
def _touching(frames: Frames, parts: Parts, least: float) -> NDArray[np.bool_]:
    """Return which frames may show which components (n, f). Most frames show only few components."""
    found = np.zeros((len(parts.center), len(frames.size)), np.bool_)
    for k in range(len(parts.center)):
        x, y, w = parts.center[k, 0], parts.center[k, 1], 1.0
        if len(parts.own):
            m = parts.own[k]
            x, y, w = (
                m[0, 0] * x + m[0, 1] * y + m[0, 2], m[1, 0] * x + m[1, 1] * y + m[1, 2],
                m[2, 0] * x + m[2, 1] * y + m[2, 2],
            )  # fmt: skip
        # A frame shows at most half of a footprint whose centre it does not show: both are symmetric or convex.
        reach = math.sqrt(parts.half[k, 0] ** 2 + parts.half[k, 1] ** 2) if least < 0.5 else 0.0
        for f in range(len(frames.size)):
            m, lean, h = frames.image_from_cad[f], frames.lean[f], parts.height_mm[k]
            depth = m[2, 0] * x + m[2, 1] * y + m[2, 2] * w - lean[2] * h
            u = (m[0, 0] * x + m[0, 1] * y + m[0, 2] * w - lean[0] * h) / depth
            v = (m[1, 0] * x + m[1, 1] * y + m[1, 2] * w - lean[1] * h) / depth
            margin = frames.bend[f] + 1 + frames.scale[f] * reach
            right, bottom = frames.size[f, 0] - 1 + margin, frames.size[f, 1] - 1 + margin
            found[k, f] = u >= -margin and v >= -margin and u <= right and v <= bottom
    return found


@inlined
def _copy(values: Floats, out: Floats) -> None:
    """Write an array (n, m) to another one. Numba takes a second to compile an assignment of arrays."""
    for i in range(len(values)):
        for j in range(values.shape[1]):
            out[i, j] = values[i, j]


@inlined
def _multiply(a: Floats, b: Floats, out: Floats) -> None:
    """Write the product of two (3, 3) matrices."""
    for i in range(3):
        for j in range(3):
            out[i, j] = a[i, 0] * b[0, j] + a[i, 1] * b[1, j] + a[i, 2] * b[2, j]


@inlined
def _show(m: Floats, grid: tuple[float, ...], count: int, frames: Frames, f: int, out: Floats) -> int:
    """Write the raw pixels of a grid of count × count points, row by row; return how many a frame shows.

    `grid` is the centre of the grid, and the vectors from there to the middle of its right and of its lower side.
    """
    x, y, right_x, right_y, down_x, down_y = grid
    camera, width, height, shown = frames.key[f, 0], frames.size[f, 0], frames.size[f, 1], 0
    s = frames.lens[camera]
    lens = s[0], s[1], s[2], s[3], s[4]
    for n in range(count * count):
        right, down = 2.0 * (n % count) / (count - 1) - 1.0, 2.0 * (n // count) / (count - 1) - 1.0
        at_x, at_y = x + right * right_x + down * down_x, y + right * right_y + down * down_y
        w = m[2, 0] * at_x + m[2, 1] * at_y + m[2, 2]
        u, v = (m[0, 0] * at_x + m[0, 1] * at_y + m[0, 2]) / w, (m[1, 0] * at_x + m[1, 1] * at_y + m[1, 2]) / w
        if frames.lensed[camera]:
            u, v = distort_point(u, v, frames.radial[camera], lens)
        out[n, 0], out[n, 1] = u, v
        # Equation 22.
        shown += u >= 0 and v >= 0 and u <= width - 1 and v <= height - 1
    return shown


@inlined
def _is_better(a: int, b: int, share: Floats, off: Floats, key: NDArray[np.int_]) -> bool:
    """Return whether pair a comes before pair b: more of the footprint, nearer to the frame's centre, row, camera."""
    if share[a] != share[b]:
        return bool(share[a] > share[b])
    # Rounded, so that the order does not depend on the last digits of nearly equal values.
    near, far = np.rint(off[a] * 1e6), np.rint(off[b] * 1e6)
    if near != far:
        return bool(near < far)
    return bool(key[a, 1] < key[b, 1] or (key[a, 1] == key[b, 1] and key[a, 0] < key[b, 0]))


def find_pairs(frames: Frames, parts: Parts, least: float) -> Pairs:
    """Return the pairs of a component and a frame that shows at least the share `least` of its footprint."""
    # A caller may give 1 for 1.0, for which Numba would compile the search a second time.
    every, best = _search(frames, parts, float(least))
    # By numpy: Numba would compile it for longer than all the rest.
    return Pairs(*(values[best] for values in every))


def load() -> None:
    """Load the compiled functions, so that their first calls take no longer than others."""
    boxes = turn_boxes(np.ones((1, 5)), 1.0)
    upright(boxes.center, boxes.half, boxes.along, boxes.half, np.ones((1, 2)), (1.0, 1.0), False)
    one, flags = np.ones((1, 2)), np.ones(1, np.bool_)
    matrix, numbers = np.eye(3)[None], np.ones(1)
    frames = Frames(
        matrix, np.ones((1, 3)), one, numbers, numbers, np.zeros((1, 2), np.int_), one, np.ones((1, 5)), flags
    )
    find_pairs(frames, Parts(one, one, matrix[:, :2, :2].copy(), numbers, matrix, one, matrix, flags), 0.5)


@compiled
def _search(frames: Frames, parts: Parts, least: float) -> tuple[Pairs, NDArray[np.int_]]:
    """Return the pairs that may be shown, in any order, and the order (p,) of those that are."""
    touching = _touching(frames, parts, least)
    count = touching.sum()
    component, frame, order = np.empty(count, np.int_), np.empty(count, np.int_), np.empty(count, np.int_)
    key, share, off = np.empty((count, 2), np.int_), np.empty(count), np.empty(count)
    cad, crop = np.empty((count, 3, 3)), np.empty((count, 3, 3))
    outline, picture = np.empty((count, 4, 2)), np.empty((count, 9, 2))
    points, spare = np.empty((GRID * GRID, 2)), np.empty((3, 3))
    p = kept = inside = 0
    for k in range(len(parts.center)):
        begin, e = kept, parts.inner[k]
        across, along = (parts.size[k, 0] - 1) / 2, (parts.size[k, 1] - 1) / 2
        whole = across, along, across, 0.0, 0.0, along
        footprint = parts.center[k, 0], parts.center[k, 1], e[0, 0], e[1, 0], e[0, 1], e[1, 1]
        for f in range(len(frames.size)):
            if not touching[k, f]:
                continue
            _copy(frames.image_from_cad[f], cad[p])
            for i in range(3):
                cad[p, i, 2] -= parts.height_mm[k] * frames.lean[f, i]
            if len(parts.own):
                _copy(cad[p], spare)
                _multiply(spare, parts.own[k], cad[p])
            _multiply(cad[p], parts.cad_from_crop[k], crop[p])
            # The picture; then its footprint, unless it shows nothing else; then, of few, the footprint in fine steps.
            for step in range(3):
                if (step == 1 and parts.bare[k]) or (step == 2 and inside == 9):
                    continue
                m, grid = (cad[p], footprint) if step else (crop[p], whole)
                inside = _show(m, grid, GRID if step == 2 else 3, frames, f, points)
                if step == 0:
                    _copy(points[:9], picture[p])
                if step < 2:
                    for n, corner in enumerate((0, 2, 8, 6)):
                        outline[p, n, 0], outline[p, n, 1] = points[corner, 0], points[corner, 1]
                    x, y = (frames.size[f, 0] - 1) / 2, (frames.size[f, 1] - 1) / 2
                    off[p] = math.hypot(points[4, 0] - x, points[4, 1] - y) / math.hypot(x, y)
                share[p] = _SHARES[inside if step == 2 else -1]
            if share[p] >= max(least, 1e-9):
                component[p], frame[p] = k, f
                key[p, 0], key[p, 1] = frames.key[f, 0], frames.key[f, 1]
                at = kept
                while at > begin and _is_better(p, order[at - 1], share, off, key):
                    order[at] = order[at - 1]
                    at -= 1
                order[at] = p
                kept += 1
            p += 1
    return Pairs(component, frame, cad, crop, share, off, outline, picture), order[:kept]
