"""The normal equations of an adjustment: those of links, of detected fiducials, of the scale of C.

A link states that ground point a of row p and ground point b of row q are the same point of the board. Its residual is

    r = board(q, b) − board(p, a) + l·h,    l = R(φ_q)·l_b − R(φ_p)·l_a,

where board() is the map from ground to board of `Motion`, R(φ) a rotation, l_a and l_b the leans of the two points, l
the change of the residual per mm of height, and h the height of the point: that of the surface plus that of the
component.

Unknowns are (φ, sx, sy) of every row, in the columns 3·row to 3·row + 2, C, the coefficients of the surface, and the
displacements of the cameras (`cameras.py`). Each height of a component occurs only in the links that lie on it, and is
coupled to the rows and cameras that see the component and to the surface, but to no other height. The heights therefore
have normal equations of their own (`HeightEquations`), whose Schur complement is subtracted from the others.

Compiled functions take their arrays in named tuples, which Numba unpacks without a copy.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from vaoi_station.compiled import compiled, inlined
from vaoi_station.geometry.robust import huber_weights
from vaoi_station.geometry.transforms import Floats
from vaoi_station.stitching.adjustment.envelope import NormalEquations
from vaoi_station.stitching.adjustment.motion import Motion, MotionArrays
from vaoi_station.stitching.adjustment.problem import FiducialPoints, Ints, LinkArrays, Problem

_SINGLE_PX, _COMMON_PX = 0.002, 0.004
"""Standard deviations of two errors of a detection that `sigma_mm` does not include.

`_SINGLE_PX` is independent for each detection. `_COMMON_PX` is common to all detections of one fiducial (artwork,
light) and does not average out (docs/explanation/uncertainty.md)."""
_SCALE_SIGMA = 3e-4  # σ of the relative size of a board against its CAD data: boards shrink and stretch
_KNEE, _CUT = 2.0, 6.0
"""Residuals beyond `_KNEE` standard deviations lose weight (Huber). Fixture marks and reference points, of which there
are many, have no weight beyond `_CUT` standard deviations."""

Equations = tuple[Ints, Floats, Floats]
"""k sets of r whitened equations a·δ + b ≈ 0 in f unknowns: columns (k, f) of the unknowns, a (k, r, f), b (k, r)."""


def fiducial_residuals(
    points: FiducialPoints, motion: Motion, c: Floats, basis: Floats, surface_mm: Floats
) -> tuple[Floats, Floats]:
    """Return the residuals (s, 2) of s detections in mm, and their derivatives (s, 2, 3 + 4 + f) by row, C and surface.

    `c` is the similarity C as (a, b, x, y); `basis` (s, f) has the values of the surface's basis functions, f ≥ 0, and
    `surface_mm` (f,) its coefficients.
    """
    # Places and directions as complex numbers x + iy: a rotation is then a product.
    turn, cad = np.exp(1j * motion.angle[points.row]), points.cad @ (1, 1j)
    lean, arm = turn * (points.lean @ (1, 1j)), turn * ((points.ground_mm - motion.pivot) @ (1, 1j))
    board = arm + (motion.pivot + motion.shift[points.row]) @ (1, 1j) + lean * (basis @ surface_mm)
    a, b, x, y = c.tolist()
    off, slopes = board - complex(a, b) * cad - complex(x, y), np.empty((len(arm), 7 + len(surface_mm)), np.complex128)
    slopes[:, 0], slopes[:, 1:3], slopes[:, 5:7] = 1j * arm, (1, 1j), (-1, -1j)
    slopes[:, 3], slopes[:, 4], slopes[:, 7:] = -cad, -1j * cad, lean[:, None] * basis
    return np.stack([off.real, off.imag], -1), np.stack([slopes.real, slopes.imag], 1)


def detection_equations(
    points: FiducialPoints, sigma_mm: Floats, residual: Floats, jacobian: Floats, columns: Ints
) -> Equations:
    """Return the robustly weighted, whitened equations of s detections.

    Args:
        sigma_mm: (s,) `detection_sigma_mm`.
        residual: (s, 2) residuals, mm.
        jacobian: (s, 2, u) their derivatives by u unknowns.
        columns: (s, u) columns of these unknowns.
    """
    chi, sigma = np.sqrt((residual**2).sum(1) / 2) / sigma_mm, sigma_mm
    many = points.which < 0
    if many.any():
        # While the rows have only their nominal motion, all these points have large residuals without being outliers.
        # The limits are therefore scaled by the median residual.
        scale = max(float(np.median(chi[many])), 1.0)
        chi, sigma = np.where(many, chi / scale, chi), np.where(many, sigma * scale, sigma)
    robust = np.where(many & (chi > _CUT), 0.0, huber_weights(chi, _KNEE))
    weight = (np.sqrt(robust) / sigma)[:, None]
    return columns, weight[:, :, None] * jacobian, weight * residual


def scale_equation(c: Floats, nominal_scale: float, columns: Ints) -> Equations:
    """Return the prior equation that the scale of the similarity c = (a, b, x, y) is close to its nominal value.

    `columns` (2,) are the columns of the unknowns a and b.
    """
    scale, sigma = float(np.hypot(*c[:2])), _SCALE_SIGMA * nominal_scale
    return columns[None], c[None, None, :2] / scale / sigma, np.array([[(scale - nominal_scale) / sigma]])


def detection_sigma_mm(points: FiducialPoints) -> Floats:
    """Return the standard deviation (s,) of each detection, mm.

    If a fiducial has n detections, the variance of their common error is multiplied by n in each. The mean of the
    detections then has at least the variance of the common error.
    """
    own = points.sigma_mm**2 + (_SINGLE_PX / points.px_per_mm) ** 2
    fiducial = points.which >= 0
    count = np.bincount(points.which[fiducial], minlength=1)
    times = np.where(fiducial, count[np.maximum(points.which, 0)], 1)
    return np.asarray(np.sqrt(own + times * (_COMMON_PX / points.px_per_mm) ** 2))


_BODY_MM, _COMMON_MM = 0.3, 0.2
"""Standard deviation of the heights of a component's points about the component's height (body, leads, board between).

