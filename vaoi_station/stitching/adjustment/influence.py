"""Compute how the solution of an adjustment changes without the links of one place, or without one mark.

A cluster is the links of one pair of frames within one square of the ground. They have causes of errors in common that
the noise model does not contain: a part that the board type does not list, a shadow, the belt in a hole. The detections
of one fiducial have such causes too (CAD data, dirt), and so have all points of a reference. The noise model states how
much the solution should change without a group of observations: if the covariance grows from Σ to Σ', the change has
the covariance Σ' − Σ. A larger change contradicts the model. (External reliability of a group of observations: Baarda,
A testing procedure for use in geodetic networks, 1968. Influence of an observation: Cook, Technometrics 19, 1977.)

A place on the line between two squares is in both, and without one of them the other still holds the solution. So there
are four grids of squares, displaced by half a side. Only clusters that connect rows or cameras which few clusters
connect are left out: among many, one has little influence. The displacements of the cameras are held: what a place at a
seam does to them is not examined.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from vaoi_station.geometry.similarity import similarity_jacobian
from vaoi_station.geometry.transforms import Floats
from vaoi_station.stitching.adjustment.envelope import (
    NormalEquations,
    add_equations,
    factorise,
    hold_first_row,
    inverse,
    solve_backward,
    solve_forward,
)
from vaoi_station.stitching.adjustment.equations import (
    Equations,
    HeightEquations,
    LinkModel,
    LinkState,
    add_links,
    eliminate_heights,
)
from vaoi_station.stitching.adjustment.motion import MotionArrays
from vaoi_station.stitching.adjustment.problem import REFERENCE, USED, FiducialPoints, Influence, Ints, LinkArrays

_SQUARE_MM = 5.0  # side of the squares: about the size of components, holes and their shadows
_GRIDS = (0.0, 0.0), (0.5, 0.0), (0.0, 0.5), (0.5, 0.5)  # displacements of the four grids, in sides of a square
_FEW, _FEW_AT_SEAM = 24, 12
"""Clusters are left out if at most this many connect the rows on both sides of a gap between two rows, or two cameras.

