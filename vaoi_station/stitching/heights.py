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
from vaoi_station.geometry.transforms import Floats, apply
from vaoi_station.stitching.cad import Frame
from vaoi_station.stitching.observations import Ints
from vaoi_station.stitching.patches import PATCH_PX
from vaoi_station.stitching.problem import Adjusted, Problem

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


def component_heights(frame: Frame, problem: Problem, adjusted: Adjusted) -> dict[str, Height]:
    """Heights by address, of those parts whose links tell; small parts, which no patch fits on, have none."""
    c, addresses = adjusted.similarity, frame.parts.addresses
    if problem.surface is None or c is None or not len(problem.links):
        return {}
    near = np.flatnonzero(problem.component >= 0)
    near = near[_on_body(frame, c, problem, adjusted, near)]
    height, sigma, sole, aside = _told(problem, adjusted, near)
    good = np.flatnonzero((sigma < _WORST_MM) & (aside < _ASIDE))
    number = problem.component[near[good]]
    good = good[np.argsort(number, kind="stable")]
    of_part = np.cumsum(np.bincount(number, minlength=len(addresses)))
    found = highest(of_part, height[good], sigma[good], sole[good])
    each = zip(addresses, *(values.tolist() for values in found), strict=True)
    return {address: Height(mm, sigma_mm, links) for address, mm, sigma_mm, links in each if links}


def _on_body(frame: Frame, c: Floats, problem: Problem, adjusted: Adjusted, at: Ints) -> np.ndarray:
    """Which of some links lie well within the body of their component, and whether a patch fits on that."""
    o, parts = problem.links, frame.parts
    place = apply(np.linalg.inv(frame.matrix(c)), adjusted.motion.board(o.p[at], o.a_mm[at]))
    number = problem.component[at]
    d, size = place - parts.center[number], parts.size[number]
    cos, sin = np.cos(parts.angle_rad)[number], np.sin(parts.angle_rad)[number]
    offset = np.stack([cos * d[:, 0] + sin * d[:, 1], cos * d[:, 1] - sin * d[:, 0]], -1)
    room_px = size.min(1) * parts.mm_per_unit * o.px_per_mm[at]
    return np.asarray((np.abs(offset) <= _CORE / 2 * size).all(1) & (room_px >= PATCH_PX))


def _told(problem: Problem, adjusted: Adjusted, at: Ints) -> tuple[Floats, Floats, Floats, Floats]:
    """Of some links: height mm, its standard deviation, what pairs of frames share of that, and what is left (σ)."""
    assert problem.surface is not None
    o, motion = problem.links, adjusted.motion
    p, q = o.p[at], o.q[at]
    lean = motion.turned(q, o.b_lean[at]) - motion.turned(p, o.a_lean[at])
    ground = problem.surface.at_links[at] @ adjusted.surface_mm
    misfit = motion.board(q, o.b_mm[at]) - motion.board(p, o.a_mm[at]) + lean * ground[:, None]
    floor = (adjusted.floor_px / o.px_per_mm[at]) ** 2
    a, b, d = o.noise_mm2[at, 0, 0] + floor, o.noise_mm2[at, 0, 1], o.noise_mm2[at, 1, 1] + floor
    weight = np.stack([d, -b, a], -1) / (a * d - b * b)[:, None]
    information = np.maximum(_product(lean, weight, lean), 1e-12)
    height = -_product(lean, weight, misfit) / information
    left = misfit + lean * height[:, None]
    aside = np.sqrt(np.maximum(_product(left, weight, left), 0))
    shared = _SHARED_PX / o.px_per_mm[at] / np.maximum(np.hypot(*lean.T), 1e-9)
    return height, 1 / np.sqrt(information), shared, aside


def _product(u: Floats, weight: Floats, v: Floats) -> Floats:
    """uᵀ·W·v (k,) of vectors (k, 2) and symmetric matrices (k, 3): xx, xy, yy."""
    (ux, uy), (vx, vy), (xx, xy, yy) = u.T, v.T, weight.T
    return np.asarray(ux * (xx * vx + xy * vy) + uy * (xy * vx + yy * vy))


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
