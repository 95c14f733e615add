"""How high components stand above the board, from links on their bodies.

The adjustment gives every component a height so that its links do no harm; which of a part's links it
follows (those on the body, on leads, on the board between them) does not matter there. Here it does: with
motion and surface as adjusted, every link within the body tells a height of its own,

    h = −(l·W·r) / (l·W·l),    σ² = 1 / (l·W·l),

r being its misfit on the board's surface, l how far it moves per mm, W the inverse of its covariance. The
height of a part is that of the highest group of links that agree.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from vaoi_station.compiled import compiled
from vaoi_station.geometry.transforms import Floats
from vaoi_station.stitching.adjustment.observations import Ints
from vaoi_station.stitching.adjustment.problem import AdjustmentResult, Problem
from vaoi_station.stitching.board.board_plane import BoardPlane
from vaoi_station.stitching.matching.patches import PATCH_PX

_CORE = 0.8
"""Share of a footprint's width and height that is taken for body; leads are at its edge."""
_WORST_MM = 0.5
"""Links that tell no better are left out (1 σ)."""
_ASIDE = 3.5
"""So are those that are off in the direction no height explains, in standard deviations."""
_AGREE = 2.5
_SCATTER_MM = 0.03
"""Bodies are not flat."""
_LEAST_LINKS, _LEAST_SHARE = 3, 0.25
"""What makes a group: so many links, and such a share of those on the body."""
_SHARED_PX = 0.015
"""What the links of one pair of frames share and does not average out."""
_SCALE = 0.01
"""How well the working distance is known, relative."""


@dataclass(frozen=True)
class Height:
    """Of one component above the board's surface."""

    mm: float
    sigma_mm: float
    links: int


def component_heights(plane: BoardPlane, problem: Problem, adjusted: AdjustmentResult) -> dict[str, Height]:
    """Heights by address, of those parts whose links tell; small parts, which no patch fits on, have none."""
    c, addresses = adjusted.similarity, plane.components.addresses
    if problem.surface is None or c is None or not len(problem.links):
        return {}
    o, motion, parts = problem.links, adjusted.motion, plane.components
    near = np.flatnonzero(problem.component >= 0)
    ground = problem.surface.at_links @ adjusted.surface_mm
    a_mm, b_mm = motion.board(o.p[near], o.a_mm[near]), motion.board(o.q[near], o.b_mm[near])
    lean = motion.turned(o.q[near], o.b_lean[near]) - motion.turned(o.p[near], o.a_lean[near])
    height, sigma, sole, aside = told(
        *(near, a_mm, b_mm - a_mm, lean, ground, o.noise_mm2, o.px_per_mm, problem.component),
        *(np.asarray(np.linalg.inv(plane.matrix(c)), np.float64), parts.center, parts.size, parts.angle_rad),
        *(parts.mm_per_unit, adjusted.floor_px),
    )
    good = np.flatnonzero((sigma < _WORST_MM) & (aside < _ASIDE))
    number = problem.component[near[good]]
    good = good[np.argsort(number, kind="stable")]
    of_part = np.cumsum(np.bincount(number, minlength=len(addresses)))
    found = highest(of_part, height[good], sigma[good], sole[good])
    each = zip(addresses, *(values.tolist() for values in found), strict=True)
    return {address: Height(mm, sigma_mm, links) for address, mm, sigma_mm, links in each if links}


