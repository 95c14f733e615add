"""How high components stand above the board, from links on their bodies.

The adjustment gives every component a height so that its links do no harm; which of a part's links it
follows (those on the body, on leads, on the board between them) does not matter there. Here it does: with
motion and surface as adjusted, every link within the body tells a height of its own,

    h = −(l·W·r) / (l·W·l),    σ² = 1 / (l·W·l),

r being its misfit on the board's surface, l how far it moves per mm, W the inverse of its covariance. The
height of a part is that of the highest group of links that agree.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from vaoi_station.geometry.transforms import Floats, apply
from vaoi_station.model import BoardType
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
    c, parts = adjusted.similarity, frame.board_type.components
    if problem.surface is None or c is None or not len(problem.links):
        return {}
    near = np.flatnonzero(problem.component >= 0)
    near = near[_on_body(frame, c, problem, adjusted, near)]
    height, sigma, sole, aside = _told(problem, adjusted, near)
    good = (sigma < _WORST_MM) & (aside < _ASIDE)
    number = problem.component[near]
    out = {}
    for n, mine in _of_each(number, good):
        found = _highest(height[mine], sigma[mine], _median(sole[mine]))
        if found is not None:
            out[parts[n].address] = found
    return out


def _of_each(number: Ints, good: np.ndarray) -> Iterator[tuple[int, Ints]]:
    """The good links of one component after another, of those that have enough to tell anything."""
    at = np.flatnonzero(good)
    order = at[np.argsort(number[at], kind="stable")]
    starts = np.flatnonzero(np.diff(number[order], prepend=-1))
    for mine in np.split(order, starts[1:]):
        if len(mine) >= _LEAST_LINKS:
            yield int(number[mine[0]]), mine


def _median(values: Floats) -> float:
    """That of a handful, for which numpy's own takes most of its time to find out what it is given."""
    ordered, n = np.sort(values), len(values)
    return float(ordered[(n - 1) // 2] + ordered[n // 2]) / 2


def _on_body(frame: Frame, c: Floats, problem: Problem, adjusted: Adjusted, at: Ints) -> np.ndarray:
    """Which of some links lie well within the body of their component, and whether a patch fits on that."""
    o, board_type = problem.links, frame.board_type
    place = apply(np.linalg.inv(frame.matrix(c)), adjusted.motion.board(o.p[at], o.a_mm[at]))
    center, angle, size = _bodies(board_type)
    number = problem.component[at]
    d = place - center[number]
    cos, sin = np.cos(angle[number]), np.sin(angle[number])
    offset = np.stack([cos * d[:, 0] + sin * d[:, 1], cos * d[:, 1] - sin * d[:, 0]], -1)
    room_px = size[number].min(1) * board_type.mm_per_unit * o.px_per_mm[at]
    return np.asarray((np.abs(offset) <= _CORE / 2 * size[number]).all(1) & (room_px >= PATCH_PX))


def _bodies(board_type: BoardType) -> tuple[Floats, Floats, Floats]:
    """Centres (k, 2) and sizes (k, 2) in CAD units, and angles (k,) rad in CAD's axes."""
    parts = board_type.components
    sign = 1.0 if board_type.y_axis == "up" else -1.0
    return (
        np.array([p.center for p in parts]).reshape(-1, 2),
        np.radians([sign * p.rotation for p in parts]),
        np.array([(p.width, p.height) for p in parts]).reshape(-1, 2),
    )


def _told(problem: Problem, adjusted: Adjusted, at: Ints) -> tuple[Floats, Floats, Floats, Floats]:
    """Of some links: height mm, its standard deviation, what pairs of frames share of that, and what is left (σ)."""
    assert problem.surface is not None
    o, motion = problem.links, adjusted.motion
    p, q = o.p[at], o.q[at]
    lean = motion.turned(q, o.b_lean[at]) - motion.turned(p, o.a_lean[at])
    ground = problem.surface.at_links[at] @ adjusted.surface_mm
    misfit = motion.board(q, o.b_mm[at]) - motion.board(p, o.a_mm[at]) + lean * ground[:, None]
    floor = (adjusted.floor_px / o.px_per_mm[at]) ** 2
    weight = np.linalg.inv(o.noise_mm2[at] + floor[:, None, None] * np.eye(2))
    along = np.einsum("ki,kij->kj", lean, weight)
    information = np.maximum((along * lean).sum(1), 1e-12)
    height = -(along * misfit).sum(1) / information
    left = misfit + lean * height[:, None]
    aside = np.sqrt(np.maximum(np.einsum("ki,kij,kj->k", left, weight, left), 0))
    shared = _SHARED_PX / o.px_per_mm[at] / np.maximum(np.hypot(*lean.T), 1e-9)
    return height, 1 / np.sqrt(information), shared, aside


def _highest(height: Floats, sigma: Floats, shared_mm: float) -> Height | None:
    """The highest group of links that agree; None if none does."""
    variance = sigma**2 + _SCATTER_MM**2
    least = max(_LEAST_LINKS, _LEAST_SHARE * len(height))
    agree = np.abs(height[None] - height[:, None]) <= _AGREE * np.sqrt(variance)
    count = agree.sum(1)
    if count.max(initial=0) < least:
        return None
    weight = agree @ (1 / variance)
    mm = np.where(count >= least, agree @ (height / variance) / np.maximum(weight, 1e-300), -np.inf)
    n = int(np.argmax(mm))
    spread = float(np.sqrt(1 / weight[n] + shared_mm**2 + (_SCALE * mm[n]) ** 2))
    return Height(float(mm[n]), spread, int(count[n]))
