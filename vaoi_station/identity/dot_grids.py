"""Grids of dots in pictures: DataMatrix codes as lasers and dot peening mark them, with one dot for every dark module.

Readers of printed codes follow the two solid sides of a code from pixel to pixel. Sides of dots have gaps, and one dot
that is missing ends them. Here the area of a code is found first, then all its modules are compared with the pattern of
its border.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import lru_cache
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from vaoi_station.geometry.homographies import rectangle_homographies
from vaoi_station.geometry.transforms import Floats, apply

MODULES_PX = (4.4, 5.6, 7.2, 9.2)
"""Sides of modules at which a picture is searched; each finds modules from 0.78 to 1.28 of it."""

_UNIT = np.array([[(0.0, 0.0), (1.0, 0.0), (1.0, 1.0), (0.0, 1.0)]])
"""Corners of the unit square, as those of one rectangle."""
_SIZES = (
    *((n, n) for n in (10, 12, 14, 16, 18, 20, 22, 24, 26, 32, 36, 40, 44, 48)),
    *((8, 18), (8, 32), (12, 26), (12, 36), (16, 36), (16, 48)),
)
"""Numbers of rows and columns of DataMatrix codes (ISO/IEC 16022, table 7), up to 48 columns."""
_PX = 4
"""Side of a module in the pictures that are compared, about."""
_SMOOTH, _DOT = 0.2, 3.0
"""σ of the filter against noise, and the width of what is too wide for a dot, in modules."""
_MARKED, _STRONG, _BESIDE = 1.0, 0.35, 5
"""Least contrast of a marked pixel: above the mean of its picture, as a multiple of the standard deviation, and as a
share of the highest in a square round it, whose side is the third number, in modules."""
_JOINED, _SEVERED = 2.1, 3.2
"""Gaps up to the one width belong to an area, and what is narrower than the other does not, in modules."""
_SMALLEST, _LARGEST = 6.5, 52
"""Sides of an area, in modules."""
_OFF, _OBLONG = (0.78, 1.28), 1.22
"""Sides of modules relative to the nominal one, and largest ratio of a module's sides."""
_FILLED = 0.75
"""Least share of its rectangle that an area fills."""
_CHOSEN = 4
"""Number of sizes and orientations that are fitted to an area."""
_STEPS_PX = (1.6, 0.8, 0.4, 0.2)
_LIKE, _FITS = 0.6, 0.87
"""Least correlation with the pattern of a border before and after it is fitted; full arrays of dots have up to 0.85."""
_MOVED = ((0,), (1,), (2,), (3,), (0, 1), (1, 2), (2, 3), (3, 0), (0, 1, 2, 3))
_MOVES = np.array(
    [
        [[way * (n in corners and axis == k) for k in range(2)] for n in range(4)]
        for corners in _MOVED for axis in range(2) for way in (-1.0, 1.0)
    ]
)  # fmt: skip
"""(n, 4, 2) directions in which the corners of a code are moved to fit it: single ones, sides, and all."""


@dataclass(frozen=True, eq=False)
class DotGrid:
    """What may be a code: its border has the pattern of one."""

    modules: NDArray[np.bool_]
    """(rows, columns), upright; True where there is a dot."""
    corners_px: Floats
    """(4, 2) corners of the outer modules, going round from the code's own top left one."""


class _Pattern(NamedTuple):
    """Places (n) in modules, and what is there: 1 for a dot, -1 for none."""

    x: Floats
    y: Floats
    dot: Floats


def dot_grids(picture: NDArray[np.uint8], module_px: float) -> Iterator[DotGrid]:
    """Yield what may be codes with modules of about `module_px` in a picture (h, w), of light dots or dark ones."""
    h, w = picture.shape
    size = (round(w * _PX / module_px), round(h * _PX / module_px))
    if min(size) < _SMALLEST * _PX:
        return
    shrinks = size[0] < w
    shown = cv2.resize(picture, size, interpolation=cv2.INTER_AREA if shrinks else cv2.INTER_LINEAR)
    smooth = cv2.GaussianBlur(shown, (0, 0), _SMOOTH * _PX)
    # Labels, pads and their edges are wider than a dot: the two filters leave light and dark dots only.
    for filtering in (cv2.MORPH_TOPHAT, cv2.MORPH_BLACKHAT):
        dots = cv2.morphologyEx(smooth, filtering, _disk(_DOT)).astype(np.float32)
        for box in _areas(dots):
            if (fitted := _fitted(dots, box)) is not None:
                modules, corners = fitted
                yield DotGrid(modules, (corners + 0.5) * (w / size[0], h / size[1]) - 0.5)


