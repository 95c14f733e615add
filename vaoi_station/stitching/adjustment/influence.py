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

from vaoi_station.compiled import compiled
from vaoi_station.geometry.similarity import similarity_jacobian
from vaoi_station.geometry.transforms import Floats
from vaoi_station.stitching.adjustment.envelope import (
    Envelope,
    NormalEquations,
    add_equations,
    factorise,
    hold_first_row,
    inverse,
    row_blocks,
    solve_backward,
    solve_forward,
)
from vaoi_station.stitching.adjustment.equations import (
    Equations,
    HeightEquations,
    HeightModel,
    LinkModel,
    LinkState,
    MotionArrays,
    add_links,
    eliminate_heights,
)
from vaoi_station.stitching.adjustment.problem import REFERENCE, USED, FiducialPoints, Influence, Ints, LinkArrays

_SQUARE_MM = 5.0
"""Side of the squares: about the size of components, holes and their shadows."""
_GRIDS = (0.0, 0.0), (0.5, 0.0), (0.0, 0.5), (0.5, 0.5)
"""Displacements of the four grids, in sides of a square."""
_FEW, _FEW_AT_SEAM = 24, 12
"""Clusters are left out if at most this many connect the rows on both sides of a gap between two rows, or two cameras.

A frame of 1392×1040 px at 40 px/mm has about 30 to 50 in its overlap with the next row, one of 480×360 px 5 to 30. All
rows of two cameras together have 10 to 60; little depends on one of them, since the cameras are held."""
_LEAST_PX = 0.03
"""Changes up to this, px, are not kept."""
_PLACING_MM, _NONE = 0.1, -9
"""Fiducials with a σ from this on do not place the board: those of components, and of single boards of a panel."""
_HELD = 1e12
"""Added to the diagonal entry of an unknown that must not change, px⁻²."""


@dataclass(frozen=True, eq=False)
class Assembly:
    """The parts of which the normal equations of an adjustment are summed, at the current unknowns."""

    envelope: Envelope
    priors: list[Equations]
    """All equations but those of links: belt, then detections and scale if there are any, then surface."""
    links: LinkArrays
    motion: MotionArrays
    model: LinkModel
    state: LinkState
    heights: HeightEquations
    """The equations of the component heights without any link; not changed."""

    def whole(self) -> tuple[NormalEquations, HeightEquations]:
        """Return the normal equations of all observations, and those of the component heights."""
        normal = self.envelope.zeros()
        heights = HeightEquations(*(values.copy() for values in self.heights))
        for equations in self.priors:
            add_equations(*equations, normal)
        add_links(self.links, self.motion, self.model, self.state, heights, normal)
        return normal, heights

    def part(self, at: Ints) -> tuple[NormalEquations, HeightEquations]:
        """Return the same equations of the links `at` alone, which are of one pair of frames."""
        normal, heights = self._nothing()
        # Of the other arrays nothing is read: indexing them would take half of the time.
        links, state, of_heights = self.links, self.state, self.model.heights
        links = links._replace(p=links.p[at], q=links.q[at], a_mm=links.a_mm[at], b_mm=links.b_mm[at])
        links = links._replace(group=links.group[at])
        state = state._replace(residual=state.residual[at], lean=state.lean[at], weight=state.weight[at])
        own = self.model._replace(heights=HeightModel(of_heights.basis[at], of_heights.component[at]))
        add_links(links, self.motion, own, state, heights, normal)
        return normal, heights

    def part_of_marks(self, at: Ints) -> tuple[NormalEquations, HeightEquations]:
        """Return the same equations of the points `at` of `Problem.fiducials` alone."""
        normal, heights = self._nothing()
        columns, slopes, rest = self.priors[1]
        add_equations(columns[at], slopes[at], rest[at], normal)
        return normal, heights

    def _nothing(self) -> tuple[NormalEquations, HeightEquations]:
        return self.envelope.zeros(), HeightEquations(*(np.zeros_like(values) for values in self.heights))


