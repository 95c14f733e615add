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
from vaoi_station.stitching.adjustment.observations import CameraPairs, Ints, LinkArrays, group_begins


class HeightModel(NamedTuple):
    """For each of k links, the surface functions and the component on which the height of its point depends."""

    basis: Floats
    """(k, f) values of the surface's f basis functions at the links; f may be 0."""
    component: Ints
    """(k,) index of the component height, −1 for a link on the bare board."""


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
