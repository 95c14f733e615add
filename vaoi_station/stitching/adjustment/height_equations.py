"""Eliminate the heights of components from the normal equations.

Each height occurs only in the links that lie on its component. It is coupled to the rows and cameras that see the
component and to the surface, but to no other height. The heights therefore have normal equations of their own
(`HeightEquations`). Their Schur complement is subtracted from the other normal equations before these are solved.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from vaoi_station.compiled import compiled, inlined
from vaoi_station.geometry.transforms import Floats
from vaoi_station.stitching.adjustment.envelope import Envelope, NormalEquations
from vaoi_station.stitching.adjustment.observations import CameraPairs, Ints, LinkArrays, cells_of, group_begins
from vaoi_station.stitching.adjustment.problem import Problem

_BODY_MM, _COMMON_MM = 0.3, 0.2
"""Standard deviation of the heights of a component's points about the component's height (body, leads, board between).

The second value is that of the mean height of those points that one pair of frames links. Without them, links on
components counted like those on the bare board, and estimated a bow of up to 0.8 mm that was not there
(docs/measured/hostile.md)."""
_SHARE = 0.3
"""Least value of the same, as a share of the component's height.

Points of tall components lie anywhere between the board and the top: heights that are distributed evenly scatter by
0.29 of the largest."""
_SIDE_MM = 0.1
"""The same for links between two cameras beside a component: each camera sees another side of it, or its shadow."""
_BESIDE_SHARE, _LOW_MM = 0.58, 0.5
"""Root mean square height of points on the side of a component, as a share of that part of its height that exceeds
`_LOW_MM`. The sides of lower components hardly reach into patches beside them."""


class HeightModel(NamedTuple):
    """For each of k links, the surface functions and the component on which the height of its point depends."""

    basis: Floats
    """(k, f) values of the surface's f basis functions at the links; f may be 0."""
    component: Ints
    """(k,) index of the component height, −1 for a link on the bare board."""


class HeightScatter:
    """The scatter of the heights of k links' points about the modelled heights.

    Points of one component lie at different heights, and those beside it on its side or on the board. Their mean height
    in one pair of frames is an error that its links have in common, so that links on one body never outweigh few on the
    board. Both grow with the component's height, which the adjustment estimates.
    """

    cell: Ints
    """(k,) number of the links on or beside one component in one pair of frames (`cells_of`); −1 on the bare board."""

    def __init__(self, problem: Problem, height: Ints, parts: int) -> None:
        """Find the component on or beside which each link lies.

        Args:
            problem: the problem of the adjustment.
            height: (k,) index of the height of each link, or −1 (`HeightModel.component`).
            parts: number of components with links.
        """
        links, on = problem.links, problem.component >= 0
        self._beside = problem.reaches_component & ~on
        sides = self._beside & (links.p == links.q)
        self._part = np.where(self._beside, problem.near, problem.component) if len(problem.near) else problem.component
        # Sides at a seam have their heights in common, whatever component they belong to.
        beside = np.where(sides, 2 * parts, 2 * parts + 1 + self._part)
        self.cell = cells_of(np.where(self._beside, beside, height), links.group)
        self._least = np.where(on, _BODY_MM, np.where(sides, _SIDE_MM, 0.0))
        self._least_common = np.where(self._least > 0, _COMMON_MM, 0.0)
        self._known = np.flatnonzero((self._part >= 0) & (self._part < parts))

    def at(self, heights_mm: Floats) -> tuple[Floats, Floats]:
        """Return standard deviations (k,), mm: of the height of single points, and of the mean height of each cell.

        `heights_mm` (2, n) are the estimated heights of the components by links from row to row, and by those between
        cameras. They lie on other points of a component: the taller counts.
        """
        height = np.maximum(heights_mm.max(0), 0.0)[self._part[self._known]]
        side = _BESIDE_SHARE * np.maximum(height - _LOW_MM, 0.0)
        of_height = np.zeros(len(self._part))
        of_height[self._known] = np.where(self._beside[self._known], side, _SHARE * height)
        return np.maximum(self._least, of_height), np.maximum(self._least_common, of_height * (_COMMON_MM / _BODY_MM))


class Coupling(NamedTuple):
    """The unknowns to which each of c component heights is coupled: a range of rows, the surface, a range of cameras.

    The entries of a height in `HeightEquations.entries` stand in this order, which is that of the columns of the normal
    matrix: (φ, sx, sy) of its rows, the coefficients of the surface, (x, y, turn) of its cameras.
    """

    row: Ints
    """(c,) the first row that sees each component; 0 for a component without links."""
    last: Ints
    """(c,) the last row that sees each component; −1 for a component without links."""
    camera: Ints
    """(c,) the first camera that sees each component; 0 for a component without links."""
    at: Ints
    """(c + 1,) index of the first entry of each component in `HeightEquations.entries`."""
    surface: int
    """The number of coefficients of the surface."""
    surface_column: int
    """Column of the first coefficient of the surface in the normal matrix."""
    camera_column: int
    """Column of the first camera's displacement in the normal matrix; −1 if the cameras are taken as exact."""

    @staticmethod
    def of(component: Ints, links: LinkArrays, pairs: CameraPairs, columns: OtherColumns) -> Coupling:
        """Build the coupling of component heights to the unknowns of the links that lie on the components.

        `component` (k,) is the index of the height of every link, or −1.
        """
        first, last, camera, width = _ranges(component, links.p, links.q, links.group, pairs, columns)
        at = np.append(0, np.cumsum(width))
        return Coupling(first, last, camera, at, columns.surface, columns.surface_column, columns.camera_column)

    def equations(self, heights_mm: Floats, sigma_mm: float, sunk_mm: float) -> HeightEquations:
        """Return the equations of the component heights without any link: they contain only the prior.

        The prior expects a height of 0 with standard deviation `sigma_mm`. As components stand above the board, the
        standard deviation of heights that are below 0 is `sunk_mm`. The unknowns are changes of the current heights
        `heights_mm` (c,).
        """
        normal = np.where(heights_mm < 0, 1 / sunk_mm**2, 1 / sigma_mm**2)
        return HeightEquations(np.zeros(int(self.at[-1])), normal, -heights_mm * normal)

    def envelope(self, links: LinkArrays, rows: int, others: int) -> Envelope:
        """Build the envelope of the normal equations of `rows` rows and `others` further unknowns.

        Two rows are coupled if they are consecutive (prior of the belt), if a link connects them, or if both see the
        same component, whose height is eliminated.
        """
        furthest, first = np.minimum(np.arange(rows) + 1, rows - 1), group_begins(links.group)
        p, q = links.p[first], links.q[first]
        np.maximum.at(furthest, np.minimum(p, q), np.maximum(p, q))
        np.maximum.at(furthest, self.row, self.last)
        return Envelope.of(furthest, others)


