"""Heights of components above the board, computed from the links on their bodies.

The adjustment estimates a height for every component, so that links on components do not disturb the other unknowns.
For this purpose it is irrelevant whether a link lies on the body, on a lead, or on the board between leads. The height
of the body, however, must come from links on the body. With the adjusted motion and surface, each such link gives one
estimate h of the height, with variance σ²:

    h = −(l·W·r) / (l·W·l),    σ² = 1 / (l·W·l),

where r is the residual that the link has on the board's surface, l the change of r per mm of height, and W the inverse
covariance of r. The height of a component is that of its highest group of links that agree with one another.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from vaoi_station.compiled import compiled
from vaoi_station.geometry.transforms import Floats
from vaoi_station.stitching.adjustment.observations import Ints
from vaoi_station.stitching.adjustment.problem import AdjustmentResult, Problem
from vaoi_station.stitching.board.board_plane import BoardPlane
from vaoi_station.stitching.matching.patches import PATCH_PX

_CORE = 0.8
"""Share of a footprint's width and height that counts as body. Leads lie at the edge of the footprint."""
_WORST_MM = 0.5
"""Standard deviation of a height by one link from which on the link is left out."""
_ASIDE = 3.5
"""Residual, in standard deviations, in the direction that no height explains, from which on a link is left out."""
_AGREE = 2.5
"""Largest difference between two heights that agree, in standard deviations."""
_SCATTER_MM = 0.03
"""Standard deviation of the height over one body, since bodies are not flat."""
_LEAST_LINKS, _LEAST_SHARE = 3, 0.25
"""Least number of links in a group, and least share of the links on the body."""
_SHARED_PX = 0.015
"""Error that all links of one pair of frames share. It does not average out."""
_SCALE = 0.01
"""Relative standard deviation of the working distance. All heights scale with the working distance."""


class LinkArrays(NamedTuple):
    """The n links that lie on components, and values of all k links of the problem."""

    number: Ints
    """(n,) index of each among the k links."""
    place_mm: Floats
    """(n, 2) position on the board, tester coordinates."""
    residual_mm: Floats
    """(n, 2) residual that the link has on a flat board in the calibrated plane."""
    lean: Floats
    """(n, 2) change of the residual per mm of height."""
    surface_mm: Floats
    """(k,) height of the board's surface at each link."""
    noise_mm2: Floats
    """(k, 2, 2) covariance of the residual by image noise."""
    px_per_mm: Floats
    """(k,) resolution at each link."""
    component: Ints
    """(k,) number of the component on which each link lies; −1 for none."""


class FootprintArrays(NamedTuple):
    """The footprints of c components, in CAD units and axes."""

    center: Floats
    """(c, 2) centres."""
    size: Floats
    """(c, 2) width and height before rotation."""
    angle_rad: Floats
    """(c,) rotations."""
    mm_per_unit: float


class LinkHeights(NamedTuple):
    """The height of a component by each of n links, with the errors of these heights."""

    mm: Floats
    """(n,) height above the board's surface."""
    sigma_mm: Floats
    """(n,) standard deviation; infinite for a link off the body, or on a body smaller than a patch."""
    shared_mm: Floats
    """(n,) the part of the height's error that all links of the same pair of frames share."""
    aside: Floats
    """(n,) residual that remains at this height, in standard deviations."""


@dataclass(frozen=True)
class Height:
    """The height of one component above the board's surface, its standard deviation, and the number of links used."""

    mm: float
    sigma_mm: float
    links: int


def component_heights(plane: BoardPlane, problem: Problem, adjusted: AdjustmentResult) -> dict[str, Height]:
    """Estimate the heights of components, by address. Components that are smaller than a patch are left out."""
    c, addresses = adjusted.similarity, plane.components.addresses
    if problem.surface is None or c is None or not len(problem.links):
        return {}
    o, motion, index = problem.links, adjusted.motion, plane.components
    near = np.flatnonzero(problem.component >= 0)
    surface_mm = problem.surface.at_links @ adjusted.surface_mm
    a_mm, b_mm = motion.board(o.p[near], o.a_mm[near]), motion.board(o.q[near], o.b_mm[near])
    lean = motion.turned(o.q[near], o.b_lean[near]) - motion.turned(o.p[near], o.a_lean[near])
    links = LinkArrays(near, a_mm, b_mm - a_mm, lean, surface_mm, o.noise_mm2, o.px_per_mm, problem.component)
    footprints = FootprintArrays(index.center, index.size, index.angle_rad, index.mm_per_unit)
    cad_from_board = np.asarray(np.linalg.inv(plane.matrix(c)), np.float64)
    found = per_link_heights(links, footprints, cad_from_board, adjusted.floor_px)
    good = np.flatnonzero((found.sigma_mm < _WORST_MM) & (found.aside < _ASIDE))
    number = problem.component[near[good]]
    # The grouping reads links component by component. A stable sort keeps their order, and so the value of each sum.
    good = good[np.argsort(number, kind="stable")]
    ends = np.cumsum(np.bincount(number, minlength=len(addresses)))
    groups = highest_agreeing_groups(ends, found.mm[good], found.sigma_mm[good], found.shared_mm[good])
    each = zip(addresses, *(values.tolist() for values in groups), strict=True)
    return {address: Height(mm, sigma_mm, links) for address, mm, sigma_mm, links in each if links}