class Reach(NamedTuple):
    """Where a board is seen, to compute roughly how far changes of the unknowns move its points."""

    mm: float
    """Largest distance of a point from the pivot."""
    lean: float
    """Largest lean, mm per mm of height."""
    cad: Floats
    """(s, 2) places of marks, CAD coordinates."""

    @staticmethod
    def of(links: LinkArrays, points: FiducialPoints, pivot: Floats) -> Reach:
        """Return the reach of all links and points."""
        seen = np.concatenate([links.b_mm, points.ground_mm]) - pivot
        lean = np.concatenate([links.b_lean, points.lean])
        return Reach(float(np.abs(seen).max()), float(np.hypot(*lean.T).max()), points.cad)

    def extents_mm(self, changes: Floats) -> Floats:
        """Return roughly by how much each of c changes (c, m, u) of the unknowns moves points of the board at most."""
        rows = np.hypot(changes[:, :, 1], changes[:, :, 2]) + np.abs(changes[:, :, 0]) * self.mm
        by_c = np.hypot(*np.moveaxis(changes[:, 0, 3:7] @ similarity_jacobian(self.cad).swapaxes(1, 2), -1, 0))
        surface = np.abs(changes[:, 0, 7:]).sum(1) * self.lean
        return np.asarray(np.maximum(np.maximum(rows.max(1), by_c.max(0)), surface))


def examine_influence(
    assembly: Assembly, seam: Ints, points: FiducialPoints, shared: int, held: Ints
) -> Influence | None:
    """Leave out each cluster of weakly connected rows and cameras, and each mark; return None if little changes.

    Args:
        seam: (k,) of each link between two cameras the lower of their numbers; −1 for links from row to row.
        points: the points of `Problem.fiducials`, at least one.
        shared: number of unknowns that all rows share, without cameras.
        held: columns of the unknowns that are taken as exact: the displacements of the cameras.
    """
    links, motion = assembly.links, assembly.motion
    places, marks = few_places(links, assembly.state.robust, seam, len(motion.angle)), groups_of_marks(points)
    if not places and not marks:
        return None
    u, whole = 3 + shared, assembly.whole()
    every, factor = _solve(assembly, whole, None, held)
    covariance = _covariance(assembly, factor, u)
    reach = Reach.of(links, points, motion.pivot)
    least_mm = _LEAST_PX / float(np.median(points.px_per_mm))
    groups = [*(place.links for place in places), *marks]
    parts = [assembly.part] * len(places) + [assembly.part_of_marks] * len(marks)
    solved = [_solve(assembly, whole, part(at), held) for part, at in zip(parts, groups, strict=True)]
    changes = _of_rows(np.array([solution for solution, _ in solved]) - every, len(motion.angle), u)
    # in this form, because a change that is no number must not be left out
    kept = np.flatnonzero(~(reach.extents_mm(changes) <= least_mm)).tolist()
    if not kept:
        return None
    growth = [_covariance(assembly, solved[n][1], u) - covariance for n in kept]
    grids = np.zeros((len(groups), len(_GRIDS)), np.bool_)
    for n, place in enumerate(places):
        grids[n, sorted(place.grids)] = True
    return Influence(changes[kept], np.array(growth), grids[kept], len(marks))


class Place(NamedTuple):
    """The links of one cluster, and the numbers of the grids in which they are a cluster."""

    links: Ints
    grids: set[int]


def few_places(links: LinkArrays, robust: Floats, seam: Ints, rows: int) -> list[Place]:
    """Return the clusters that are left out, each once, with the grids in which it occurs.

    Args:
        robust: (k,) their robust weights.
        seam: (k,) of each link between two cameras the lower of their numbers; −1 for links from row to row.
    """
    found: dict[bytes, Place] = {}
    for grid, offset in enumerate(_GRIDS):
        cluster = number_clusters(links, robust, USED, _SQUARE_MM, offset)
        few = np.flatnonzero(_of_few(links, cluster, seam, rows))
        # The grids hardly differ in their number of clusters.
        if not len(few):
            break
        for number in few.tolist():
            at = np.flatnonzero(cluster == number)
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