def _areas(dots: NDArray[np.float32]) -> Iterator[Floats]:
    """Yield rectangles (4, 2) round areas of dots that are as large as a code."""
    # Relative to the dots beside it: the whole picture may have little ground, or be noise in most places.
    strongest = cv2.dilate(dots, np.ones((_odd(_BESIDE), _odd(_BESIDE)), np.uint8))
    marked = (dots > np.maximum(dots.mean() + _MARKED * dots.std(), _STRONG * strongest)).astype(np.uint8)
    room = 2 * _odd(_JOINED)
    joined = cv2.morphologyEx(np.pad(marked, room), cv2.MORPH_CLOSE, _disk(_JOINED))
    outlines, tree = cv2.findContours(joined, cv2.RETR_CCOMP, cv2.CHAIN_APPROX_NONE)
    for n, outline in enumerate(outlines):
        # Holes are left out, not what lies in them: a label is a hole in what surrounds it.
        x, y, w, h = cv2.boundingRect(outline)
        if tree[0][n][3] >= 0 or max(w, h) < _SMALLEST * _PX or max(w, h) > 1.5 * _LARGEST * _PX:
            continue
        area = np.zeros((h + 2, w + 2), np.uint8)
        cv2.drawContours(area, [outline], -1, 1, cv2.FILLED, offset=(1 - x, 1 - y))
        severed = cv2.morphologyEx(area, cv2.MORPH_OPEN, _disk(_SEVERED))
        for part in cv2.findContours(severed, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)[0]:
            rectangle = cv2.minAreaRect(part)
            sides = sorted(rectangle[1])
            if (
                sides[0] >= _SMALLEST * _PX
                and sides[1] <= _LARGEST * _PX
                and cv2.contourArea(cv2.convexHull(part)) >= _FILLED * sides[0] * sides[1]
            ):
                yield np.asarray(cv2.boxPoints(rectangle), np.float64) + (x - 1 - room, y - 1 - room)


def _fitted(dots: NDArray[np.float32], box: Floats) -> tuple[NDArray[np.bool_], Floats] | None:
    """Return the modules and corners of the code whose border fits best to an area; None if none fits."""
    for like, size, corners in sorted(_starts(dots, box), key=lambda start: -start[0])[:_CHOSEN]:
        if like < _LIKE:
            return None
        fitted, fits = _fit(dots, corners, _border(*size), like)
        if fits >= _FITS:
            modules = _sampled(dots, fitted, size)
            aligned = _aligned(dots, fitted, modules)
            return _sampled(dots, aligned, size), aligned
    return None


def _starts(dots: NDArray[np.float32], box: Floats) -> Iterator[tuple[float, tuple[int, int], Floats]]:
    """Yield correlation, size and corners of codes that may fill a rectangle, whose sides may be off by a module."""
    off = np.array([-0.8, 0.0, 0.8]) * _PX
    left, right, up, down = (side.ravel()[:, None] for side in np.meshgrid(off, off, off, off))
    # The corners of the rectangle go round in either direction.
    (ax, ay), (bx, by) = box[1] - box[0], box[3] - box[0]
    ring = box if ax * by > ay * bx else box[::-1]
    for first in _orientations(dots, ring):
        a, b, c, d = np.roll(ring, -first, axis=0)
        width, height = float(np.hypot(*(b - a))), float(np.hypot(*(d - a)))
        across, along = (b - a) / width, (d - a) / height
        moved = (
            a - left * across - up * along, b + right * across - up * along,
            c + right * across + down * along, d - left * across + down * along,
        )  # fmt: skip
        corners = np.stack(moved, axis=1)
        for rows, columns in _SIZES:
            x, y = width / columns / _PX, height / rows / _PX
            if _OFF[0] < min(x, y) and max(x, y) < min(_OFF[1], _OBLONG * min(x, y)):
                like = _likeness(dots, corners, _border(rows, columns))
                best = int(like.argmax())
                yield float(like[best]), (rows, columns), corners[best]


def _orientations(dots: NDArray[np.float32], ring: Floats) -> list[int]:
    """Return the numbers of the two corners that are most likely a code's top left one.

    The left and the lower side of a code have twice as many dots as the others.
    """
    along = np.linspace(0.05, 0.95, 40)
    sides = []
    for n in range(4):
        a, b, c = ring[n], ring[(n + 1) % 4], ring[(n + 2) % 4]
        inward = (c - b) / np.hypot(*(c - b)) * _PX
        # The middle of the outer modules, if the side is where it should be, or off by almost a module.
        places = a + along[:, None] * (b - a) + inward * np.array([-0.3, 0.5, 1.3])[:, None, None]
        x, y = np.moveaxis(places.astype(np.float32), 2, 0)
        values = np.asarray(cv2.remap(dots, x, y, cv2.INTER_LINEAR))
        sides.append(float(values.mean(1).max()))
    return sorted(range(4), key=lambda first: -sides[first - 2] - sides[first - 1])[:2]