class OtherColumns(NamedTuple):
    """The columns of the unknowns that all rows share, and the number of component heights."""

    surface: int
    """The number of coefficients of the surface that are unknowns."""
    surface_column: int
    """Column of the first coefficient of the surface in the normal matrix."""
    camera_column: int
    """Column of the first camera's displacement; −1 if the cameras are taken as exact."""
    heights: int
    """The number c of component heights."""


class HeightEquations(NamedTuple):
    """The normal equations of c component heights, and their coupling to the other unknowns."""

    entries: Floats
    """The entries of the normal matrix between each height and the other unknowns, in the order of `Coupling`."""
    normal: Floats
    """(c,) diagonal of the normal matrix of the heights, which are not coupled to one another."""
    right: Floats
    """(c,) right-hand side of the heights' normal equations."""


@compiled
def _ranges(
    component: Ints, p: Ints, q: Ints, group: Ints, pairs: CameraPairs, columns: OtherColumns
) -> tuple[Ints, Ints, Ints, Ints]:
    """Find the rows and cameras to which the height of each of c components is coupled.

    Returns:
        First row, last row, first camera, and number of entries in `HeightEquations.entries`, (c,) each.
    """
    count = columns.heights
    first, last = np.zeros(count, np.int64), np.full(count, -1)
    camera, furthest = np.zeros(count, np.int64), np.full(count, -1)
    for n in range(len(component)):
        c = component[n]
        if c >= 0:
            low, high = min(p[n], q[n]), max(p[n], q[n])
            left, right = pairs.a[group[n]], pairs.b[group[n]]
            first[c] = low if last[c] < 0 else min(first[c], low)
            camera[c] = left if last[c] < 0 else min(camera[c], left)
            last[c], furthest[c] = max(last[c], high), max(furthest[c], right)
    width = np.zeros(count, np.int64)
    for c in range(count):
        if last[c] >= 0:
            width[c] = 3 * (last[c] - first[c] + 1) + columns.surface
            if columns.camera_column >= 0:
                width[c] += 3 * (furthest[c] - camera[c] + 1)
    return first, last, camera, width


@inlined
def _fill_columns(coupling: Coupling, c: int, columns: Ints) -> int:
    """Write the columns of the normal matrix to which the entries of component c belong; return their number."""
    count = 0
    for row in range(coupling.row[c], coupling.last[c] + 1):
        for k in range(3):
            columns[count + k] = 3 * row + k
        count += 3
    for k in range(coupling.surface):
        columns[count + k] = coupling.surface_column + k
    for k in range(count + coupling.surface, coupling.at[c + 1] - coupling.at[c]):
        columns[k] = coupling.camera_column + 3 * coupling.camera[c] + k - count - coupling.surface
    return int(coupling.at[c + 1] - coupling.at[c])


@compiled
def eliminate_heights(coupling: Coupling, heights: HeightEquations, normal: NormalEquations) -> None:
    """Eliminate the heights: subtract their Schur complement from the normal equations of the other unknowns."""
    at, values, right, entries = normal.at, normal.values, normal.right, heights.entries
    columns = np.empty(len(right), np.int64)
    for c in range(len(heights.normal)):
        begin = coupling.at[c]
        if coupling.at[c + 1] == begin:
            continue
        count = _fill_columns(coupling, c, columns)
        for a in range(count):
            own = entries[begin + a] / heights.normal[c]
            if own != 0:
                i = columns[a]
                right[i] -= own * heights.right[c]
                for b in range(a + 1):
                    # columns ascend, so that this is in the lower triangle
                    values[at[i] + columns[b]] -= own * entries[begin + b]


@compiled
def height_changes(coupling: Coupling, heights: HeightEquations, delta: Floats) -> Floats:
    """Return the changes (c,) of component heights, mm, that follow from changes (n,) of all other unknowns."""
    out, columns = heights.right.copy(), np.empty(len(delta), np.int64)
    for c in range(len(out)):
        begin = coupling.at[c]
        if coupling.at[c + 1] > begin:
            for a in range(_fill_columns(coupling, c, columns)):
                out[c] -= heights.entries[begin + a] * delta[columns[a]]
        out[c] /= heights.normal[c]
    return out
