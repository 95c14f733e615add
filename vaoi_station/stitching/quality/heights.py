"""Heights of components above the board, from the links on their bodies.

A footprint covers body, leads, pads and bare board; how much of it the body covers is not known. Hypotheses are
compared, each with the *extent* of the body, a rectangle inside the footprint, and its height H. A link wholly in the
extent measures H (rarely a place below the top); one wholly beside it measures the board (rarely a lead, between 0 and
H); one across an edge measures anything from 0 to H, with the same likelihood for all, since mixtures on one edge agree
by themselves. Each link may be an outlier.

H is 0 (no body), a height on which several links agree, or none of these. The likelihoods of all extents are summed and
give the probability of H, which is reported only if it is at least `_SURE`.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from vaoi_station.compiled import compiled, inlined
from vaoi_station.geometry.body_extents import EXTENTS
from vaoi_station.geometry.transforms import Floats, apply
from vaoi_station.stitching.adjustment.problem import AdjustmentResult, Ints, Problem
from vaoi_station.stitching.board.board_plane import BoardPlane
from vaoi_station.stitching.matching.refinement import WINDOW_PX

_WORST_MM, _ASIDE = 0.5, 3.5
"""Links with a larger standard deviation are left out, and those with a larger residual, in standard deviations, in the
direction that no height explains."""
_SHARED_PX, _SHARED_FLOOR = np.array([0.004, 0.015]), np.array([0.5, 1.0])
"""Error that all links of one pair of frames on one component have in common: the larger of a constant and of a
multiple of the run's noise floor, each for two rows of one camera and for two cameras."""
_PATCH_PX = WINDOW_PX / 2 + 1
"""Distance from the centre of a patch to its edge."""
_OUTLIER, _INSIDE, _WIDE, _BELOW = 0.05, 0.84, 0.03, 0.05
"""Prior probabilities of an outlier, and of a link inside the extent that it measures H with its stated error, with
three times that error, and a place below the top."""
_OUTSIDE, _LEAD, _ACROSS = 0.85, 0.10, 0.5
"""Prior probabilities that a link outside the extent measures the board, or a lead; likelihood of links across an edge,
relative to the largest of a link that measures a height."""
_FLAT_PRIOR, _RANGE_MM, _WIDTH_MM = 0.1, 5.0, 0.05
"""Prior probability of no body; range over which all other heights are equally probable; heights that differ by less
than the last count as the same."""
_FLAT_MM, _AGREE = 0.06, 2.5
"""Heights below this count as 0, mm; two heights agree up to this, in standard deviations of their difference."""
_SCATTER_MM = 0.006
"""Standard deviation of the height from place to place on one body: bodies are not exactly flat."""
_MOST_HEIGHTS, _SURE, _LEAST_LINKS = 8, 0.99, 2
"""Largest number of heights that are compared, with 0; least probability of a height that is reported, and least number
of links on its body."""
_ELSEWHERE_MM = 1.0
"""Assumed error of the height if "none of these" is true."""
_SCALE = 0.002
"""Relative standard deviation of the working distance, and so of all heights: 1 mm at 483 mm."""
_PEAK = math.sqrt(2 * math.pi)


@dataclass(frozen=True)
class Height:
    """The height of one component above the board's surface, its standard deviation, and the number of links used."""

    mm: float
    sigma_mm: float
    links: int