def _fit(dots: NDArray[np.float32], corners: Floats, border: _Pattern, like: float) -> tuple[Floats, float]:
    """Move corners while that makes a border more like its pattern; return them and their correlation."""
    for step in _STEPS_PX:
        for _ in range(4):
            moved = corners + step * _MOVES
            likeness = _likeness(dots, moved, border)
            best = int(likeness.argmax())
            if likeness[best] <= like:
                break
            corners, like = moved[best], float(likeness[best])
    return corners, like


def _aligned(dots: NDArray[np.float32], corners: Floats, modules: NDArray[np.bool_]) -> Floats:
    """Return the corners at which a picture of all modules, not only of the border, is most like the dots."""
    rows, columns = modules.shape
    drawn = np.kron(np.pad(modules, 1), np.ones((_PX, _PX))).astype(np.float32)
    # The first pixel's centre is half a pixel inside the margin of one module.
    unit_from_drawn = np.array([[1, 0, 0.5 - _PX], [0, 1, 0.5 - _PX], [0, 0, 1]]) / [[_PX * columns], [_PX * rows], [1]]
    start = rectangle_homographies(_UNIT, corners[None])[0] @ unit_from_drawn
    ends = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 30, 1e-4)
    try:
        _, moved = cv2.findTransformECC(
            drawn, dots, (start / start[2, 2]).astype(np.float32), cv2.MOTION_HOMOGRAPHY, ends, None, _PX + 1
        )
    except cv2.error:  # it does not converge
        return corners
    aligned = apply(np.asarray(moved, np.float64) @ np.linalg.inv(unit_from_drawn), _UNIT[0])
    return aligned if np.abs(aligned - corners).max() < _PX else corners


def _sampled(dots: NDArray[np.float32], corners: Floats, size: tuple[int, int]) -> NDArray[np.bool_]:
    """Return where there are dots, with the border as it must be."""
    rows, columns = size
    y, x = (np.indices(size).reshape(2, -1) + 0.5) / [[rows], [columns]]
    border = _border(rows, columns)
    edge = _values(dots, corners[None], border)[0]
    level = (edge[border.dot > 0].mean() + edge[border.dot < 0].mean()) / 2
    found = _values(dots, corners[None], _Pattern(x, y, x))[0].reshape(size) > level
    known = _known(rows, columns)[1:-1, 1:-1]
    return np.where(known == 0, found, known > 0)


def _known(rows: int, columns: int) -> NDArray[np.int8]:
    """Return what is known of any code and of the modules round it: 1 for a dot, -1 for none, 0 for data."""
    known = np.full((rows + 2, columns + 2), -1, np.int8)
    known[1:-1, 1:-1] = 0
    known[1, 1:-1] = 1 - 2 * (np.arange(columns) % 2)
    known[1:-1, -2] = 2 * (np.arange(rows) % 2) - 1
    known[1:-1, 1] = known[-2, 1:-1] = 1
    return known


@lru_cache
def _border(rows: int, columns: int) -> _Pattern:
    """Return the pattern that all codes of a size have: two solid sides, two of every other module, and a margin."""
    known = _known(rows, columns)
    y, x = np.nonzero(known)
    return _Pattern((x - 0.5) / columns, (y - 0.5) / rows, known[y, x].astype(np.float64))


def _likeness(dots: NDArray[np.float32], corners: Floats, border: _Pattern) -> Floats:
    """Return the correlations of a picture with a pattern that has its corners at (n, 4, 2)."""
    values = _values(dots, corners, border)
    values -= values.mean(1, keepdims=True)
    pattern = border.dot - border.dot.mean()
    return np.asarray(values @ pattern / (np.linalg.norm(values, axis=1) * np.linalg.norm(pattern) + 1e-9))


def _values(dots: NDArray[np.float32], corners: Floats, pattern: _Pattern) -> Floats:
    """Return the pixels (n, places) at the places of a pattern that has its corners at (n, 4, 2)."""
    places = np.stack([pattern.x, pattern.y, np.ones_like(pattern.x)])
    x, y, scale = np.moveaxis(rectangle_homographies(_UNIT, corners) @ places, 1, 0)
    at = (x / scale).astype(np.float32), (y / scale).astype(np.float32)
    return np.asarray(cv2.remap(dots, *at, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE), np.float64)


def _odd(modules: float) -> int:
    """Return the nearest odd number of pixels."""
    return 2 * round((modules * _PX - 1) / 2) + 1


def _disk(modules: float) -> NDArray[np.uint8]:
    size = _odd(modules)
    return np.asarray(cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (size, size)), np.uint8)
