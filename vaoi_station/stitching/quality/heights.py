"""Heights of components above the board, computed from the links on their bodies.

The adjustment estimates a height for every component, so that links on components do not disturb the other unknowns.
For that purpose, a link may lie on the body, on a lead, or on the board between leads. The height of the body, however,
must come from links on the body. With the adjusted motion and surface, each link on a component gives one estimate h of
the height, with variance σ²:

    h = −(l·W·r) / (l·W·l),    σ² = 1 / (l·W·l),

where r is the residual that the link has on the board's surface, l the change of r per mm of height, and W the inverse
covariance of r. `body_heights.py` then decides which links lie on the body.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from vaoi_station.compiled import compiled
from vaoi_station.geometry.transforms import Floats
from vaoi_station.stitching.adjustment.problem import AdjustmentResult, Ints, Problem
from vaoi_station.stitching.board.board_plane import BoardPlane
from vaoi_station.stitching.matching.refinement import WINDOW_PX
from vaoi_station.stitching.quality.body_heights import BodyLinks, body_heights

_WORST_MM = 0.5
"""Links whose height has a standard deviation of more than this are left out."""
_ASIDE = 3.5
"""Links with a larger residual than this in the direction that no height explains are left out; in standard
deviations."""
_SHARED_PX, _SHARED_FLOOR = (0.004, 0.015), (0.5, 1.0)
"""Error that all links of one pair of frames on one component have in common, because neighbouring links err alike.

It is the larger of a constant, `_SHARED_PX`, and of a multiple, `_SHARED_FLOOR`, of the run's noise floor. Each has two
values: for two rows of one camera, and for two cameras."""
_PATCH_PX = WINDOW_PX / 2 + 1
"""Distance from the centre of a patch to its edge. Its blur extends further, but with little weight."""


class LinkArrays(NamedTuple):
    """The n links that lie on components, together with arrays over all k links of the problem."""

    number: Ints
    """(n,) index of each of these links among the k links."""
    place_mm: Floats
    """(n, 2) position on the board of a point in the calibrated plane, tester coordinates."""
    place_lean: Floats
    """(n, 2) change of `place_mm` per mm of height."""
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
    across: NDArray[np.bool_]
    """(k,) whether each link connects two cameras; otherwise it connects two rows."""


class FootprintArrays(NamedTuple):
    """The footprints of c components, in CAD units and axes."""

    center: Floats
    """(c, 2) centres of the footprints."""
    angle_rad: Floats
    """(c,) rotations of the footprints."""
    mm_per_unit: float


class LinkHeights(NamedTuple):
    """The height of a component by each of n links, with the errors of these heights."""

    mm: Floats
    """(n,) height of the component above the board's surface by each link."""
    sigma_mm: Floats
    """(n,) standard deviation of the height by each link."""
    shared_mm: Floats
    """(n,) part of the height's standard deviation that all links of one pair of frames have in common."""
    aside: Floats
    """(n,) length of the part of the residual that no height explains, in standard deviations."""
    place_mm: Floats
    """(n, 2) centre of the patch at this height, relative to the centre of the footprint, along its width and
    height."""
    reach_mm: Floats
    """(n,) distance from the centre of the patch to its edge, mm, along the width and height of the footprint."""


@dataclass(frozen=True)
class Height:
    """The height of one component above the board's surface, its standard deviation, and the number of links used."""

    mm: float
    sigma_mm: float
    links: int