A frame of 1392×1040 px at 40 px/mm has about 30 to 50 in its overlap with the next row, one of 480×360 px 5 to 30. All
rows of two cameras together have 10 to 60; little depends on one of them, since the cameras are held."""
_LEAST_PX = 0.03  # changes up to this, px, are not kept
_PLACING_MM, _NONE = 0.1, -9
"""Fiducials with a σ from this on do not place the board: those of components, and of single boards of a panel."""


@dataclass(frozen=True, eq=False)
class Assembly:
    """The parts of which the normal equations of an adjustment are summed, at the current unknowns."""

    priors: list[Equations]  # all but those of links: belt, then detections and scale if there are any, then surface
    links: LinkArrays
    motion: MotionArrays
    model: LinkModel
    state: LinkState
    normal: NormalEquations  # those of the envelope, without any observation; not changed
    heights: HeightEquations  # those of the component heights without any link; not changed

    def whole(self) -> tuple[NormalEquations, HeightEquations]:
        """Return the normal equations of all observations, and those of the component heights."""
        normal, heights = self.normal.zeros(), HeightEquations(*(values.copy() for values in self.heights))
        for equations in self.priors:
            add_equations(*equations, normal)
        add_links(self.links, self.motion, self.model, self.state, heights, normal)
        return normal, heights

    def of_links(self) -> tuple[NormalEquations, HeightEquations]:
        """Return the same equations of the links alone, without any prior."""
        normal, heights = self.normal.zeros(), self.heights.zeros()
        add_links(self.links, self.motion, self.model, self.state, heights, normal)
        return normal, heights

    def part(self, at: Ints) -> tuple[NormalEquations, HeightEquations]:
        """Return the same equations of the links `at` alone, which are of one pair of frames."""
        normal, heights = self.normal.zeros(), self.heights.zeros()
        # Of the other arrays nothing is read: indexing them would take half of the time.
        read = {name: getattr(self.links, name)[at] for name in ("p", "q", "camera_a", "camera_b", "group")}
        of_links = {name: getattr(self.state, name)[at] for name in ("residual", "lean", "weight", "a_mm", "b_mm")}
        own = self.model._replace(basis=self.model.basis[at], component=self.model.component[at])
        add_links(self.links._replace(**read), self.motion, own, self.state._replace(**of_links), heights, normal)
        return normal, heights

    def part_of_marks(self, at: Ints, count: int) -> NormalEquations:
        """Return the same equations of the points `at` of `Problem.fiducials` alone, which do not show heights.

        Only the first `count` unknowns are kept.
        """
        normal = self.normal.zeros()
        columns, slopes, rest = self.priors[1]
        add_equations(columns[at], slopes[at], rest[at], normal)
        return leading(normal, count)

    def without_heights(self, normal: NormalEquations, heights: HeightEquations, count: int) -> NormalEquations:
        """Return equations of the first `count` unknowns, from which the component heights are eliminated."""
        out = normal.copy()
        eliminate_heights(self.model.coupling, heights, out)
        return leading(out, count)


def leading(normal: NormalEquations, count: int) -> NormalEquations:
    """Return the equations of the first `count` unknowns, with all others held at their values."""
    end = normal.at[count - 1] + count
    return NormalEquations(
        normal.first[:count], normal.at[:count], normal.values[:end], normal.right[:count], normal.rows
    )


def solve(normal: NormalEquations) -> Floats:
    """Return the solution (n,) of equations without heights, which are replaced by their factor."""
    hold_first_row(normal)
    factorise(normal)
    return solve_backward(normal, solve_forward(normal))


def examine_influence(
    assembly: Assembly, whole: NormalEquations, heights: HeightEquations, points: FiducialPoints, shared: int
) -> Influence | None:
    """Leave out each cluster of weakly connected rows and cameras, and each mark; return None if little changes.

    Args:
        whole: the sum of all equations (`Assembly.whole`).
        heights: those of the component heights.
        points: the points of `Problem.fiducials`, at least one.
        shared: number of unknowns that all rows share, without the displacements of cameras, which are held.
    """
    links, rows = assembly.links, len(assembly.motion.angle)
    places, marks = few_places(links, assembly.state, rows), groups_of_marks(points)
    if not places and not marks:
        return None
    count = 3 * rows + shared
    parts = [assembly.part(place.links) for place in places]
    every = assembly.without_heights(whole, heights, count)
    without = [assembly.without_heights(whole.less(normal), heights.less(own), count) for normal, own in parts]
    without += [every.less(assembly.part_of_marks(at, count)) for at in marks]
    deltas = np.array([solve(normal) for normal in without]) - solve(every)
    own, of_all = deltas[:, : 3 * rows].reshape(-1, rows, 3), deltas[:, None, 3 * rows :]
    changes = np.concatenate([own, np.broadcast_to(of_all, (len(deltas), rows, shared))], 2)
    least_mm = _LEAST_PX / float(np.median(points.px_per_mm))
    # in this form, because a change that is no number must not be left out
    kept = np.flatnonzero(~(_extents_mm(changes, assembly, points) <= least_mm)).tolist()
    if not kept:
        return None
    covariance, *grown = (f.row_blocks(inverse(f)) for f in (every, *(without[n] for n in kept)))
    grids = np.zeros((len(without), len(_GRIDS)), np.bool_)
    for number, place in enumerate(places):
        grids[number, list(place.grids)] = True
    return Influence(changes[kept], np.array(grown) - covariance, grids[kept], len(marks))


def _extents_mm(changes: Floats, assembly: Assembly, points: FiducialPoints) -> Floats:
    """Return roughly by how much each of c changes (c, m, u) of the unknowns moves points of the board at most."""
    seen, leans = (assembly.state.b_mm, points.ground_mm), (assembly.links.b_lean, points.lean)
    reach_mm = max(float(np.abs(mm - assembly.motion.pivot).max(initial=0.0)) for mm in seen)
    lean = max(float(np.square(of).sum(1).max(initial=0.0)) for of in leans) ** 0.5
    rows = np.hypot(changes[:, :, 1], changes[:, :, 2]) + np.abs(changes[:, :, 0]) * reach_mm
    by_c = np.hypot(*np.moveaxis(changes[:, 0, 3:7] @ similarity_jacobian(points.cad).swapaxes(1, 2), -1, 0))
    return np.asarray(np.max([rows.max(1), by_c.max(0), np.abs(changes[:, 0, 7:]).sum(1) * lean], axis=0))


class Place(NamedTuple):
    """The links of one cluster, and the numbers of the grids in which they are a cluster."""

    links: Ints
    grids: set[int]


def few_places(links: LinkArrays, state: LinkState, rows: int) -> list[Place]:
    """Return the clusters of links that are left out, each once."""
    found: dict[bytes, Place] = {}
    used = np.flatnonzero(state.robust > USED)
    begins = np.flatnonzero(np.diff(links.group[used], prepend=-1))
    if not len(used):
        return []
    pair = used[begins]
    of_pair = np.repeat(np.arange(len(begins)), np.diff(begins, append=len(used)))
    places = state.b_mm[used].T / _SQUARE_MM
    for grid, offset in enumerate(_GRIDS):
        # Squares are counted from the first one of their pair of frames.
        x, y = (np.floor(of + by).astype(np.int_) for of, by in zip(places, offset, strict=True))
        x, y = (of - np.minimum.reduceat(of, begins)[of_pair] for of in (x, y))
        square = x * (int(y.max()) + 1) + y
        there = np.zeros((len(begins), int(square.max()) + 1), np.bool_)
        there[of_pair, square] = True
        few = np.flatnonzero(_of_few(links, pair, there.sum(1), rows))
        # The grids hardly differ in their number of clusters.
        if not len(few):
            break
        for n in few.tolist():
            own = np.flatnonzero(of_pair == n)
            for number in np.flatnonzero(there[n]).tolist():
                at = used[own[square[own] == number]]
                found.setdefault(at.tobytes(), Place(at, set())).grids.add(grid)
    return list(found.values())


def groups_of_marks(points: FiducialPoints) -> list[Ints]:
    """Return the indices of points that are left out together: those of one fiducial, of the fixture, of the reference.

    A group is left out only if other points place the board: two fiducials, the fixture, or the reference.
    """
    apart = (points.sigma_mm >= _PLACING_MM) & (points.which != REFERENCE)
    which = np.where(apart, _NONE, points.which)
    marks = np.unique(which[which != _NONE]).tolist()
    others = [[other for other in marks if other != mark] for mark in marks]
    places = [len(rest) >= 2 or any(other < 0 for other in rest) for rest in others]
    return [np.flatnonzero(which == mark) for mark, enough in zip(marks, places, strict=True) if enough]


def _of_few(links: LinkArrays, pair: Ints, clusters: Ints, rows: int) -> NDArray[np.bool_]:
    """Return whether the clusters of each pair of frames are of few beside a gap between rows, or between two cameras.

    `pair` (n,) holds one link of each pair of frames, and `clusters` (n,) how many clusters it has.
    """
    p, q, seam = links.p[pair], links.q[pair], links.camera_a[pair]
    low, high = np.minimum(p, q), np.maximum(p, q)
    at_seam = np.where(high > low, 0, clusters)
    # number of clusters across the gap after each row, and of gaps with few of them before each row
    begin, end = (np.bincount(row, clusters - at_seam, rows) for row in (low, high))
    before = np.append(0, np.cumsum(np.cumsum(begin - end) <= _FEW))
    of_seams = np.bincount(seam, at_seam)[seam]
    return np.asarray(np.where(high > low, before[high] > before[low], of_seams <= _FEW_AT_SEAM))