@compiled
def per_link_heights(
    links: LinkArrays, footprints: FootprintArrays, cad_from_board: Floats, floor_px: float
) -> LinkHeights:
    """Estimate the height of a component from each link on it.

    Args:
        links: links on components.
        footprints: footprints of the components.
        cad_from_board: (3, 3) affine matrix, the inverse of C.
        floor_px: scatter of single links in addition to image noise.
    """
    number, place_mm, residual_mm, lean = links.number, links.place_mm, links.residual_mm, links.lean
    surface_mm, noise_mm2, px_per_mm, component = links.surface_mm, links.noise_mm2, links.px_per_mm, links.component
    center, size, angle_rad, mm_per_unit = (
        footprints.center,
        footprints.size,
        footprints.angle_rad,
        footprints.mm_per_unit,
    )
    height, sigma, sole, aside = (
        np.zeros(len(number)),
        np.full(len(number), np.inf),
        np.zeros(len(number)),
        np.zeros(len(number)),
    )
    m = cad_from_board
    for i in range(len(number)):
        n = number[i]
        part, resolution = component[n], px_per_mm[n]
        x = m[0, 0] * place_mm[i, 0] + m[0, 1] * place_mm[i, 1] + m[0, 2] - center[part, 0]
        y = m[1, 0] * place_mm[i, 0] + m[1, 1] * place_mm[i, 1] + m[1, 2] - center[part, 1]
        cos, sin = math.cos(angle_rad[part]), math.sin(angle_rad[part])
        w, h = size[part, 0], size[part, 1]
        if abs(cos * x + sin * y) > _CORE / 2 * w or abs(cos * y - sin * x) > _CORE / 2 * h:
            continue
        # A patch wider than the body also shows the board beside it, and would measure a mixture of both heights.
        if min(w, h) * mm_per_unit * resolution < PATCH_PX:
            continue
        lx, ly = lean[i, 0], lean[i, 1]
        rx, ry = residual_mm[i, 0] + lx * surface_mm[n], residual_mm[i, 1] + ly * surface_mm[n]
        floor = (floor_px / resolution) ** 2
        a, b, d = noise_mm2[n, 0, 0] + floor, noise_mm2[n, 0, 1], noise_mm2[n, 1, 1] + floor
        det = a * d - b * b
        ax, ay = (d * lx - b * ly) / det, (a * ly - b * lx) / det
        # If both frames see the body under the same angle, l vanishes. The large sigma then exceeds `_WORST_MM`.
        information = max(ax * lx + ay * ly, 1e-12)
        height[i] = -(ax * rx + ay * ry) / information
        rx, ry = rx + lx * height[i], ry + ly * height[i]
        aside[i] = math.sqrt(max((d * rx * rx - 2 * b * rx * ry + a * ry * ry) / det, 0.0))
        sigma[i] = 1 / math.sqrt(information)
        sole[i] = _SHARED_PX / resolution / max(math.hypot(lx, ly), 1e-9)
    return LinkHeights(height, sigma, sole, aside)


@compiled
def highest_agreeing_groups(
    ends: Ints, height: Floats, sigma: Floats, shared_mm: Floats
) -> tuple[Floats, Floats, Ints]:
    """Find the highest group of agreeing links of every component.

    Args:
        ends: (n,) for n components, the index after the last link of each. Links are ordered by component.
        height: (k,) mm, height by each of k links.
        sigma: (k,) mm, standard deviation of each height.
        shared_mm: (k,) the part of its error that all links of the same pair of frames share.

    Returns:
        Height (n,) in mm, its standard deviation (n,), and the number of links in the group (n,). All are 0 for a
        component without agreeing links.
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
            # The highest group counts, not the largest: leads, and the board between them, may have more links.
            if count >= least and (links[part] == 0 or total / weight > mm[part]):
                mm[part], spread[part], links[part] = total / weight, 1 / weight, count
        if links[part]:
            shared = np.sort(shared_mm[begin:first])
            middle = (shared[(n - 1) // 2] + shared[n // 2]) / 2
            spread[part] = math.sqrt(spread[part] + middle**2 + (_SCALE * mm[part]) ** 2)
    return mm, spread, links