The second value is that of the mean height of those points that one pair of frames links. Without them, links on
components counted like those on the bare board, and estimated a bow of up to 0.8 mm that was not there
in the hostile suite."""
_SHARE = 0.3
"""Least value of the same, as a share of the component's height.

Points of tall components lie anywhere between the board and the top: heights that are distributed evenly scatter by
0.29 of the largest."""
_SIDE_MM = 0.1
"""The same for links between two cameras beside a component: each camera sees another side of it, or its shadow."""
_BESIDE_SHARE, _LOW_MM = 0.58, 0.5
"""Root mean square height of points on the side of a component, as a share of that part of its height that exceeds
`_LOW_MM`. The sides of lower components hardly reach into patches beside them."""


def stable_order(numbers: Ints) -> Ints:
    """Return the indices that sort numbers (k,) ≥ 0, those of equal ones in their order."""
    # short numbers are sorted in time proportional to their number
    return np.argsort(numbers.astype(np.int16) if numbers.max(initial=0) < 1 << 15 else numbers, kind="stable")


class HeightScatter:
    """The scatter of the heights of k links' points about the modelled heights.

    Points of one component lie at different heights, and those beside it on its side or on the board. Their mean height
    in one pair of frames is an error that its links have in common, so that links on one body never outweigh few on the
    board. Both grow with the component's height, which the adjustment estimates.
    """

    cell: Ints  # (k,) number of the links on or beside one component in one pair of frames; −1 on the bare board

    def __init__(self, problem: Problem, height: Ints, parts: int) -> None:
        """Find the component on or beside which each link lies.

        Args:
            height: (k,) index of the height of each link, or −1.
            parts: number of components with links.
        """
        links, on = problem.links, problem.component >= 0
        self._beside = problem.reaches_component & ~on
        sides = self._beside & (links.p == links.q)
        self._part = np.where(self._beside, problem.near, problem.component) if len(problem.near) else problem.component
        # Sides at a seam have their heights in common, whatever component they belong to.
        beside = np.where(sides, 2 * parts, 2 * parts + 1 + self._part)
        shared = np.where(self._beside, beside, height)
        self.cell, tied = np.full(len(shared), -1), np.flatnonzero(shared >= 0)
        # The links of one pair of frames are adjacent, also among those of one component.
        tied = tied[stable_order(shared[tied])]
        new = np.diff(links.group[tied], prepend=-1) != 0
        new |= np.diff(shared[tied], prepend=-1) != 0
        self.cell[tied] = np.cumsum(new) - 1
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


class HeightEquations(NamedTuple):
    """The normal equations of c component heights, and their coupling to the other unknowns."""

    entries: (
        Floats  # entries of the normal matrix between each height and the other unknowns, in the order of `Coupling`
    )
    normal: Floats  # (c,) diagonal of the normal matrix of the heights, which are not coupled to one another
    right: Floats  # (c,) right-hand side of the heights' normal equations

    def less(self, part: HeightEquations) -> HeightEquations:
        """Return the equations without a part of their observations."""
        return HeightEquations(*(a - b for a, b in zip(self, part, strict=True)))

    def zeros(self) -> HeightEquations:
        """Return equations of the same heights without any observation or prior."""
        return HeightEquations(*(np.zeros_like(values) for values in self))


class Coupling(NamedTuple):
    """The unknowns to which each of c component heights is coupled: a range of rows, the surface, a range of cameras.

    The entries of a height in `HeightEquations.entries` begin at `at` and stand in the order of their columns: (φ, sx,
    sy) of its rows, the coefficients of the surface, (x, y, turn) of its cameras. A height without links has none.
    """

    at: Ints  # (c + 1,)
    columns: Ints  # column of the normal matrix of each entry
    of_row: Ints  # (c,) the entries with row j begin at `of_row` + 3·j
    of_surface: Ints  # (c,) the entry with the first coefficient of the surface
    of_camera: Ints  # (c,) the entries with camera i begin at `of_camera` + 3·i
    furthest: Ints  # (m,) the last row with which each row shares an observation or a component, or itself
    surface_column: int
    camera_column: int  # −1 if the cameras are taken as exact

    @staticmethod
    def of(
        component: Ints, heights: int, links: LinkArrays, rows: int, surface: int, columns: tuple[int, int]
    ) -> Coupling:
        """Couple heights to the unknowns of the links that lie on the components.

        Args:
            component: (k,) index of the height of every link, or −1.
            heights: number c of heights.
            rows: number m of rows.
            surface: number of coefficients of the surface.
            columns: column of the first of them, and of the first displacement of a camera; −1 for exact cameras.
        """
        low, high, on = np.minimum(links.p, links.q), np.maximum(links.p, links.q), np.flatnonzero(component >= 0)
        row, left = (np.full(heights, most) for most in (rows, 1 << 30))
        last, right = np.full(heights, -1), np.full(heights, -1)
        of = component[on]
        for grow, ends, values in (
            (np.minimum, row, low), (np.minimum, left, links.camera_a),
            (np.maximum, last, high), (np.maximum, right, links.camera_b),
        ):  # fmt: skip
            grow.at(ends, of, values[on])
        seen, surface_column, camera_column = last >= 0, *columns
        of_rows = np.where(seen, 3 * (last - row + 1), 0)
        of_cameras = np.where(seen, 3 * (right - left + 1), 0) if camera_column >= 0 else np.zeros(heights, np.int_)
        width = of_rows + surface * seen + of_cameras
        at = np.append(0, np.cumsum(width))
        height = np.repeat(np.arange(heights), width)
        k = np.arange(at[-1]) - at[height]
        beyond = k - of_rows[height]
        others = np.where(
            beyond < surface, surface_column + beyond, camera_column + 3 * left[height] + beyond - surface
        )
        # Rows are coupled that are consecutive (prior of the belt), that a link connects, or that see one component.
        furthest = np.minimum(np.arange(rows) + 1, rows - 1)
        np.maximum.at(furthest, low, high)
        np.maximum.at(furthest, row[seen], last[seen])
        begin = at[:-1]
        return Coupling(
            at, np.where(beyond < 0, 3 * row[height] + k, others), begin - 3 * row, begin + of_rows,
            begin + of_rows + surface - 3 * left, furthest, surface_column, camera_column,
        )  # fmt: skip

    def equations(self, heights_mm: Floats, sigma_mm: float, sunk_mm: float) -> HeightEquations:
        """Return the equations of changes of the component heights (c,) without any link: only their prior.

        The prior expects a height of 0 with standard deviation `sigma_mm`. As components stand above the board, the
        standard deviation of heights that are below 0 is `sunk_mm`.
        """
        normal = np.where(heights_mm < 0, 1 / sunk_mm**2, 1 / sigma_mm**2)
        return HeightEquations(np.zeros(len(self.columns)), normal, -heights_mm * normal)

    def add(self, heights: HeightEquations, part: HeightEquations, coupling: Coupling, numbers: Ints) -> None:
        """Add to `heights` those of the first rows, which have the numbers (c,) here and the coupling `coupling`."""
        column, first_camera = coupling.columns, coupling.camera_column
        height = np.repeat(numbers, np.diff(coupling.at))
        at = np.where(
            column < 3 * len(coupling.furthest),
            self.of_row[height] + column,
            self.of_surface[height] + column - coupling.surface_column,
        )
        if first_camera >= 0:
            at = np.where(column >= first_camera, self.of_camera[height] + column - first_camera, at)
        heights.entries[at] += part.entries
        heights.normal[numbers] += part.normal
        heights.right[numbers] += part.right

    def changes(self, heights: HeightEquations, delta: Floats) -> Floats:
        """Return the changes (c,) of component heights, mm, that follow from changes (n,) of all other unknowns."""
        effect, coupled = np.zeros(len(heights.normal)), np.flatnonzero(np.diff(self.at))
        if len(coupled):
            effect[coupled] = np.add.reduceat(heights.entries * delta[self.columns], self.at[coupled])
        return np.asarray((heights.right - effect) / heights.normal)


@compiled
def eliminate_heights(coupling: Coupling, heights: HeightEquations, normal: NormalEquations) -> None:
    """Eliminate the heights: subtract their Schur complement from the normal equations of the other unknowns."""
    at, values, right, entries, columns = normal.at, normal.values, normal.right, heights.entries, coupling.columns
    for c in range(len(heights.normal)):
        begin = coupling.at[c]
        for a in range(begin, coupling.at[c + 1]):
            own = entries[a] / heights.normal[c]
            if own != 0:
                i = columns[a]
                right[i] -= own * heights.right[c]
                for b in range(begin, a + 1):
                    # columns ascend, so that this is in the lower triangle
                    values[at[i] + columns[b]] -= own * entries[b]


class LinkState(NamedTuple):
    """Values that each step of the adjustment computes for k links; the arrays are overwritten in place."""

    residual: Floats  # (k, 2) residual r, mm
    lean: Floats  # (k, 2) change l of the residual per mm of height of the point
    sigma: Floats  # (k,) length of the residual in standard deviations: rms of its two axes
    robust: Floats  # (k,) robust weight, 0 … 1
    weight: Floats  # (k, 3) entries xx, xy, yy of the weight matrix, mm⁻²
    a_mm: Floats  # (k, 2) first point on the ground, as the cameras see it with their current displacements
    b_mm: Floats  # (k, 2) second point

    @staticmethod
    def of(links: LinkArrays, *, movable: bool) -> LinkState:
        """Return the state of k links before the first step; `movable` says whether cameras may be displaced."""
        k = len(links.p)
        seen = (np.empty((k, 2)), np.empty((k, 2))) if movable else (links.a_mm, links.b_mm)
        return LinkState(np.zeros((k, 2)), np.zeros((k, 2)), np.zeros(k), np.zeros(k), np.zeros((k, 3)), *seen)


class NoiseModel(NamedTuple):
    """The noise of k links by kind of link, and the limits of the robust loss, in standard deviations."""

    kind: Ints  # (k,) kind of each link, an index into `floor_px` and `shared_px`
    floor_px: Floats  # (n,) noise floor of each of n kinds: scatter of single links beyond image noise
    shared_px: Floats  # (n,) for each kind, σ of the error that all links of one pair of frames have in common
    knee: float  # residuals beyond this lose weight (Huber)
    cut: float  # residuals beyond this have no weight
    raised: NDArray[np.bool_]  # (k,) whether each link may lie above the modelled height: on a component or its leads
    scatter_mm: Floats  # (k,) σ of the height of each link's point about the modelled height; 0 on the bare board
    cell: Ints  # (k,) number of the cell of each link (`HeightScatter.cell`); −1 on the bare board
    common_mm: Floats  # (k,) σ of the mean height of the points of each link's cell, which its links have in common
    plainly: float  # height above the bare board from which on a point loses weight; infinite for none


class PointHeights(NamedTuple):
    """The heights of k links' points above the calibrated plane: that of the surface plus that of a component."""

    basis: Floats  # (k, f) values of the surface's f basis functions
    surface_mm: Floats  # (f,) coefficients of the surface
    component: Ints  # (k,) index of the component height, −1 for the last one, which is 0
    component_mm: Floats  # (c + 1,)