@compiled
def told(
    near: Ints,
    place_mm: Floats,
    misfit_mm: Floats,
    lean: Floats,
    ground_mm: Floats,
    noise_mm2: Floats,
    px_per_mm: Floats,
    component: Ints,
    cad_from_board: Floats,
    center: Floats,
    size: Floats,
    angle_rad: Floats,
    mm_per_unit: float,
    floor_px: float,
) -> tuple[Floats, Floats, Floats, Floats]:
    """What links tell of the height of the component they lie on.

    Args:
        near: (n,) numbers of links that lie on components.
        place_mm: (n, 2) of theirs on the board, tester coordinates.
        misfit_mm: (n, 2) of theirs, were the board flat.
        lean: (n, 2) how the misfit changes per mm of height.
        ground_mm: (k,) height of the board at each link.
        noise_mm2: (k, 2, 2) covariance by image noise.
        px_per_mm: (k,) resolution.
        component: (k,) its number.
        cad_from_board: (3, 3) affine, the inverse of C.
        center: (c, 2) of components, CAD units; as are `size` (c, 2) and, in CAD's axes, `angle_rad` (c,).
        size: width and height.
        angle_rad: by which they are turned.
        mm_per_unit: of CAD.
        floor_px: what single links scatter beyond noise.

    Returns:
        Height (n,) mm, its standard deviation (n,), what pairs of frames share of that (n,), and how far the link is
        off in the direction no height explains (n,), σ. Links that do not lie well within a body on which a patch fits
        have an infinite standard deviation.
    """
    height, sigma, sole, aside = (
        np.zeros(len(near)),
        np.full(len(near), np.inf),
        np.zeros(len(near)),
        np.zeros(len(near)),
    )
    m = cad_from_board
    for i in range(len(near)):
        n = near[i]
        part, resolution = component[n], px_per_mm[n]
        x = m[0, 0] * place_mm[i, 0] + m[0, 1] * place_mm[i, 1] + m[0, 2] - center[part, 0]
        y = m[1, 0] * place_mm[i, 0] + m[1, 1] * place_mm[i, 1] + m[1, 2] - center[part, 1]
        cos, sin = math.cos(angle_rad[part]), math.sin(angle_rad[part])
        w, h = size[part, 0], size[part, 1]
        if abs(cos * x + sin * y) > _CORE / 2 * w or abs(cos * y - sin * x) > _CORE / 2 * h:
            continue
        if min(w, h) * mm_per_unit * resolution < PATCH_PX:
            continue
        lx, ly = lean[i, 0], lean[i, 1]
        rx, ry = misfit_mm[i, 0] + lx * ground_mm[n], misfit_mm[i, 1] + ly * ground_mm[n]
        floor = (floor_px / resolution) ** 2
        a, b, d = noise_mm2[n, 0, 0] + floor, noise_mm2[n, 0, 1], noise_mm2[n, 1, 1] + floor
        det = a * d - b * b
        ax, ay = (d * lx - b * ly) / det, (a * ly - b * lx) / det
        information = max(ax * lx + ay * ly, 1e-12)
        height[i] = -(ax * rx + ay * ry) / information
        rx, ry = rx + lx * height[i], ry + ly * height[i]
        aside[i] = math.sqrt(max((d * rx * rx - 2 * b * rx * ry + a * ry * ry) / det, 0.0))
        sigma[i] = 1 / math.sqrt(information)
        sole[i] = _SHARED_PX / resolution / max(math.hypot(lx, ly), 1e-9)
    return height, sigma, sole, aside


@compiled
def highest(ends: Ints, height: Floats, sigma: Floats, shared_mm: Floats) -> tuple[Floats, Floats, Ints]:
    """Of every part the highest group of links that agree.

    Args:
        ends: (n,) where the links of each part end; they stand one part after the other.
        height: (k,) mm that each link tells.
        sigma: (k,) its standard deviation.
        shared_mm: (k,) what the links of one pair of frames share of that.

    Returns:
        Height (n,) in mm, its standard deviation (n,), and how many links say so (n,); 0 where none agree.
    """
    mm, spread, links = np.zeros(len(ends)), np.zeros(len(ends)), np.zeros(len(ends), np.int64)
    first = 0
    for part in range(len(ends)):
        begin, first = first, ends[part]
        n = first - begin
        least = max(float(_LEAST_LINKS), _LEAST_SHARE * n)
        if n < least:
            continue
        for i in range(begin, first):
            count, weight, total = 0, 0.0, 0.0
            for j in range(begin, first):
                variance = sigma[j] ** 2 + _SCATTER_MM**2
                if abs(height[j] - height[i]) <= _AGREE * math.sqrt(variance):
                    count, weight, total = count + 1, weight + 1 / variance, total + height[j] / variance
            if count >= least and (links[part] == 0 or total / weight > mm[part]):
                mm[part], spread[part], links[part] = total / weight, 1 / weight, count
        if links[part]:
            shared = np.sort(shared_mm[begin:first])
            middle = (shared[(n - 1) // 2] + shared[n // 2]) / 2
            spread[part] = math.sqrt(spread[part] + middle**2 + (_SCALE * mm[part]) ** 2)
    return mm, spread, links
