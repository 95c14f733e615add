"""Centre of a disc from those parts of its edge beside which the light is that of the rest of the mark.

A smudge, a cover or a glint lies on one side of a mark. In each direction, the place of the edge follows from the grey
levels just inside and just outside it, so that another light there does not displace it. Directions whose levels differ
from those of the others lose their part. What is left out in turn, one eighth of the directions, shows the error.
"""

from __future__ import annotations

import math

import cv2
import numpy as np
from numpy.typing import NDArray

from vaoi_station.geometry.transforms import Floats

_STEP_PX, _LEAST_REACH_PX, _BLURS, _LARGEST_REACH = 0.5, 3.0, 3.0, 0.8
"""Distance of samples across the edge, px; how far they reach to either side: least, px, in standard deviations of the
blur, and at most as a share of the radius."""
_LEVEL_SHARE = 0.3
"""Share of the samples at either end that show the grey level there."""
_ALIKE, _PER_LEVEL_PX = (0.02, 0.08, 0.25), 1.0
"""Differences of a level from those of the other directions, as a share of the contrast, that are accepted in turn,
until enough directions are left; and displacement of an edge by the border of a smudge, px per share of the contrast.
Measured: 0.8 px at most on painted marks."""
_COMMON_LEVEL = 0.12
"""Largest median of these differences: beyond it, what differs is no part of the mark but its light. Smudges of painted
and filmed marks leave 0.02 to 0.08; a low lamp from one side, which also displaces the edges, 0.19 to 0.22."""
_LEAST_CLEAN, _WIDEST_GAP = 0.5, 5 / 12
"""Least share of directions that are clean, and the widest gap between two of them as a share of the circle."""
_ROUNDS, _KNEE, _BLOCKS = 6, 3.0, 8
_LEAST_EDGE_PX = 0.01
"""Least scatter of the edge in one direction, px."""
_COMMON = 2.0
"""Factor on the error that the blocks show: all sightings of a mark share it, and are counted as independent."""


def centre_by_clean_edges(
    image: NDArray[np.uint8], px: tuple[float, float], radius: float, blur_px: float
) -> tuple[Floats, float] | None:
    """Return the centre (2,) of a disc near `px` and its standard deviation per axis; None if too little is clean."""
    each = (_centre(image, px, radius, blur_px, alike) for alike in _ALIKE)
    return next((found for found in each if found is not None), None)


def _centre(
    image: NDArray[np.uint8], px: tuple[float, float], radius: float, blur_px: float, alike: float
) -> tuple[Floats, float] | None:
    reach = min(max(_LEAST_REACH_PX, _BLURS * blur_px), _LARGEST_REACH * radius)
    across = np.arange(-reach, reach + _STEP_PX / 2, _STEP_PX)
    count = 8 * math.ceil(2 * math.pi * radius / 8)
    angle = 2 * np.pi * np.arange(count) / count
    way, ends = np.column_stack([np.cos(angle), np.sin(angle)]), max(round(_LEVEL_SHARE * len(across)), 2)
    light = np.column_stack([np.ones(count), way])
    centre, solved, clean, off = np.array(px), np.zeros(3), np.ones(count), np.zeros(count)
    for _ in range(_ROUNDS):
        at = centre + (radius + across)[:, None, None] * way
        # OpenCV 5 samples linear positions exactly.
        x, y = at[:, :, 0].astype(np.float32), at[:, :, 1].astype(np.float32)
        p = np.asarray(cv2.remap(image, x, y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE), np.float64)
        inside, outside = p[:ends].mean(0), p[-ends:].mean(0)
        contrast = float(np.median(inside - outside))
        if not contrast or outside.min() < 1:
            return None
        # Light that grows across the mark does so on the bare rim too. A smudge on one side of the mark does not.
        even = np.maximum(light @ _gradient(light, outside) / np.median(outside), 0.1)
        levels = [np.abs(level / even - np.median(level / even)) / abs(contrast) for level in (inside, outside)]
        off = np.maximum(*levels)
        clean = 1 / (1 + (off / alike) ** 4)
        # The area under the profile is the way from its inner end to the edge, whatever the blur is.
        step = (inside - outside)[None]
        share = (p - outside) / np.where(np.abs(step) > abs(contrast) / 4, step, np.inf)
        edge = share.sum(0) * _STEP_PX - reach
        clean = clean * (np.abs(step[0]) > abs(contrast) / 2)
        if not _enough(clean):
            return None
        # unknowns: shift of the centre, and error of the radius
        solved, weight = _fitted(np.column_stack([way, np.ones(count)]), edge, clean)
        centre = centre + solved[:2]
        if np.hypot(*solved[:2]) < 1e-3:
            break
    if not _enough(weight) or np.median(off) > _COMMON_LEVEL or np.hypot(*(centre - px)) > radius / 3:
        return None
    block = np.arange(count) * _BLOCKS // count
    j = np.column_stack([way, np.ones(count)])
    without = np.array([_fitted(j, edge, clean * (block != b))[0][:2] for b in range(_BLOCKS)])
    spread = np.sqrt((_BLOCKS - 1) / _BLOCKS * ((without - without.mean(0)) ** 2).sum(0))
    unlike = float(np.sqrt((weight * off**2).sum() / weight.sum()))
    return centre, math.hypot(_COMMON * float(spread.max()), _PER_LEVEL_PX * unlike)


def _gradient(light: Floats, level: Floats) -> Floats:
    """Fit a constant and a gradient across the mark to the levels (k,) of most directions."""
    fit: Floats = np.array([float(np.median(level)), 0.0, 0.0])
    for _ in range(_ROUNDS):
        off = level - light @ fit
        scale = max(1.4826 * float(np.median(np.abs(off))), 0.5)
        weight = 1 / (1 + (off / (_KNEE * scale)) ** 2) ** 2
        fit = np.asarray(np.linalg.lstsq(light * weight[:, None], level * weight, rcond=None)[0], np.float64)
    return fit


def _fitted(j: Floats, edge: Floats, clean: Floats) -> tuple[Floats, Floats]:
    """Fit the unknowns of `j` (k, 3) to the edge (k,); return them, and the weights (k,) that directions had in it."""
    weight: Floats = clean
    solved: Floats = np.zeros(3)
    for _ in range(_ROUNDS):
        normal = (j * weight[:, None]).T @ j + 1e-9 * np.eye(3)
        solved = np.asarray(np.linalg.solve(normal, j.T @ (weight * edge)), np.float64)
        off = np.abs(edge - j @ solved)
        order = np.argsort(off)
        half = order[np.searchsorted(np.cumsum(clean[order]), clean.sum() / 2)]
        scale = max(1.4826 * float(off[half]), _LEAST_EDGE_PX)
        weight = clean / (1 + (off / (_KNEE * scale)) ** 2) ** 2
    return solved, weight


def _enough(weight: Floats) -> bool:
    """Return whether directions with the weights (k,) 0 to 1 surround the mark."""
    used = np.flatnonzero(weight > 0.5)
    if len(used) < _LEAST_CLEAN * len(weight):
        return False
    return int(np.diff(np.append(used, used[0] + len(weight))).max()) <= _WIDEST_GAP * len(weight)
