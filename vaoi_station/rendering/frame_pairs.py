"""Compiled search for the frames that show components: what a frame shows of a footprint, and the matrix to it.

For each component it takes all frames in turn, as a picture of a board is short: numpy would need some hundred calls,
which take longer than the arithmetic, however few components there are. The module is imported on first use, because
Numba takes a moment to load.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from vaoi_station.compiled import compiled, inlined
from vaoi_station.geometry.projection_kernels import distort_point
from vaoi_station.geometry.transforms import Floats

FITTING = 0.999
"""Share of the largest resolution that is used, because the sides of a picture are rounded to whole pixels."""
GRID = 9
"""Points per side of the grid on which the coverage of a component is computed if the frame shows only a part of it."""
_SHARES = np.arange(GRID * GRID + 1) / (GRID * GRID)
"""Coverage by number of points of that grid that a frame shows."""


class Crops(NamedTuple):
    """The pictures of k components, independent of any frame."""

    center: Floats
    """(k, 2) centres of the footprints, CAD."""
    half: Floats
    """(k, 2) half the width and half the height of the footprints before rotation."""
    along: Floats
    """(k, 2, 2) half the width (`[:, :, 0]`) and half the height (`[:, :, 1]`) as vectors in CAD."""
    px_per_mm: Floats
    """(k,) resolution of each picture."""
    size: Floats
    """(k, 2) width and height of each picture in px, whole numbers."""
    crop_from_cad: Floats
    """(k, 3, 3) matrices from CAD coordinates to the pixels of each picture."""
    cad_from_crop: Floats
    """(k, 3, 3) inverse matrices."""
    bare: NDArray[np.bool_]
    """(k,) whether a picture shows the footprint and nothing else."""


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


@compiled
def upright(
    rows: Floats, way: tuple[float, float], turned: bool, margin: float, px_per_mm: tuple[float, float], most_px: float
) -> Crops:
    """Lay out upright pictures of rectangles.

    Args:
        rows: (k, 5) centres, half of width and height before rotation, rotation in degrees.
        way: direction of the pictures' axes along those of CAD, 1 or −1, or along those of the rectangles if `turned`.
        turned: whether the pictures are turned as the rectangles are.
        margin: strip of surroundings on all sides, CAD units.
        px_per_mm: resolution, and size of a CAD unit in mm.
        most_px: largest number of pixels of a picture without its margin; the resolution of larger ones is lower.
    """
    n = len(rows)
    out = Crops(
        np.empty((n, 2)), np.empty((n, 2)), np.empty((n, 2, 2)), np.empty(n), np.empty((n, 2)), np.zeros((n, 3, 3)),
        np.zeros((n, 3, 3)), np.empty(n, np.bool_),
    )  # fmt: skip
    turn, (resolution, mm) = np.empty((2, 2)), px_per_mm
    for k in range(n):
        angle = math.radians(rows[k, 4]) * -way[1]
        c, s = math.cos(angle), math.sin(angle)
        turn[0, 0], turn[1, 0], turn[0, 1], turn[1, 1] = c, s, -s, c
        there, back, along = out.crop_from_cad[k], out.cad_from_crop[k], out.along[k]
        for i in range(2):
            out.center[k, i], out.half[k, i] = rows[k, i], rows[k, 2 + i]
            along[i, 0], along[i, 1] = turn[i, 0] * rows[k, 2], turn[i, 1] * rows[k, 3]
        across, down = abs(along[0, 0]) + abs(along[0, 1]), abs(along[1, 0]) + abs(along[1, 1])
        out.px_per_mm[k] = min(resolution, FITTING * math.sqrt(most_px / (4 * across * down * mm * mm)))
        shown = (rows[k, 2], rows[k, 3]) if turned else (across, down)
        for i in range(2):
            reach = shown[i] + margin
            # The scale uses the rounded size, so that the box fills the picture exactly: sides change by less than a
            # pixel.
            out.size[k, i] = max(np.rint(2 * reach * out.px_per_mm[k] * mm), 1.0)
            scale = way[i] * out.size[k, i] / (2 * reach)
            for j in range(2):
                # The direction in CAD that runs along axis i of the picture.
                axis = turn[j, i] if turned else (1.0 if i == j else 0.0)
                there[i, j], back[j, i] = scale * axis, axis / scale
            there[i, 2] = (out.size[k, i] - 1) / 2 - (there[i, 0] * rows[k, 0] + there[i, 1] * rows[k, 1])
        for i in range(2):
            x, y = (out.size[k, 0] - 1) / 2, (out.size[k, 1] - 1) / 2
            back[i, 2] = rows[k, i] - (back[i, 0] * x + back[i, 1] * y)
        there[2, 2] = back[2, 2] = 1.0
        # At whole quarter turns the bounding box is the footprint.
        least = min(abs(along[0, 0]), abs(along[0, 1]), abs(along[1, 0]), abs(along[1, 1]))
        out.bare[k] = margin == 0 and (turned or least <= 1e-9 * max(rows[k, 2], rows[k, 3]))
    return out


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
    upright(np.ones((1, 5)), (1.0, 1.0), False, 0.0, (1.0, 1.0), 1.0)
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
