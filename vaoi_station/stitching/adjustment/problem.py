"""The input of an adjustment (links, points of known CAD coordinates, the board's surface), and its solution."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field, fields, replace
from functools import cached_property
from itertools import groupby
from operator import attrgetter
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from vaoi_station.compiled import compiled
from vaoi_station.geometry import Camera
from vaoi_station.geometry.camera import camera_arrays
from vaoi_station.geometry.displacement import PARAMETERS
from vaoi_station.geometry.projection_kernels import CameraArrays, raw_to_ground
from vaoi_station.geometry.transforms import Floats, apply
from vaoi_station.model import BoardType, Surface
from vaoi_station.stitching.adjustment.motion import Motion, RowStep, measure_step
from vaoi_station.stitching.matching.evidence import Links
from vaoi_station.stitching.matching.refinement import WINDOW_PX

Ints = NDArray[np.int_]


class LinkArrays(NamedTuple):
    """k links on the ground, in the form that compiled functions take. Links of one pair of frames are adjacent."""

    p: Ints  # (k,) row in which the first point was seen
    q: Ints  # (k,) row in which the second point was seen
    camera_a: Ints  # (k,) camera that saw the first point
    camera_b: Ints  # (k,) camera that saw the second point: the same, or the next one
    group: Ints  # (k,) number of the pair of frames from which each link comes
    a_mm: Floats  # (k, 2) first point on the ground
    b_mm: Floats  # (k, 2) second point on the ground
    a_lean: Floats  # (k, 2) displacement of the first point in mm per mm of height
    b_lean: Floats  # (k, 2) displacement of the second point in mm per mm of height
    noise_mm2: Floats  # (k, 2, 2) covariance of the residual that image noise alone causes
    px_per_mm: Floats  # (k,) resolution of the second image at each link
    overlap: Floats  # (k,) by how much the patches of its pair of frames cover each link's, its own included; ≥ 1


@dataclass(frozen=True, eq=False)
class Observations:
    """k links on the ground, with the evidence from which they come. The arrays are those of `LinkArrays`."""

    p: Ints
    q: Ints
    camera_a: Ints
    camera_b: Ints
    group: Ints
    a_mm: Floats
    b_mm: Floats
    a_lean: Floats
    b_lean: Floats
    noise_mm2: Floats
    px_per_mm: Floats
    overlap: Floats
    groups: tuple[Links, ...]  # the evidence of each pair of frames: link i comes from `groups[group[i]]`

    def __len__(self) -> int:
        return len(self.p)

    @cached_property
    def begins(self) -> Ints:
        """(g + 1,) index of the first link of each pair of frames, and the number of links."""
        return np.searchsorted(self.group, np.arange(len(self.groups) + 1))

    @cached_property
    def arrays(self) -> LinkArrays:
        """The same links for compiled functions."""
        return LinkArrays._make(getattr(self, name) for name in LinkArrays._fields)

    def select(self, at: Ints) -> Observations:
        """Return the links with these indices, in this order."""
        # `take` copies whole entries, which indexing does number by number
        return Observations(**{n: v.take(at, axis=0) for n, v in self.arrays._asdict().items()}, groups=self.groups)

    @property
    def seam(self) -> Ints:
        """(k,) of each link between two cameras the lower of their numbers; −1 for links from row to row."""
        return np.where(self.camera_a != self.camera_b, self.camera_a, -1)

    def median_noise_px(self, at: Ints) -> float:
        """Return the median standard deviation per axis, px, that image noise causes in the links `at`; 0 without."""
        if not len(at):
            return 0.0
        noise_mm2 = self.noise_mm2.take(at, axis=0)
        variance_mm2 = (noise_mm2[:, 0, 0] + noise_mm2[:, 1, 1]) / 2
        return float(np.median(np.sqrt(variance_mm2) * self.px_per_mm[at]))


@dataclass(frozen=True, eq=False)
class RowPair:
    """The links of two rows p and q of all cameras, on the ground; if p = q, those of neighbouring cameras."""

    links: tuple[Links, ...]
    used: tuple[Links, ...]  # those that are not empty
    arrays: LinkArrays  # `group` counts from 0

    @cached_property
    def step(self) -> RowStep:
        """What the links show of the motion from row p to row q."""
        v = self.arrays
        return measure_step(*self.links[0].rows, v.a_mm, v.b_mm, v.noise_mm2, v.px_per_mm, v.overlap)


class LinkStore:
    """The links of a run on the ground, in parts of two rows each.

    A part depends on its links alone. It is made when they are complete, while the board passes, and used again in the
    conclusion, however the links arrived. So are the arrays in which the parts of a run follow one another.
    """

    def __init__(self, cameras: Sequence[Camera]) -> None:
        self._cameras = camera_arrays(cameras)
        self._parts: dict[tuple[int, int], RowPair] = {}  # the last part that was made of each pair of rows
        self._laid: list[RowPair] = []
        self._ends, self._groups = [0], [0]  # number of links, and of pairs of frames, up to each of `_laid`
        self._arrays = _NO_LINKS
        self._read = 0  # number of parts in `_arrays` that observations refer to

    def part(self, links: tuple[Links, ...]) -> RowPair:
        """Return the part of these links of two rows; it is made if the last one of these rows had others."""
        rows = links[0].rows
        known = self._parts.get(rows)
        if known is None or known.links != links:
            known = self._parts[rows] = self._projected(links)
        return known

    def _projected(self, links: tuple[Links, ...]) -> RowPair:
        used = tuple(e for e in links if len(e.a_px))
        if not used:
            return RowPair(links, used, _NO_LINKS)
        counts, (p, q) = np.array([len(e.a_px) for e in used]), links[0].rows
        pairs = np.array([(e.task.a[0], (e.task.b or e.task.a)[0]) for e in used])
        a_px, b_px, information = (
            np.concatenate([getattr(e, name) for e in used]) for name in ("a_px", "b_px", "information")
        )
        columns = _project_links(a_px, b_px, information, np.cumsum(counts), pairs, self._cameras)
        group = np.repeat(np.arange(len(used)), counts)
        rows = np.full(len(group), p), np.full(len(group), q)
        return RowPair(links, used, LinkArrays._make([*rows, *pairs[group].T, group, *columns]))

    def motions_mm(self, links: tuple[Links, ...]) -> tuple[Floats, Ints]:
        """Return the motions (k, 2) on the conveyor's plane that links of two rows measure.

        The second array (k,) numbers the pairs of frames, of those that have links.
        """
        arrays = self.part(links).arrays
        return arrays.b_mm - arrays.a_mm, arrays.group

    def lay(self, last: int | None = None) -> None:
        """Bring the parts that were made into the order of a run: those of rows up to `last`."""
        ordered = sorted((q, p) for p, q in self._parts if last is None or q <= last)
        self._lay([self._parts[p, q] for q, p in ordered])

    def _lay(self, parts: Sequence[RowPair]) -> None:
        """Make `_arrays` begin with these parts, one after the other."""
        same = 0
        while same < min(len(parts), len(self._laid)) and parts[same] is self._laid[same]:
            same += 1
        size = self._ends[same] + sum(len(part.arrays.p) for part in parts[same:])
        if same < self._read or size > len(self._arrays.p):
            # With twice the room, few copies are made. What observations refer to is never changed.
            begin = self._ends[same]
            self._arrays = LinkArrays._make(_enlarged(v, begin, 2 * size) for v in self._arrays)
            self._read = 0
        del self._laid[same:], self._ends[same + 1 :], self._groups[same + 1 :]
        for part in parts[same:]:
            begin, end = self._ends[-1], self._ends[-1] + len(part.arrays.p)
            for column, values in zip(self._arrays, part.arrays, strict=True):
                column[begin:end] = values
            self._arrays.group[begin:end] += self._groups[-1]
            self._laid.append(part)
            self._ends.append(end)
            self._groups.append(self._groups[-1] + len(part.used))

    def observations(self, links: Iterable[tuple[Links, ...]]) -> Observations:
        """Return the links of pairs of rows, in the given order, as observations."""
        parts = [self.part(own) for own in links]
        self._lay(parts)
        self._read = max(self._read, len(parts))
        arrays = {name: v[: self._ends[-1]] for name, v in self._arrays._asdict().items()}
        return Observations(**arrays, groups=tuple(e for part in parts for e in part.used))


def _enlarged(values: NDArray[Any], kept: int, size: int) -> NDArray[Any]:
    out = np.empty((size, *values.shape[1:]), values.dtype)
    out[:kept] = values[:kept]
    return out


_NO_LINKS = LinkArrays._make([*np.zeros((5, 0), np.int_), *np.zeros((4, 0, 2)), np.zeros((0, 2, 2)), *np.zeros((2, 0))])


def to_observations(links: Sequence[Links], cameras: Sequence[Camera]) -> Observations:
    """Project the links of pairs of frames to the ground and return them as observations, in the same order."""
    return LinkStore(cameras).observations([tuple(own) for _, own in groupby(links, attrgetter("rows"))])


@compiled
def _project_links(
    a_px: Floats, b_px: Floats, information: Floats, ends: Ints, pairs: Ints, cameras: CameraArrays
) -> tuple[Floats, Floats, Floats, Floats, Floats, Floats, Floats]:
    """Project k links to the ground; return the columns of `LinkArrays` from `a_mm` on.

    `information` (k, 2, 2) is the inverse covariance of the points in the second image, px⁻². The links of pair n of
    frames end before `ends[n]`; `pairs` (n, 2) are its cameras.

    A patch by itself has an overlap of 1, each of two patches that cover half of each other 1.5. Patches that overlap
    share the noise of the pixels in both: n equal ones show no more than a single one.
    """
    points, leans, eye = np.empty((2, len(a_px), 2)), np.empty((2, len(a_px), 2)), cameras.viewpoint
    covariance, resolution, overlap = np.empty_like(information), np.empty(len(a_px)), np.ones(len(a_px))
    n = begin = 0
    for k in range(len(a_px)):
        if k == ends[n]:
            n, begin = n + 1, k
        for other in range(begin, k):
            across, down = abs(a_px[k, 0] - a_px[other, 0]), abs(a_px[k, 1] - a_px[other, 1])
            if across < WINDOW_PX and down < WINDOW_PX:
                share = (1 - across / WINDOW_PX) * (1 - down / WINDOW_PX)
                overlap[k] += share
                overlap[other] += share
        camera_a, camera_b = pairs[n, 0], pairs[n, 1]
        u = v = 0.0
        for end in range(2):
            i, px = (camera_a, a_px[k]) if end == 0 else (camera_b, b_px[k])
            x, y, u, v = raw_to_ground(px[0], px[1], i, cameras)
            points[end, k, 0], points[end, k, 1] = x, y
            leans[end, k, 0], leans[end, k, 1] = (eye[i, 0] - x) * eye[i, 2], (eye[i, 1] - y) * eye[i, 2]
        # After this loop, u and v are pixels of the second image, in which the information matrix is stated.
        m, x, y = cameras.image_from_row[camera_b], points[1, k, 0], points[1, k, 1]
        w = x * m[2, 0] + y * m[2, 1] + m[2, 2]
        a, b = (m[0, 0] - u * m[2, 0]) / w, (m[0, 1] - u * m[2, 1]) / w
        c, d = (m[1, 0] - v * m[2, 0]) / w, (m[1, 1] - v * m[2, 1]) / w
        slope = a * d - b * c
        p, q, r = information[k, 0, 0], information[k, 0, 1], information[k, 1, 1]
        # J⁻¹·I⁻¹·J⁻ᵀ is the inverse of Jᵀ·I·J, where J is the Jacobian (a, b; c, d) of the image by the ground
        xx = a * a * p + 2 * a * c * q + c * c * r
        xy = a * b * p + (a * d + b * c) * q + c * d * r
        yy = b * b * p + 2 * b * d * q + d * d * r
        det = slope * slope * (p * r - q * q)
        covariance[k, 0, 0], covariance[k, 1, 1] = yy / det, xx / det
        covariance[k, 0, 1] = covariance[k, 1, 0] = -xy / det
        resolution[k] = np.sqrt(abs(slope))
    return points[0], points[1], leans[0], leans[1], covariance, resolution, overlap


USED = 0.1  # robust weight above which a link counts as used
FIXTURE, REFERENCE = -1, -2  # values of `FiducialPoints.which` for fixture marks and for points of a reference run


@dataclass(frozen=True, eq=False)
class FiducialPoints:
    """k observed points of known CAD coordinates: detections of fiducials and fixture marks, points of a reference."""

    row: Ints  # (k,) row in which each point was seen
    ground_mm: Floats  # (k, 2) observed point on the ground plane
    lean: Floats  # (k, 2) displacement of each ground point, mm, per mm of height
    cad: Floats  # (k, 2) CAD coordinates; y is already flipped if the CAD mapping mirrors
    sigma_mm: Floats  # (k,) standard deviation of the observed point, per axis
    px_per_mm: Floats  # (k,) resolution of the frame at each point
    which: Ints  # (k,) index of the fiducial of the board type; `FIXTURE` or `REFERENCE`, both negative, for others
    camera: Ints  # (k,) camera that saw each point

    @staticmethod
    def joined(parts: Sequence[FiducialPoints]) -> FiducialPoints:
        """Concatenate several sets of observed points to one."""
        return FiducialPoints(*(np.concatenate([getattr(p, f.name) for p in parts]) for f in fields(FiducialPoints)))

    def select(self, at: Ints) -> FiducialPoints:
        """Return the points of these indices only."""
        return FiducialPoints(*(getattr(self, f.name)[at] for f in fields(self)))

    @property
    def fixture_marks(self) -> int:
        """Number of fixture marks among the points, each counted once."""
        return len(np.unique(self.cad[self.which == FIXTURE], axis=0))

    def place(self, rows: Ints) -> bool:
        """Return whether at least two different points in these rows place the board there, without any links."""
        return len(np.unique(self.cad[np.isin(self.row, rows)], axis=0)) >= 2

    @staticmethod
    def empty() -> FiducialPoints:
        """Return a set of observed points without any point."""
        pairs, no = np.zeros((0, 2)), np.zeros(0, dtype=np.int_)
        return FiducialPoints(no, pairs, pairs, pairs, np.zeros(0), np.zeros(0), no, no)


@dataclass(frozen=True, eq=False)
class SurfaceBasis:
    """The f basis functions of the surface: their values at links and detections, and the priors of coefficients."""

    at_links: Floats  # (k, f) values of the basis functions at the k links
    at_fiducials: Floats  # (s, f) values of the basis functions at the s points of `Problem.fiducials`
    sigma_mm: Floats  # (f,) prior standard deviation of each coefficient


@dataclass(frozen=True, eq=False)
class Problem:
    """All observations and priors of an adjustment."""

    times_s: Floats  # (m,) time of each row's pulse
    velocity_mm_s: Floats  # (2,) nominal velocity of the conveyor
    links: Observations
    component: Ints  # (k,) index of the component on which each link lies, −1 for the bare board
    fiducials: FiducialPoints | None = None
    nominal_scale: float = 1.0  # nominal scale of C, mm per CAD unit
    surface: SurfaceBasis | None = None  # None if the board is assumed to lie in the calibrated plane
    near: Ints = field(default_factory=lambda: np.zeros(0, np.int_))
    """(k,) component that the patch of each link may reach, −1 for none; empty if the components are not placed."""
    cameras: tuple[Camera, ...] = ()  # those whose displacements are estimated; none if the calibration is exact
    light: Ints = field(default_factory=lambda: np.zeros(0, np.int_))
    """(m,) number of the light of each row; empty if all rows have one light."""

    def begins_with(self, first: Problem) -> bool:
        """Return whether the first links of this problem are those of another one."""
        groups, count = first.links.groups, len(first.links)
        if self.links.groups[: len(groups)] != groups or int(self.links.begins[len(groups)]) != count:
            return False
        # As many links may be left of the same frames, but other ones: which lie off the board follows from C.
        return np.array_equal(self.links.a_mm[:count], first.links.a_mm)

    def select(self, at: Ints) -> Problem:
        """Return the problem with the links of these indices only."""
        near = self.near[at] if len(self.near) else self.near
        surface = self.surface and replace(self.surface, at_links=self.surface.at_links[at])
        return replace(self, links=self.links.select(at), component=self.component[at], near=near, surface=surface)

    @property
    def reaches_component(self) -> NDArray[np.bool_]:
        """(k,) whether the patch of each link may reach a component."""
        return self.near >= 0 if len(self.near) else np.zeros(len(self.links), np.bool_)

    @property
    def of_two_lights(self) -> NDArray[np.bool_]:
        """(k,) whether each link joins two rows of different lights."""
        if not len(self.light):
            return np.zeros(len(self.links), np.bool_)
        return np.asarray(self.light[self.links.p] != self.light[self.links.q])


@dataclass(frozen=True, eq=False)
class CameraEstimate:
    """The displacements of n cameras against their calibration, as one run shows them."""

    displacement_px: Floats  # (n, 3) estimated x, y and turn of each camera, px
    covariance: Floats  # (3n, 3n) covariance of the estimated displacements, px²
    cross: Floats  # (m, u, 3n) their covariance with the u unknowns of `AdjustmentResult.covariance`, by row
    information: Floats
    """(3n, 3n) px⁻², information matrix of the displacements by the run alone, without any prior on them.

    It contains no information about a motion of the whole array, because pictures of a board do not show one."""
    vector: Floats  # (3n,) px⁻¹, product of `information` and the displacements that fit the run best without a prior
    rivals: tuple[int, ...] = ()  # cameras that may have moved instead of those with a displacement

    def alone(self, camera: int) -> Floats:
        """Return the displacements (n, 3) px that fit the run best if only this camera has moved."""
        displacement_px = np.zeros_like(self.displacement_px)
        own = slice(PARAMETERS * camera, PARAMETERS * (camera + 1))
        displacement_px[camera] = np.linalg.lstsq(self.information[own, own], self.vector[own], rcond=None)[0]
        return displacement_px

    def fit(self, displacement_px: Floats) -> float:
        """Return by how much displacements (n, 3) px reduce χ² of the run, without any prior on them."""
        d = displacement_px.ravel()
        return float(2 * d @ self.vector - d @ self.information @ d)


@dataclass(frozen=True, eq=False)
class Influence:
    """How the solution changes without c groups of observations, each left out by itself (`influence.py`)."""

    change: Floats  # (c, m, u) for each group and row, change of the u unknowns of `AdjustmentResult.covariance`
    growth: Floats  # (c, m, u, u) growth of their covariance: that of the change, if the noise model is right
    grids: NDArray[np.bool_]
    """(c, 4) the grids in which each group of links is a cluster; none for a group of points of `Problem.fiducials`."""
    marks: int  # number of marks that were left out in turn, with those without which little changes

    @property
    def of_marks(self) -> NDArray[np.bool_]:
        """(c,) whether each group is of points of `Problem.fiducials`."""
        return np.logical_not(self.grids.any(1))

    def select(self, at: NDArray[np.bool_]) -> Influence:
        """Return the influence of these groups only."""
        return Influence(self.change[at], self.growth[at], self.grids[at], self.marks)


class LinkHeights(NamedTuple):
    """The heights above the board's surface that k links measure."""

    mm: Floats
    sigma_mm: Floats
    aside: Floats  # (k,) length of the part of the residual that no height explains, in standard deviations
    place_mm: Floats  # (k, 2) place of the point at this height, tester coordinates
    lean: Floats  # (k,) change of the residual, mm per mm of height