@compiled
def compute_residuals(
    links: LinkArrays, motion: MotionArrays, changes: Floats, points: PointHeights, state: LinkState
) -> None:
    """Write to `state` residual and lean of every link, for points at their heights above the calibrated plane.

    The homographies `changes` (n, 3, 3) of n displaced cameras move the ground points first; 0 cameras are exact.
    """
    p, q, a_mm, b_mm, a_lean, b_lean = links.p, links.q, state.a_mm, state.b_mm, links.a_lean, links.b_lean
    shift, pivot, residual, lean = motion.shift, motion.pivot, state.residual, state.lean
    cos, sin = np.cos(motion.angle), np.sin(motion.angle)
    for n in range(len(p)):
        i, j = p[n], q[n]
        if len(changes):
            h, x, y = changes[links.camera_a[n]], links.a_mm[n, 0], links.a_mm[n, 1]
            w = h[2, 0] * x + h[2, 1] * y + h[2, 2]
            a_mm[n, 0], a_mm[n, 1] = (
                (h[0, 0] * x + h[0, 1] * y + h[0, 2]) / w,
                (h[1, 0] * x + h[1, 1] * y + h[1, 2]) / w,
            )
            h, x, y = changes[links.camera_b[n]], links.b_mm[n, 0], links.b_mm[n, 1]
            w = h[2, 0] * x + h[2, 1] * y + h[2, 2]
            b_mm[n, 0], b_mm[n, 1] = (
                (h[0, 0] * x + h[0, 1] * y + h[0, 2]) / w,
                (h[1, 0] * x + h[1, 1] * y + h[1, 2]) / w,
            )
        ax, ay, bx, by = a_mm[n, 0] - pivot[0], a_mm[n, 1] - pivot[1], b_mm[n, 0] - pivot[0], b_mm[n, 1] - pivot[1]
        lx = cos[j] * b_lean[n, 0] - sin[j] * b_lean[n, 1] - cos[i] * a_lean[n, 0] + sin[i] * a_lean[n, 1]
        ly = sin[j] * b_lean[n, 0] + cos[j] * b_lean[n, 1] - sin[i] * a_lean[n, 0] - cos[i] * a_lean[n, 1]
        dx = cos[j] * bx - sin[j] * by + shift[j, 0] - cos[i] * ax + sin[i] * ay - shift[i, 0]
        dy = sin[j] * bx + cos[j] * by + shift[j, 1] - sin[i] * ax - cos[i] * ay - shift[i, 1]
        height = points.component_mm[points.component[n]]
        for k in range(len(points.surface_mm)):
            height += points.basis[n, k] * points.surface_mm[k]
        residual[n, 0], residual[n, 1] = dx + lx * height, dy + ly * height
        lean[n, 0], lean[n, 1] = lx, ly