def component_heights(plane: BoardPlane, problem: Problem, adjusted: AdjustmentResult) -> dict[str, Height]:
    """Estimate the heights of components, by address. Components of unknown height are left out."""
    c, index, o = adjusted.similarity, plane.components, problem.links
    if problem.surface is None or c is None or not len(o):
        return {}
    near = np.flatnonzero(problem.component >= 0)
    by_link, across = adjusted.link_heights(near), (o.p == o.q)[near]
    good = np.flatnonzero((by_link.sigma_mm < _WORST_MM) & (by_link.aside < _ASIDE))
    # Two cameras see a component under the same light and angles in every row: all their links have one error in
    # common.
    number, pair = problem.component[near], np.where(across, -1, o.group[near])
    good = good[np.lexsort((pair[good], number[good]))]
    part, px_per_mm, kind = number[good], o.px_per_mm[near[good]], across[good].astype(np.int_)
    shared_px = np.maximum(_SHARED_PX, _SHARED_FLOOR * adjusted.floor_px)[kind]
    cad_from_board = np.linalg.inv(plane.matrix(c))
    # along the axes of the footprint
    cos, sin = np.cos(index.angle_rad[part]), np.sin(index.angle_rad[part])
    turn = np.moveaxis(np.array([[cos, sin], [-sin, cos]]), 2, 0)
    off = (apply(cad_from_board, by_link.place_mm[good]) - index.center[part]) * index.mm_per_unit
    # The patch is a square along the tester axes. Its corners extend furthest in a footprint that is turned by 45°.
    reach = _PATCH_PX / px_per_mm * index.mm_per_unit * np.abs(turn[:, 0] @ cad_from_board[:2, :2]).sum(1)
    links = BodyLinks(
        by_link.mm[good],
        by_link.sigma_mm[good],
        shared_px / px_per_mm / np.maximum(by_link.lean[good], 1e-9),
        pair[good],
        np.ascontiguousarray((turn @ off[:, :, None])[:, :, 0]),
        reach,
    )
    ends = np.cumsum(np.bincount(part, minlength=len(index.addresses)))
    bodies = body_heights(ends, links, index.size * (index.mm_per_unit / 2))
    each = zip(index.addresses, *(values.tolist() for values in bodies), strict=True)
    return {address: Height(mm, sigma_mm, count) for address, mm, sigma_mm, count in each if count}


class BodyLinks(NamedTuple):
    """The k links on components, ordered by component, then by pair of frames."""

    mm: Floats
    """(k,) height above the board's surface that each link measures."""
    sigma_mm: Floats
    shared_mm: Floats
    """(k,) part of the standard deviation that all links of one pair of frames have in common."""
    pair: Ints
    """(k,) index of the pair of frames; −1 for those of two cameras, which have one error in all rows."""
    place_mm: Floats
    """(k, 2) centre of the patch relative to that of the footprint, along the footprint's width and height."""
    reach_mm: Floats
    """(k,) distance from the centre of the patch to its edge along these axes."""


@compiled
def body_heights(ends: Ints, links: BodyLinks, half_mm: Floats) -> tuple[Floats, Floats, Ints]:
    """Return height, standard deviation and number of links on the body (n,) of components; all 0 where unknown.

    `ends` (n,) are the indices after the last links of the components, `half_mm` (n, 2) half the size of footprints.
    """
    # Loops in place of expressions of arrays: Numba needs ten times as long to compile such expressions.
    mm, spread, count = np.zeros(len(ends)), np.zeros(len(ends)), np.zeros(len(ends), np.int64)
    first = 0
    for part in range(len(ends)):
        begin, first = first, ends[part]
        n = first - begin
        if n < _LEAST_LINKS:
            continue
        h, pair, shared = links.mm[begin:first], links.pair[begin:first], links.shared_mm[begin:first]
        place, reach = links.place_mm[begin:first], links.reach_mm[begin:first]
        noise, s, side = np.empty(n), np.empty(n), np.empty((2, len(EXTENTS), n), np.int64)
        for i in range(n):
            noise[i] = math.hypot(links.sigma_mm[begin + i], _SCATTER_MM)
            s[i] = math.hypot(noise[i], shared[i])
        for axis in range(2):
            _sort_along(place, reach, half_mm, part, axis, side)
        heights = np.zeros(_MOST_HEIGHTS)
        m = _agreed_heights(h, s, heights)
        probability, on_body = np.zeros(m + 1), np.zeros((m + 1, n))
        # The first round sorts the links. The second round repeats this with heights from the links on the body only.
        for _ in range(2):
            _compare(h, s, heights, side, probability, on_body)
            _move(h, noise, heights, on_body)
        _unite(heights, probability, on_body)
        c = 0
        for k in range(m + 1):
            c = k if probability[k] > probability[c] else c
        if c == m or probability[c] < _SURE:
            continue
        weight, total, used = np.empty(n), 0.0, 0
        for i in range(n):
            weight[i] = on_body[c, i] / noise[i] ** 2
            total, used = total + weight[i], used + (on_body[c, i] > 0.5)
        if used < _LEAST_LINKS:
            continue
        for i in range(n):
            weight[i] /= total
            mm[part] += weight[i] * h[i]
        variance = _variance(h, mm[part], noise, weight, pair, shared, place, reach) + (_SCALE * mm[part]) ** 2
        for k in range(m):
            variance += probability[k] * (heights[k] - mm[part]) ** 2 if k != c else 0.0
        spread[part], count[part] = math.sqrt(variance + probability[m] * _ELSEWHERE_MM**2), used
    return mm, spread, count