@dataclass(frozen=True, eq=False)
class AdjustmentResult:
    """The solution of an adjustment with its covariance and its residuals."""

    motion: Motion
    similarity: Floats | None
    """(4,) C as (a, b, x, y): board = [a −b; b a]·cad + (x, y). None if the problem has no fiducials."""
    surface_mm: Floats  # (f,) coefficients of the surface, mm
    heights_mm: Floats
    """(2, number of components) component heights: first from links between rows, second from links between cameras.
    NaN if a component has too few links, or if it is so tall that its links are outliers."""
    covariance: Floats
    """(m, u, u) for each row, the covariance of its (φ, sx, sy) together with C and the surface. Row 0 is fixed by the
    gauge: the entries of its (φ, sx, sy) are 0."""
    link_sigma: Floats  # (k,) residual of each link in standard deviations
    link_px: Floats  # (k, 2) residual of each link in px, along the axes of tester coordinates
    weight: Floats  # (k,) final robust weight of each link, 0 … 1; a link of weight 0 has no influence
    fiducial_px: Floats  # (s, 2) residuals of the points of `Problem.fiducials` in px
    floor_px: float  # noise floor of the links between rows
    sigma0: float  # root of the reduced χ² of the links: 1 if their residuals are as large as their noise model states
    problem: Problem  # with the displacements of the cameras applied to its links, points and cameras
    cameras: CameraEstimate | None = None  # None if the calibration was taken as exact
    influence: Influence | None = None  # of single places and marks; None if it is small, or was not examined

    def link_heights(self, at: Ints, least_floor_px: float = 0.0) -> LinkHeights:
        """Return the height above the board's surface that each of the links `at` (k,) measures, taken as one point.

        With the residual r that the link has on the surface, the change l of r per mm of height, and the inverse W of
        the covariance of r, it is h = −(l·W·r) / (l·W·l), with variance 1 / (l·W·l).
        """
        o, motion, surface = self.problem.links.select(at), self.motion, self.problem.surface
        on_surface = surface.at_links.take(at, axis=0) @ self.surface_mm if surface else np.zeros(len(at))
        lean, first = motion.turned(o.p, o.a_lean), motion.board(o.p, o.a_mm)
        change = motion.turned(o.q, o.b_lean) - lean
        (x, y), (lx, ly) = (motion.board(o.q, o.b_mm) - first + change * on_surface[:, None]).T, change.T
        floor_mm2 = (max(self.floor_px, least_floor_px) / o.px_per_mm) ** 2
        # the covariance of r
        a, b, d = o.noise_mm2[:, 0, 0] + floor_mm2, o.noise_mm2[:, 0, 1], o.noise_mm2[:, 1, 1] + floor_mm2
        determinant = a * d - b * b
        wx, wy = (d * lx - b * ly) / determinant, (a * ly - b * lx) / determinant
        # If both frames see the point under the same angle, l is almost 0, and the standard deviation large.
        information = np.maximum(lx * wx + ly * wy, 1e-12)
        mm = -(wx * x + wy * y) / information
        x, y = x + lx * mm, y + ly * mm
        aside = np.sqrt(np.maximum((d * x * x - 2 * b * x * y + a * y * y) / determinant, 0.0))
        place = first + lean * (on_surface + mm)[:, None]
        return LinkHeights(mm, 1 / np.sqrt(information), aside, place, np.hypot(lx, ly))