@compiled
def compute_weights(links: LinkArrays, noise: NoiseModel, state: LinkState) -> None:
    """Compute sigma, robust weight and weight matrix of every link from its residual.

    A link may lie above the modelled height (`noise.raised`). If its residual shows this, its weight along the lean is
    that of a point of unknown height. If not, it keeps its weight, since components stand above the board. Points of
    the bare board lose weight if they lie plainly above it (`noise.plainly`): on a part that the board type lacks.

    The points of one component have different heights: body, leads, solder, board in between. Two cameras see different
    sides of it. The scatter of heights is noise along the lean. The mean height of the few corners that a pair of
    frames shows (a cell) has an error in common, which limits the sum of their weights. Links whose patches overlap
    share the noise of their pixels, and weigh together as much as one. The links of one pair of frames have an error in
    common: its inverse variance limits the sum of their weights.

    Of `state` residual and lean are read; sigma, robust weight and weight are written.
    """
    px_per_mm, group, noise_mm2, kind = links.px_per_mm, links.group, links.noise_mm2, noise.kind
    floor_px, shared_px, knee, cut = noise.floor_px, noise.shared_px, noise.knee, noise.cut
    residual, sigma, robust, weight = state.residual, state.sigma, state.robust, state.weight
    of_group, of_cell = np.zeros(group[-1] + 1 if len(group) else 0), np.zeros(len(residual))
    for n in range(len(residual)):
        floor = (floor_px[kind[n]] / px_per_mm[n]) ** 2
        a, b, d = noise_mm2[n, 0, 0] + floor, noise_mm2[n, 0, 1], noise_mm2[n, 1, 1] + floor
        determinant = a * d - b * b
        xx, xy, yy = d / determinant, -b / determinant, a / determinant
        x, y = residual[n, 0], residual[n, 1]
        lx, ly = state.lean[n, 0], state.lean[n, 1]
        wx, wy = xx * lx + xy * ly, xy * lx + yy * ly
        information = lx * wx + ly * wy
        if noise.scatter_mm[n] > 0:
            variance = noise.scatter_mm[n] ** 2
            k = 1 / (1 + information * variance)
            xx, xy, yy = xx - k * variance * wx * wx, xy - k * variance * wx * wy, yy - k * variance * wy * wy
            wx, wy, information = k * wx, k * wy, k * information
        # The height that the residual shows, times the information.
        height = -(wx * x + wy * y)
        # In standard deviations. Noise alone makes a point of the bare board look raised by one.
        if noise.raised[n] and height > math.sqrt(information):
            own = (height - math.sqrt(information)) / information
            k = 1 / (information + 1 / own**2)
            xx, xy, yy = xx - k * wx * wx, xy - k * wx * wy, yy - k * wy * wy
        sigma[n] = math.sqrt(max(xx * x * x + 2 * xy * x * y + yy * y * y, 0.0) / 2)
        robust[n] = 1.0 if sigma[n] <= knee else knee / sigma[n] if sigma[n] <= cut else 0.0
        if not noise.raised[n] and noise.scatter_mm[n] == 0 and information > 0:
            robust[n] /= 1 + max(height / math.sqrt(information) - noise.plainly, 0.0) ** 2
        part = robust[n] / links.overlap[n]
        weight[n, 0], weight[n, 1], weight[n, 2] = part * xx, part * xy, part * yy
        if noise.cell[n] >= 0:
            of_cell[noise.cell[n]] += weight[n, 0] * lx * lx + 2 * weight[n, 1] * lx * ly + weight[n, 2] * ly * ly
    # n equal weights w with a common variance s² sum to n·w / (1 + n·w·s²), which stays below 1 / s²
    for n in range(len(residual)):
        lx, ly = state.lean[n, 0], state.lean[n, 1]
        wx, wy = weight[n, 0] * lx + weight[n, 1] * ly, weight[n, 1] * lx + weight[n, 2] * ly
        information = lx * wx + ly * wy
        if noise.cell[n] >= 0 and information > 0:
            k = (1 - 1 / (1 + of_cell[noise.cell[n]] * noise.common_mm[n] ** 2)) / information
            weight[n, 0], weight[n, 1] = weight[n, 0] - k * wx * wx, weight[n, 1] - k * wx * wy
            weight[n, 2] -= k * wy * wy
        of_group[group[n]] += (weight[n, 0] + weight[n, 2]) / 2
    for n in range(len(residual)):
        share = 1 / (1 + of_group[group[n]] * (shared_px[kind[n]] / px_per_mm[n]) ** 2)
        for i in range(3):
            weight[n, i] *= share


