"""Compute how the solution of an adjustment changes without the links of one place, or without one mark.

A cluster is the links of one pair of frames within one square of the ground. They have causes of errors in common that
the noise model does not contain: a part that the board type does not list, a shadow, the belt in a hole. So have the
detections of one fiducial (CAD data, dirt) and all points of a reference. The noise model states how much the solution
should change without a group of observations: if the covariance grows from Σ to Σ', the change has the covariance
Σ' − Σ. A larger change contradicts the model. (External reliability of a group of observations: Baarda, A testing
procedure for use in geodetic networks, 1968. Influence of an observation: Cook, Technometrics 19, 1977.)

Only clusters of rows and seams that few clusters connect are left out: among many, one has little influence.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from vaoi_station.compiled import compiled
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
from vaoi_station.stitching.adjustment.fiducial_equations import Equations
from vaoi_station.stitching.adjustment.height_equations import HeightEquations, HeightModel, eliminate_heights
from vaoi_station.stitching.adjustment.link_equations import LinkModel, LinkState, MotionArrays, add_links
from vaoi_station.stitching.adjustment.observations import Ints, LinkArrays
from vaoi_station.stitching.adjustment.problem import FiducialPoints, Influence

_SQUARE_MM = 5.0
"""Side of the squares: about the size of components, holes and their shadows."""
_FEW = 24
"""Rows and seams with at most this many clusters are examined (seed 105309 has 22)."""
_USED = 0.1
"""Robust weight above which a link counts as used."""
_LEAST_PX = 0.03
"""Changes up to this, px, are not kept."""
_MARK_SIGMAS = 2.0
"""Changes without one mark are explained up to this number of standard deviations. Few marks place a board: without one
of three, changes are large by chance."""
_PLACING_MM, _NONE = 0.1, -9
"""Points with a σ from this on do not place the board: fiducials of components, and of single boards of a panel."""
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
        links, state = LinkArrays._make(v[at] for v in self.links), LinkState._make(v[at] for v in self.state)
        of_heights = self.model.heights
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
    """How far points of the board are from the pivot, mm, and their largest lean in mm per mm of height."""

    mm: float
    lean: float

    def extent_mm(self, change: Floats) -> float:
        """Return roughly by how much changes (m, u) of the unknowns move points of the board at most."""
        rows = np.hypot(change[:, 1], change[:, 2]) + np.abs(change[:, 0]) * self.mm
        x_y, surface = np.abs(change[0, 5:7]), np.abs(change[0, 7:])
        return float(max(rows.max(), x_y.max(initial=0.0), surface.sum() * self.lean))


def examine_influence(
    assembly: Assembly, seam: Ints, points: FiducialPoints, shared: int, held: Ints
) -> Influence | None:
    """Leave out each cluster of rows and seams that few clusters connect, and each mark; return None if little changes.

    Args:
        assembly: the equations at the solution.
        seam: (k,) of each link between two cameras the lower of their numbers; −1 for links from row to row.
        points: the points of `Problem.fiducials`.
        shared: number of unknowns that all rows share, without cameras.
        held: columns of the unknowns that are taken as exact: the displacements of the cameras.
    """
    links, motion = assembly.links, assembly.motion
    if not len(links.p):
        return None
    cluster = number_clusters(links, assembly.state.robust, _USED, _SQUARE_MM)
    few = np.flatnonzero(_of_few(links, cluster, seam, len(motion.angle))).tolist()
    marks = groups_of_marks(points)
    if not few and not marks:
        return None
    u, whole = 3 + shared, assembly.whole()
    every, factor = _solve(assembly, whole, None, held)
    covariance = _covariance(assembly, factor, u)
    reach = Reach(float(np.abs(links.b_mm - motion.pivot).max()), float(np.hypot(*links.b_lean.T).max()))
    least_mm = _LEAST_PX / float(np.median(links.px_per_mm))
    found = []
    for number in [*few, *range(-len(marks), 0)]:
        of_marks = number < 0
        at = marks[number] if of_marks else np.flatnonzero(cluster == number)
        solution, factor = _solve(assembly, whole, assembly.part_of_marks(at) if of_marks else assembly.part(at), held)
        change = _of_rows(solution - every, len(motion.angle), u)
        if reach.extent_mm(change) > least_mm:
            explained = _covariance(assembly, factor, u) - covariance
            if of_marks:
                # One of them is wrong, and each as probably as the others: the mean of their squares is expected.
                change, explained = change / math.sqrt(len(marks)), explained * (_MARK_SIGMAS**2 / len(marks))
            found.append((change, explained, of_marks))
    return Influence(*(np.array(values) for values in zip(*found, strict=True))) if found else None


def groups_of_marks(points: FiducialPoints) -> list[Ints]:
    """Return the indices of points that are left out together: those of one fiducial, of the fixture, of the reference.

    A group is left out only if other points place the board: two fiducials, the fixture, or the reference.
    """
    which = np.where(points.sigma_mm < _PLACING_MM, points.which, _NONE)
    marks = np.unique(which[which != _NONE]).tolist()
    others = [[other for other in marks if other != mark] for mark in marks]
    places = [len(rest) >= 2 or any(other < 0 for other in rest) for rest in others]
    return [np.flatnonzero(which == mark) for mark, enough in zip(marks, places, strict=True) if enough]


@compiled
def number_clusters(links: LinkArrays, robust: Floats, used: float, square_mm: float) -> Ints:
    """Return the number (k,) of the cluster of each link; −1 for links whose robust weight is at most `used`."""
    group, b_mm = links.group, links.b_mm
    out = np.full(len(group), -1)
    x, y = np.zeros(len(group), np.int64), np.zeros(len(group), np.int64)
    count, first = 0, 0
    for n in range(len(group)):
        if n > 0 and group[n] != group[n - 1]:
            first = count
        if robust[n] <= used:
            continue
        at_x, at_y = int(np.floor(b_mm[n, 0] / square_mm)), int(np.floor(b_mm[n, 1] / square_mm))
        for c in range(first, count):
            if x[c] == at_x and y[c] == at_y:
                out[n] = c
                break
        if out[n] < 0:
            out[n], x[count], y[count] = count, at_x, at_y
            count += 1
    return out


def _of_few(links: LinkArrays, cluster: Ints, seam: Ints, rows: int) -> NDArray[np.bool_]:
    """Return of each cluster whether it connects a row or a seam that few clusters connect."""
    numbers, first = np.unique(cluster[cluster >= 0], return_index=True)
    if not len(numbers):
        return np.zeros(0, np.bool_)
    at = np.flatnonzero(cluster >= 0)[first]
    p, q, of_seam = links.p[at], links.q[at], seam[at]
    between = p != q
    of_row = np.bincount(np.append(p[between], q[between]), minlength=rows)
    of_seams = np.bincount(of_seam[~between], minlength=1)
    count = np.where(between, np.minimum(of_row[p], of_row[q]), of_seams[np.maximum(of_seam, 0)])
    return np.asarray(count <= _FEW)


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


def _of_rows(delta: Floats, rows: int, unknowns: int) -> Floats:
    """Return for each row the changes (m, u) of its unknowns and of those that all rows share."""
    own, shared = delta[: 3 * rows].reshape(rows, 3), delta[3 * rows : 3 * rows + unknowns - 3]
    return np.concatenate([own, np.broadcast_to(shared, (rows, unknowns - 3))], 1)


def _covariance(assembly: Assembly, factor: NormalEquations, unknowns: int) -> Floats:
    """Return the covariance (m, u, u) of the unknowns of each row; that of row 0 is fixed by the gauge."""
    blocks = row_blocks(assembly.envelope, inverse(factor, assembly.envelope.rows))
    blocks[0, :3] = blocks[0, :, :3] = 0.0
    return blocks[:, :unknowns, :unknowns]