def component_heights(plane: BoardPlane, problem: Problem, adjusted: AdjustmentResult) -> dict[str, Height]:
    """Estimate the heights of components, by address. Components of unknown height are left out."""
    c, addresses = adjusted.similarity, plane.components.addresses
    if problem.surface is None or c is None or not len(problem.links):
        return {}
    o, motion, index = problem.links, adjusted.motion, plane.components
    near = np.flatnonzero(problem.component >= 0)
    surface_mm = problem.surface.at_links @ adjusted.surface_mm
    a_mm, b_mm = motion.board(o.p[near], o.a_mm[near]), motion.board(o.q[near], o.b_mm[near])
    a_lean, b_lean = motion.turned(o.p[near], o.a_lean[near]), motion.turned(o.q[near], o.b_lean[near])
    links = LinkArrays(
        near,
        a_mm,
        a_lean,
        b_mm - a_mm,
        b_lean - a_lean,
        surface_mm,
        o.noise_mm2,
        o.px_per_mm,
        problem.component,
        o.p == o.q,
    )
    footprints = FootprintArrays(index.center, index.angle_rad, index.mm_per_unit)
    cad_from_board = np.asarray(np.linalg.inv(plane.matrix(c)), np.float64)
    found = per_link_heights(links, footprints, cad_from_board, adjusted.floor_px)
    good = np.flatnonzero((found.sigma_mm < _WORST_MM) & (found.aside < _ASIDE))
    number = problem.component[near[good]]
    # Two cameras see a component under the same light and angles in every row: all their links have one error in
    # common.
    pair = np.where(links.across, -1, o.group)[near[good]]
    order = np.lexsort((pair, number))
    good, pair = good[order], pair[order]
    ends = np.cumsum(np.bincount(number, minlength=len(addresses)))
    on = BodyLinks(
        found.mm[good],
        found.sigma_mm[good],
        found.shared_mm[good],
        pair,
        found.place_mm[good],
        found.reach_mm[good],
    )
    bodies = body_heights(ends, on, index.size * (index.mm_per_unit / 2))
    each = zip(addresses, *(values.tolist() for values in bodies), strict=True)
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
    center, angle_rad, mm_per_unit = footprints.center, footprints.angle_rad, footprints.mm_per_unit
    count, m = len(number), cad_from_board
    height, sigma, sole, aside = np.zeros(count), np.zeros(count), np.zeros(count), np.zeros(count)
    place, reach = np.zeros((count, 2)), np.zeros(count)
    for i in range(count):
        n = number[i]
        part, resolution = component[n], px_per_mm[n]
        lx, ly = lean[i, 0], lean[i, 1]
        rx, ry = residual_mm[i, 0] + lx * surface_mm[n], residual_mm[i, 1] + ly * surface_mm[n]
        floor = (floor_px / resolution) ** 2
        a, b, d = noise_mm2[n, 0, 0] + floor, noise_mm2[n, 0, 1], noise_mm2[n, 1, 1] + floor
        det = a * d - b * b
        ax, ay = (d * lx - b * ly) / det, (a * ly - b * lx) / det
        # If both frames see the body under the same angle, l is almost 0. The large sigma then exceeds `_WORST_MM`.
        information = max(ax * lx + ay * ly, 1e-12)
        height[i] = -(ax * rx + ay * ry) / information
        rx, ry = rx + lx * height[i], ry + ly * height[i]
        aside[i] = math.sqrt(max((d * rx * rx - 2 * b * rx * ry + a * ry * ry) / det, 0.0))
        sigma[i] = 1 / math.sqrt(information)
        kind = 1 if links.across[n] else 0
        shared_px = max(_SHARED_PX[kind], _SHARED_FLOOR[kind] * floor_px)
        sole[i] = shared_px / resolution / max(math.hypot(lx, ly), 1e-9)
        above = surface_mm[n] + height[i]
        px, py = place_mm[i, 0] + links.place_lean[i, 0] * above, place_mm[i, 1] + links.place_lean[i, 1] * above
        x = (m[0, 0] * px + m[0, 1] * py + m[0, 2] - center[part, 0]) * mm_per_unit
        y = (m[1, 0] * px + m[1, 1] * py + m[1, 2] - center[part, 1]) * mm_per_unit
        cos, sin = math.cos(angle_rad[part]), math.sin(angle_rad[part])
        place[i, 0], place[i, 1] = cos * x + sin * y, cos * y - sin * x
        # The patch is a square along the tester axes. Its corners extend furthest in a footprint that is turned by 45°.
        gx, gy = cos * m[0, 0] + sin * m[1, 0], cos * m[0, 1] + sin * m[1, 1]
        reach[i] = _PATCH_PX / resolution * mm_per_unit * (abs(gx) + abs(gy))
    return LinkHeights(height, sigma, sole, aside, place, reach)