SIGMA_MM = np.array([1.0, 0.08, 0.08, 0.3, 0.1, 0.3])
"""(6,) prior standard deviations of the coefficients, mm: lift, tilt along u, tilt along v, and bow (u², uv, v²)."""
_KINDS = (slice(1, 3), slice(3, 6))
"""Coefficients with heavy tails that occur together: tilt and bow. A board that is tilted along u may as well be along
v. The lift has none: rails and depth of field leave no room for one of many millimetres, which would otherwise explain
a turned camera with a single seam."""
_FREEDOM = 4.0  # degrees of freedom of the t distribution of each kind: a board that lies on something tilts far more
_EDGE = 1.2  # largest |u| and |v|: further outside the board, where a polynomial would grow, the surface is constant


def prior_sigma_mm(coefficients_mm: Floats, sigma_mm: Floats) -> Floats:
    """Return the standard deviations (f,) of the prior at given coefficients (f,) of the surface.

    The prior of tilt and of bow has heavy tails, Student's t distribution: most boards lie well, and those
    that do not may lie in any way. A normal distribution of these standard deviations has the same gradient. They are
    `sigma_mm` (f,) at 0, and grow where links and fiducials contradict that.
    """
    out = sigma_mm.copy()
    for kind in _KINDS:
        far = coefficients_mm[kind] / sigma_mm[kind]
        out[kind] *= np.sqrt(1 + float(far @ far) / (_FREEDOM + len(far)))
    return out