class LinkModel(NamedTuple):
    """The unknowns on which links depend besides the rows: surface, component heights, camera displacements."""

    basis: Floats  # (k, f) values of the surface's f basis functions at the links; f may be 0
    component: Ints  # (k,) index of the component height, −1 for a link on the bare board
    coupling: Coupling
    row_changes: Floats  # (n, m, 3, 3) `CameraEffects.row_changes`


@compiled
def add_links(  # noqa: PLR0912, PLR0915  (one loop over links whose parts are inlined)
    links: LinkArrays,
    motion: MotionArrays,
    model: LinkModel,
    state: LinkState,
    heights: HeightEquations,
    normal: NormalEquations,
) -> None:
    """Add links to the normal equations of rows, surface and cameras, and to those of the heights.

    The links of one group (pair of frames) are adjacent and have the same rows p and q. Of `state` all but sigma and
    robust weight at this motion are used. All links of a group have the same unknowns: their whitened derivatives by
    φ_p, φ_q, a shift along x and y, and the surface are collected with their residuals, line by line, and multiplied at
    the end of the group in loops over links, which the compiler keeps in vector registers.
    """
    p, q, a_mm, b_mm, group, pivot = links.p, links.q, state.a_mm, state.b_mm, links.group, motion.pivot
    basis, coupling, entries, weight = model.basis, model.coupling, heights.entries, state.weight
    if len(p) == 0:
        return
    cos, sin = np.cos(motion.angle), np.sin(motion.angle)
    f, movable = basis.shape[1], coupling.camera_column >= 0
    largest, count = 0, 0
    for n in range(len(group)):
        count = count + 1 if n and group[n] == group[n - 1] else 1
        largest = max(largest, count)
    lines, count = np.empty((5 + f, 2 * largest)), 0
    # Of the small matrix of a group, the lines are those of row p, of row q, the surface, the residual, and the two
    # cameras. The derivatives by the shift of row p are those by the shift of row q with opposite sign.
    rest, width = 6 + f, 13 + f if movable else 7 + f
    products, square = np.empty((5 + f, 5 + f)), np.empty((width, width))
    of, sign, columns = np.zeros(rest + 1, np.int64), np.ones(rest + 1), np.zeros(width, np.int64)
    of[1], of[2], of[3], of[4], of[5], of[rest], sign[1], sign[2] = 2, 3, 1, 2, 3, 4 + f, -1.0, -1.0
    for k in range(f):
        of[6 + k], columns[6 + k] = 4 + k, coupling.surface_column + k
    for n in range(len(p)):
        i, j, camera_a, camera_b = p[n], q[n], links.camera_a[n], links.camera_b[n]
        ax, ay, bx, by = a_mm[n, 0] - pivot[0], a_mm[n, 1] - pivot[1], b_mm[n, 0] - pivot[0], b_mm[n, 1] - pivot[1]
        # upper Cholesky factor (u, v; 0, t) of the weight matrix
        u = math.sqrt(weight[n, 0])
        v = weight[n, 1] / u if u > 0 else 0.0
        t = math.sqrt(max(weight[n, 2] - v * v, 0.0))
        px, py = sin[i] * ax + cos[i] * ay, -cos[i] * ax + sin[i] * ay
        qx, qy = -sin[j] * bx - cos[j] * by, cos[j] * bx - sin[j] * by
        px, py, qx, qy = u * px + v * py, t * py, u * qx + v * qy, t * qy
        lx, ly = u * state.lean[n, 0] + v * state.lean[n, 1], t * state.lean[n, 1]
        rx, ry = u * state.residual[n, 0] + v * state.residual[n, 1], t * state.residual[n, 1]
        at = 2 * count
        lines[0, at], lines[1, at], lines[2, at], lines[3, at], lines[4 + f, at] = px, qx, u, v, rx
        lines[0, at + 1], lines[1, at + 1], lines[2, at + 1], lines[3, at + 1] = py, qy, 0.0, t
        lines[4 + f, at + 1] = ry
        for k in range(f):
            lines[4 + k, at], lines[4 + k, at + 1] = basis[n, k] * lx, basis[n, k] * ly
        count += 1
        c = model.component[n]
        if c >= 0:
            wlx, wly, pl, ql, ll = u * lx, v * lx + t * ly, px * lx + py * ly, qx * lx + qy * ly, lx * lx + ly * ly
            heights.normal[c] += ll
            heights.right[c] -= lx * rx + ly * ry
            for row, way, turn in ((i, -1.0, pl), (j, 1.0, ql)):
                start = coupling.of_row[c] + 3 * row
                entries[start] += turn
                entries[start + 1] += way * wlx
                entries[start + 2] += way * wly
            for k in range(f):
                entries[coupling.of_surface[c] + k] += ll * basis[n, k]
            if movable:
                by_a, by_b = model.row_changes[camera_a, i], model.row_changes[camera_b, j]
                at_a, at_b = coupling.of_camera[c] + 3 * camera_a, coupling.of_camera[c] + 3 * camera_b
                for k in range(3):
                    entries[at_a + k] += by_a[0, k] * pl - by_a[1, k] * wlx - by_a[2, k] * wly
                    entries[at_b + k] += by_b[0, k] * ql + by_b[1, k] * wlx + by_b[2, k] * wly
        if n + 1 < len(p) and group[n + 1] == group[n]:
            continue
        for k in range(5 + f):
            for m in range(k + 1):
                total = 0.0
                for x in range(2 * count):
                    total += lines[k, x] * lines[m, x]
                products[k, m] = products[m, k] = total
        for k in range(rest + 1):
            for m in range(rest + 1):
                square[k, m] = sign[k] * sign[m] * products[of[k], of[m]]
        for k in range(3):
            columns[k], columns[3 + k] = 3 * i + k, 3 * j + k
        if movable:
            for k in range(3):
                columns[rest + 1 + k] = coupling.camera_column + 3 * camera_a + k
                columns[rest + 4 + k] = coupling.camera_column + 3 * camera_b + k
            _add_cameras(model.row_changes[camera_a, i], model.row_changes[camera_b, j], rest + 1, square)
        _flush(columns, square, rest, normal)
        count = 0