@inlined
def _sort_along(place: Floats, reach: Floats, half_mm: Floats, part: int, axis: int, side: Ints) -> None:
    """Write to `side[axis]` (k, n) whether n patches lie outside (0), across (1) or inside (2) each of k extents."""
    for e in range(len(EXTENTS)):
        low, high = -EXTENTS[e, 0] * half_mm[part, axis], EXTENTS[e, 1] * half_mm[part, axis]
        for i in range(len(place)):
            a, b = place[i, axis] - reach[i], place[i, axis] + reach[i]
            side[axis, e, i] = 2 if a >= low and b <= high else 0 if b <= low or a >= high else 1


@inlined
def _agreed_heights(h: Floats, s: Floats, heights: Floats) -> int:
    """Write the heights on which links agree to `heights`, 0 first, then those with most links; return their number."""
    free, m = np.ones(len(h), np.bool_), 1
    for i in range(len(h)):
        free[i] = h[i] > max(_AGREE * s[i], _FLAT_MM)
    while m < len(heights):
        best, at = 0, -1
        for i in range(len(h)):
            agree = 0
            for j in range(len(h)):
                agree += free[i] and free[j] and abs(h[j] - h[i]) <= _AGREE * math.hypot(s[i], s[j])
            if agree > best:
                best, at = agree, i
        if at < 0:
            break
        middle, weight, total = h[at], 0.0, 0.0
        for j in range(len(h)):
            if free[j] and abs(h[j] - middle) <= _AGREE * math.hypot(s[at], s[j]):
                weight, total, free[j] = weight + 1 / s[j] ** 2, total + h[j] / s[j] ** 2, False
        heights[m] = total / weight
        m += 1
    return m


@inlined
def _compare(h: Floats, s: Floats, heights: Floats, side: Ints, probability: Floats, on_body: Floats) -> None:
    """Compute the probability (m + 1,) of each height, the last of none, and that (m + 1, n) of links on its body."""
    m, n, k = len(on_body) - 1, len(h), len(EXTENTS)
    log, fit, evidence, best = np.zeros((3, n)), np.zeros(n), np.zeros((k, k)), -np.inf
    scale = np.zeros(m + 1)
    for c in range(m + 1):
        none = c == m
        _link_likelihoods(h, s, _RANGE_MM if none else heights[c], none, log, fit)
        prior = _FLAT_PRIOR if c == 0 else 1 - _FLAT_PRIOR if none else _PEAK * _WIDTH_MM / _RANGE_MM
        highest = -np.inf
        for a in range(k):
            for b in range(k):
                total = math.log(prior * EXTENTS[a, 2] * EXTENTS[b, 2])
                for i in range(n):
                    # a patch is outside if it is outside along one axis, and inside if it is inside along both
                    total += log[min(side[0, a, i], side[1, b, i]), i]
                evidence[a, b] = total
                highest = max(highest, total)
        probability[c], scale[c], best = 0.0, highest, max(best, highest)
        for i in range(n):
            on_body[c, i] = 0.0
        for a in range(k):
            for b in range(k):
                share = math.exp(evidence[a, b] - highest)
                probability[c] += share
                for i in range(n):
                    if side[0, a, i] == 2 and side[1, b, i] == 2:
                        on_body[c, i] += share * fit[i]
        for i in range(n):
            on_body[c, i] /= probability[c]
    total = 0.0
    for c in range(m + 1):
        probability[c] *= math.exp(scale[c] - best)
        total += probability[c]
    for c in range(m + 1):
        probability[c] /= total