@compiled
def number_clusters(
    links: LinkArrays, robust: Floats, used: float, square_mm: float, offset: tuple[float, float]
) -> Ints:
    """Return the number (k,) of the cluster of each link; −1 for links whose robust weight is at most `used`.

    `offset` displaces the grid, in sides of a square.
    """
    group, b_mm = links.group, links.b_mm
    out = np.full(len(group), -1)
    x, y = np.zeros(len(group), np.int64), np.zeros(len(group), np.int64)
    count, first = 0, 0
    for n in range(len(group)):
        if n > 0 and group[n] != group[n - 1]:
            first = count
        if robust[n] <= used:
            continue
        at_x = int(np.floor(b_mm[n, 0] / square_mm + offset[0]))
        at_y = int(np.floor(b_mm[n, 1] / square_mm + offset[1]))
        for c in range(first, count):
            if x[c] == at_x and y[c] == at_y:
                out[n] = c
                break
        if out[n] < 0:
            out[n], x[count], y[count] = count, at_x, at_y
            count += 1
    return out


def _of_few(links: LinkArrays, cluster: Ints, seam: Ints, rows: int) -> NDArray[np.bool_]:
    """Return of each cluster whether it is one of few that connect the rows beside a gap, or two cameras."""
    numbers, first = np.unique(cluster[cluster >= 0], return_index=True)
    if not len(numbers):
        return np.zeros(0, np.bool_)
    at = np.flatnonzero(cluster >= 0)[first]
    p, q, of_seam = links.p[at], links.q[at], seam[at]
    low, high = np.minimum(p, q), np.maximum(p, q)
    between = high > low
    # number of clusters across the gap after each row
    begin, end = (np.bincount(row[between], minlength=rows) for row in (low, high))
    across = np.cumsum(begin - end)
    spans, span = np.unique(low * rows + high, return_inverse=True)
    least = np.array([across[n // rows : max(n % rows, n // rows + 1)].min() for n in spans.tolist()])
    of_seams = np.bincount(of_seam[~between], minlength=1)[np.maximum(of_seam, 0)]
    return np.asarray(np.where(between, least[span.ravel()] <= _FEW, of_seams <= _FEW_AT_SEAM))


def _solve(
    assembly: Assembly,
    whole: tuple[NormalEquations, HeightEquations],
    part: tuple[NormalEquations, HeightEquations] | None,
    held: Ints,
) -> tuple[Floats, NormalEquations]:
    """Return the solution (n,) of the equations without a part of them, and their factor."""
    normal, heights = whole
    if part is None:
        heights = HeightEquations(*(values.copy() for values in heights))
        normal = normal._replace(values=normal.values.copy(), right=normal.right.copy())
    else:
        less, lower = part
        heights = HeightEquations(*(a - b for a, b in zip(heights, lower, strict=True)))
        normal = normal._replace(values=normal.values - less.values, right=normal.right - less.right)
    eliminate_heights(assembly.model.coupling, heights, normal)
    hold_first_row(normal)
    normal.values[assembly.envelope.at[held] + held] += _HELD
    normal.right[held] = 0.0
    factorise(normal)
    return solve_backward(normal, solve_forward(normal)), normal


def _of_rows(deltas: Floats, rows: int, unknowns: int) -> Floats:
    """Return of c solutions (c, n) the changes (c, m, u) of each row's unknowns and of those that all rows share."""
    own, shared = deltas[:, : 3 * rows].reshape(-1, rows, 3), deltas[:, None, 3 * rows : 3 * rows + unknowns - 3]
    return np.concatenate([own, np.broadcast_to(shared, (len(deltas), rows, unknowns - 3))], 2)


def _covariance(assembly: Assembly, factor: NormalEquations, unknowns: int) -> Floats:
    """Return the covariance (m, u, u) of the unknowns of each row."""
    return row_blocks(assembly.envelope, inverse(factor, assembly.envelope.rows))[:, :unknowns, :unknowns]