@inlined
def _add_cameras(by_a: Floats, by_b: Floats, width: int, square: Floats) -> None:
    """Add the lines of two cameras, which are combinations of those of rows p and q, to the small matrix of a group.

    A displacement of a camera has the effect of a change of the row in which it saw its end of the links.
    """
    for k in range(3):
        for m in range(width):
            a, b = 0.0, 0.0
            for x in range(3):
                a, b = a + by_a[x, k] * square[x, m], b + by_b[x, k] * square[3 + x, m]
            square[width + k, m], square[width + 3 + k, m] = a, b
    for k in range(6):
        for m in range(3):
            a, b = 0.0, 0.0
            for x in range(3):
                a, b = a + square[width + k, x] * by_a[x, m], b + square[width + k, 3 + x] * by_b[x, m]
            square[width + k, width + m], square[width + k, width + 3 + m] = a, b


@inlined
def _flush(columns: Ints, square: Floats, rest: int, normal: NormalEquations) -> None:
    """Add the small matrix of a group to the normal equations; its line `rest` is the residual."""
    for k in range(len(columns)):
        if k == rest:
            continue
        normal.right[columns[k]] -= square[k, rest]
        for m in range(k + 1):
            if m != rest:
                high, low = max(columns[k], columns[m]), min(columns[k], columns[m])
                # for a link between two cameras p = q, and for one between two rows both cameras are the same: an entry
                # off the diagonal then falls on that of the normal matrix, together with its mirror image
                normal.values[normal.at[high] + low] += square[k, m] * (2 if high == low and k != m else 1)