@inlined
def _link_likelihoods(h: Floats, s: Floats, top: float, none: bool, log: Floats, fit: Floats) -> None:
    """Write the log likelihoods (3, n) of links outside, across and inside a body of height `top`.

    Also write the probability `fit` (n,) that one inside measures it; with `none`, no link does.
    """
    for i in range(len(h)):
        below, above = -h[i] / s[i], (h[i] - top) / s[i]
        outlier, between = _OUTLIER * _PEAK * s[i] / _RANGE_MM, 0.0
        if below < 2 and above < 2:
            between = _PEAK * s[i] / max(top, 3 * s[i])
        match = 0.0
        if not none:
            match = _INSIDE * math.exp(-above * above / 2) + _WIDE * math.exp(-above * above / 18)
        inside = match + (0.0 if none else _BELOW * between) + outlier
        beyond = max(0.0, below, above)
        log[0, i] = math.log(_OUTSIDE * math.exp(-below * below / 2) + _LEAD * between + outlier)
        log[1, i] = math.log(_ACROSS * math.exp(-beyond * beyond / 2) + outlier)
        log[2, i], fit[i] = math.log(inside), match / inside


@inlined
def _move(h: Floats, noise: Floats, heights: Floats, on_body: Floats) -> None:
    for c in range(1, len(on_body) - 1):
        weight, total = 1e-9, heights[c] * 1e-9
        for i in range(len(h)):
            weight += on_body[c, i] / noise[i] ** 2
            total += on_body[c, i] * h[i] / noise[i] ** 2
        heights[c] = total / weight


@inlined
def _unite(heights: Floats, probability: Floats, on_body: Floats) -> None:
    """Merge heights that differ by less than `_WIDTH_MM` into one, whose probability is the sum of theirs."""
    for c in range(len(on_body) - 1):
        for k in range(len(on_body) - 1):
            if k != c and 0 < probability[k] <= probability[c] and abs(heights[k] - heights[c]) < _WIDTH_MM:
                both = probability[c] + probability[k]
                for i in range(on_body.shape[1]):
                    on_body[c, i] = (probability[c] * on_body[c, i] + probability[k] * on_body[k, i]) / both
                probability[c], probability[k] = both, 0.0


@inlined
def _variance(
    h: Floats, mean: float, noise: Floats, weight: Floats, pair: Ints, shared: Floats, place: Floats, reach: Floats
) -> float:
    """Return the variance (mm²) of the mean of n links' heights with `weight` (n,), whose sum is 1.

    Links of one pair of frames, which are adjacent, have a part of their error in common; those with overlapping
    patches have a part of their noise in common.
    """
    squares, expected, largest = 0.0, 0.0, 0.0
    common, own, group, worst = 0.0, 0.0, 0.0, 0.0
    for i in range(len(h)):
        squares, expected = squares + weight[i] * (h[i] - mean) ** 2, expected + weight[i] * noise[i] ** 2
        largest = max(largest, weight[i] * noise[i] ** 2)
        group, worst = group + weight[i], max(worst, shared[i])
        if i + 1 == len(h) or pair[i + 1] != pair[i]:
            common += (group * worst) ** 2
            group = worst = 0.0
        for j in range(len(h)):
            if pair[i] == pair[j]:
                # The correlation of the noise of two patches is the share of their area that overlaps.
                x, y = abs(place[i, 0] - place[j, 0]), abs(place[i, 1] - place[j, 1])
                overlap = max(0.0, 1 - x / (2 * reach[i])) * max(0.0, 1 - y / (2 * reach[i]))
                own += overlap * weight[i] * noise[i] * weight[j] * noise[j]
    # If the links scatter more than their noise explains, the mean is less accurate too. The scatter is compared with
    # the noise of all links but one, because the mean itself is estimated from the links.
    freedom = max(expected - largest, largest)
    return common + own * max(1.0, squares / max(freedom, 1e-12))