def basis(board_type: BoardType, cad: Floats) -> Floats:
    """Return the values (k, 6) of the basis functions 1, u, v, u², uv, v² at CAD points (k, 2)."""
    about, half = _frame_of(board_type)
    u, v = np.clip((np.asarray(cad, np.float64) - about) / half, -_EDGE, _EDGE).T
    return np.stack([np.ones_like(u), u, v, u * u, u * v, v * v], -1)


def basis_at_board(board_type: BoardType, cad_matrix: Floats, board_mm: Floats) -> Floats:
    """Return the values (k, 6) of the basis functions at points (k, 2) of the board in tester coordinates, mm."""
    return basis(board_type, apply(np.linalg.inv(cad_matrix), board_mm))


def _frame_of(board_type: BoardType) -> tuple[Floats, Floats]:
    """Return the centre (2,), where u and v are 0, and the half span (2,), at which they are 1, in CAD units."""
    low, high = board_type.extent()
    return (low + high) / 2, np.maximum((high - low) / 2, 1e-9)


def to_surface(board_type: BoardType, coefficients_mm: Floats) -> Surface:
    """Convert the coefficients (6,) of the surface to the `Surface` of a result."""
    about, half = (tuple(v.tolist()) for v in _frame_of(board_type))
    lift, *rest = (round(float(v), 5) for v in coefficients_mm)
    return Surface(lift_mm=lift, tilt_mm=tuple(rest[:2]), bow_mm=tuple(rest[2:]), about=about, half_span=half)
