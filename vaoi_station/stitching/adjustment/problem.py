"""The input of an adjustment (links, points of known CAD coordinates, the board's surface), and its solution."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, fields, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from vaoi_station.compiled import compiled
from vaoi_station.geometry import Camera
from vaoi_station.geometry.displacement import PARAMETERS
from vaoi_station.geometry.projection_kernels import undistort_point
from vaoi_station.geometry.transforms import Floats, apply
from vaoi_station.model import BoardType, Surface
from vaoi_station.stitching.adjustment.motion import Motion
from vaoi_station.stitching.matching.evidence import Links
from vaoi_station.stitching.matching.refinement import WINDOW_PX

Ints = NDArray[np.int_]

_INITIAL_CAPACITY = 4096
"""Number of links for which a new link store allocates memory."""


class LinkArrays(NamedTuple):
    """k links on the ground, in the form that compiled functions take."""

    p: Ints
    """(k,) row in which the first point was seen."""
    q: Ints
    """(k,) row in which the second point was seen."""
    a_mm: Floats
    """(k, 2) first point on the ground."""
    b_mm: Floats
    """(k, 2) second point on the ground."""
    a_lean: Floats
    """(k, 2) displacement of the first point in mm per mm of height."""
    b_lean: Floats
    """(k, 2) displacement of the second point in mm per mm of height."""
    noise_mm2: Floats
    """(k, 2, 2) covariance of the residual that image noise alone causes."""
    px_per_mm: Floats
    """(k,) resolution of the second image at each link."""
    overlap: Floats
    """(k,) by how much the patches of each link's pair of frames cover its patch, its own included; at least 1."""
    group: Ints
    """(k,) index of the pair of frames from which each link comes; links of one pair are adjacent."""


class CameraPairs(NamedTuple):
    """The cameras of g pairs of frames, in the form that compiled functions take."""

    a: Ints
    """(g,) number of the camera of the first frame of each pair."""
    b: Ints
    """(g,) camera of the second frame: the same camera, or the next one."""


@dataclass(frozen=True, eq=False)
class Observations:
    """k links on the ground with the evidence from which they come. The arrays are those of `LinkArrays`."""

    p: Ints
    q: Ints
    a_mm: Floats
    b_mm: Floats
    a_lean: Floats
    b_lean: Floats
    noise_mm2: Floats
    px_per_mm: Floats
    overlap: Floats
    group: Ints
    groups: tuple[Links, ...]
    """The evidence of each pair of frames: link i comes from `groups[group[i]]`."""

    def __len__(self) -> int:
        return len(self.p)

    @cached_property
    def arrays(self) -> LinkArrays:
        """The same links as `LinkArrays`, for compiled functions."""
        return LinkArrays(
            self.p,
            self.q,
            self.a_mm,
            self.b_mm,
            self.a_lean,
            self.b_lean,
            self.noise_mm2,
            self.px_per_mm,
            self.overlap,
            self.group,
        )

    @cached_property
    def pairs(self) -> CameraPairs:
        """The cameras of each pair of frames."""
        frames = [(e.task.a[0], (e.task.b or e.task.a)[0]) for e in self.groups]
        a, b = np.array(frames, dtype=np.int_).reshape(-1, 2).T
        return CameraPairs(np.ascontiguousarray(a), np.ascontiguousarray(b))

    @cached_property
    def seam(self) -> Ints:
        """(k,) of each link between two cameras the lower of their numbers; −1 for links from row to row."""
        lower = [e.task.a[0] if e.task.kind == "neighbours" else -1 for e in self.groups]
        return np.array(lower, dtype=np.int_)[self.group]

    def inverse_noise(self, at: Ints, floor_px: float) -> Floats:
        """Return the inverse (k, 2, 2) of the noise of the links `at` (k,), mm⁻², with a scatter added per axis."""
        noise, floor = self.noise_mm2[at], (floor_px / self.px_per_mm[at]) ** 2
        a, b, d = noise[:, 0, 0] + floor, noise[:, 0, 1], noise[:, 1, 1] + floor
        return np.moveaxis(np.array([[d, -b], [-b, a]]) / (a * d - b * b), 2, 0)

    @staticmethod
    def empty() -> Observations:
        """Return a set of observations without any link."""
        return Observations(*LinkArrays._make(column.copy() for column in _NO_LINKS), ())

    def select(self, at: Ints) -> Observations:
        """Return the links with these indices, in this order."""
        return Observations(*LinkArrays._make(values[at] for values in self.arrays), self.groups)


_NO_LINKS = LinkArrays(
    *(np.zeros(0, dtype=np.int_),) * 2,
    *(np.zeros((0, 2)),) * 4,
    np.zeros((0, 2, 2)),
    *(np.zeros(0),) * 2,
    np.zeros(0, np.int_),
)


class LinkStore:
    """Memory for the links of a run: each link is projected to the ground as it arrives, and kept for the conclusion.

    The evidence of a large board consists of about a thousand small arrays, which arrive over several seconds. At the
    end of the run they are no longer in the processor's cache, so that collecting them then would take longer than the
    adjustment itself.
    """

    def __init__(self, cameras: Sequence[Camera]) -> None:
        self._cameras = _camera_arrays(cameras)
        self._begins: dict[Links, int] = {}
        """Index in `_columns` of the first link of each pair of frames."""
        self._size = 0
        self._columns = [np.empty((0, 2)) for _ in range(4)] + [np.empty((0, 2, 2)), np.empty(0), np.empty(0)]
        """The arrays that `_project_links` returns, and the overlap, for all links together, with spare capacity."""

    def add(self, links: Links) -> None:
        """Project the links of a pair of frames to the ground and store them, unless they are stored already."""
        count = len(links.a_px)
        if links in self._begins or not count:
            return
        if self._size + count > len(self._columns[0]):
            # doubling keeps the number of copies logarithmic in the number of links
            more = max(_INITIAL_CAPACITY, self._size + count)
            self._columns = [np.concatenate([c, np.empty((more, *c.shape[1:]))]) for c in self._columns]
        a, b = links.task.a, links.task.b or links.task.a
        pixels = PixelLinks(
            links.a_px, links.b_px, links.information, camera_a=np.full(count, a[0]), camera_b=np.full(count, b[0])
        )
        values_of_links = (*_project_links(pixels, self._cameras), patch_overlap(links.a_px, WINDOW_PX))
        for column, values in zip(self._columns, values_of_links, strict=True):
            column[self._size : self._size + count] = values
        self._begins[links] = self._size
        self._size += count

    def observations(self, links: Sequence[Links]) -> Observations:
        """Return the links of the given pairs of frames, in the given order; add those that are not stored yet."""
        used = tuple(e for e in links if len(e.a_px))
        for e in used:
            self.add(e)
        each = [(e.task.a[1], (e.task.b or e.task.a)[1], len(e.a_px), self._begins[e]) for e in used]
        p, q, count, begin = np.array(each, dtype=np.int_).reshape(-1, 4).T
        before = np.cumsum(count) - count
        at = np.repeat(begin - before, count) + np.arange(count.sum())
        a, b, a_lean, b_lean, noise, resolution, overlap = (column[at] for column in self._columns)
        rows, group = (np.repeat(p, count), np.repeat(q, count)), np.repeat(np.arange(len(used)), count)
        return Observations(*rows, a, b, a_lean, b_lean, noise, resolution, overlap, group, used)


def to_observations(links: Sequence[Links], cameras: Sequence[Camera]) -> Observations:
    """Project the links of pairs of frames to the ground and return them as observations."""
    return LinkStore(cameras).observations(links)


class PixelLinks(NamedTuple):
    """k links in pixels, in the form that compiled functions take."""

    a_px: Floats
    """(k, 2) raw pixels in the first image."""
    b_px: Floats
    """(k, 2) raw pixels in the second image."""
    information: Floats
    """(k, 2, 2) inverse covariance of the point in the second image, px⁻²."""
    camera_a: Ints
    """(k,) index of the camera of the first image."""
    camera_b: Ints
    """(k,) index of the camera of the second image."""


class CameraArrays(NamedTuple):
    """The c cameras of a station, in the form that compiled functions take."""

    image_from_row: Floats
    """(c, 3, 3) camera matrices N_i."""
    row_from_image: Floats
    """(c, 3, 3) inverse camera matrices N_i⁻¹."""
    radial: Floats
    """(c, r) radial coefficients of the lenses; shorter ones are filled up with zeros."""
    lens: Floats
    """(c, 5) further parameters of each lens, in the form of `geometry.Lens.shape`."""
    eye: Floats
    """(c, 3) foot point x, y of each camera in mm, and the lean per mm of distance from the foot point."""


def _camera_arrays(cameras: Sequence[Camera]) -> CameraArrays:
    """Return the parameters of all cameras as arrays for compiled functions."""
    most = max(len(c.lens.coefficients) for c in cameras)
    return CameraArrays(
        np.array([c.image_from_row.matrix for c in cameras]),
        np.array([c.row_from_image.matrix for c in cameras]),
        np.array([np.pad(c.lens.coefficients, (0, most - len(c.lens.coefficients))) for c in cameras]),
        np.array([c.lens.shape for c in cameras]),
        np.array([(*c.foot_mm, 1 / c.working_distance_mm if c.working_distance_mm else 0.0) for c in cameras]),
    )


@compiled
def _project_links(links: PixelLinks, cameras: CameraArrays) -> tuple[Floats, Floats, Floats, Floats, Floats, Floats]:
    """Project links to the ground plane.

    Returns:
        First and second point (k, 2) on the ground, mm; first and second lean (k, 2); covariance (k, 2, 2) on the
        ground, mm²; resolution (k,), px/mm.
    """
    a_px, b_px, information, eye = links.a_px, links.b_px, links.information, cameras.eye
    camera_a, camera_b, lens = links.camera_a, links.camera_b, cameras.lens
    points, leans = np.empty((2, len(a_px), 2)), np.empty((2, len(a_px), 2))
    covariance, resolution = np.empty_like(information), np.empty(len(a_px))
    for k in range(len(a_px)):
        u = v = 0.0
        for end in range(2):
            i = camera_a[k] if end == 0 else camera_b[k]
            x, y = (a_px[k, 0], a_px[k, 1]) if end == 0 else (b_px[k, 0], b_px[k, 1])
            u, v = undistort_point(
                x, y, cameras.radial[i], (lens[i, 0], lens[i, 1], lens[i, 2], lens[i, 3], lens[i, 4])
            )
            n = cameras.row_from_image[i]
            w = n[2, 0] * u + n[2, 1] * v + n[2, 2]
            x, y = (n[0, 0] * u + n[0, 1] * v + n[0, 2]) / w, (n[1, 0] * u + n[1, 1] * v + n[1, 2]) / w
            points[end, k, 0], points[end, k, 1] = x, y
            leans[end, k, 0], leans[end, k, 1] = (eye[i, 0] - x) * eye[i, 2], (eye[i, 1] - y) * eye[i, 2]
        # After this loop, u and v are pixels of the second image, in which the information matrix is stated.
        n, x, y = cameras.image_from_row[camera_b[k]], points[1, k, 0], points[1, k, 1]
        w = x * n[2, 0] + y * n[2, 1] + n[2, 2]
        a, b = (n[0, 0] - u * n[2, 0]) / w, (n[0, 1] - u * n[2, 1]) / w
        c, d = (n[1, 0] - v * n[2, 0]) / w, (n[1, 1] - v * n[2, 1]) / w
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
    return points[0], points[1], leans[0], leans[1], covariance, resolution


@compiled
def patch_overlap(px: Floats, side_px: float) -> Floats:
    """Return by how much square patches at pixels (k, 2), with sides of `side_px`, cover each of them (k,).

    A patch by itself has 1, each of two patches that cover half of each other 1.5. Patches that overlap share the noise
    of the pixels in both: n equal ones show no more than a single one.
    """
    covered = np.ones(len(px))
    for n in range(len(px)):
        for m in range(n):
            x, y = abs(px[n, 0] - px[m, 0]), abs(px[n, 1] - px[m, 1])
            if x < side_px and y < side_px:
                share = (1 - x / side_px) * (1 - y / side_px)
                covered[n] += share
                covered[m] += share
    return covered


def linked_steps(links: Observations, rows: int) -> NDArray[np.bool_]:
    """Return for each step from a row to the next (rows − 1,) whether a link connects rows across this step."""
    change = np.bincount(links.p, minlength=rows) - np.bincount(links.q, minlength=rows)
    return np.asarray(np.cumsum(change)[:-1] > 0)


def index_in_group(group: Ints) -> Ints:
    """Return the index (k,) of each link within its pair of frames (`group`). Links of one pair are adjacent."""
    begins = group_begins(group)
    return np.arange(len(group)) - np.repeat(begins, np.diff(begins, append=len(group)))


def group_begins(group: Ints) -> Ints:
    """Return the index of the first link of each pair of frames (`group`). Links of one pair are adjacent."""
    return np.flatnonzero(np.diff(group, prepend=-1))


def cells_of(component: Ints, group: Ints) -> Ints:
    """Return the number (k,) of the cell of each link: its component in its pair of frames; −1 on the bare board."""
    cell, on = np.full(len(component), -1), component >= 0
    parts = int(component.max(initial=-1)) + 1
    cell[on] = np.unique(group[on] * parts + component[on], return_inverse=True)[1]
    return cell


def median_noise_px(links: Observations, at: Ints) -> float:
    """Return the median standard deviation per axis, px, that image noise causes in the links `at`; 0 without links."""
    sigma_mm = np.sqrt(np.trace(links.noise_mm2[at], axis1=1, axis2=2) / 2)
    return float(np.median(sigma_mm * links.px_per_mm[at])) if len(at) else 0.0


USED = 0.1
"""Robust weight above which a link counts as used."""
FIXTURE, REFERENCE = -1, -2
"""Values of `FiducialPoints.which` for fixture marks and for points of a reference run."""


@dataclass(frozen=True, eq=False)
class FiducialPoints:
    """k observed points of known CAD coordinates: detections of fiducials and fixture marks, points of a reference."""

    row: Ints
    """(k,) row in which each point was seen."""
    ground_mm: Floats
    """(k, 2) observed point on the ground plane."""
    lean: Floats
    """(k, 2) displacement of each ground point, mm, per mm of height."""
    cad: Floats
    """(k, 2) CAD coordinates; y is already flipped if the CAD mapping mirrors."""
    sigma_mm: Floats
    """(k,) standard deviation of the observed point, per axis."""
    px_per_mm: Floats
    """(k,) resolution of the frame at each point."""
    which: Ints
    """(k,) index of the fiducial of the board type; `FIXTURE` or `REFERENCE`, both negative, for other points."""
    camera: Ints
    """(k,) camera that saw each point."""

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

    at_links: Floats
    """(k, f) values of the basis functions at the k links."""
    at_fiducials: Floats
    """(s, f) values of the basis functions at the s points of `Problem.fiducials`."""
    sigma_mm: Floats
    """(f,) prior standard deviation of each coefficient."""


@dataclass(frozen=True, eq=False)
class Problem:
    """All observations and priors of an adjustment."""

    times_s: Floats
    """(m,) time of each row's pulse."""
    velocity_mm_s: Floats
    """(2,) nominal velocity of the conveyor."""
    links: Observations
    component: Ints
    """(k,) index of the component on which each link lies, −1 for the bare board."""
    fiducials: FiducialPoints | None = None
    nominal_scale: float = 1.0
    """Nominal scale of C, mm per CAD unit."""
    surface: SurfaceBasis | None = None
    """The surface to estimate; None if the board is assumed to lie in the calibrated plane."""
    near: Ints = field(default_factory=lambda: np.zeros(0, np.int_))
    """(k,) number of the component that the patch of each link may reach, −1 for none; empty if the components are not
    placed."""
    cameras: tuple[Camera, ...] = ()
    """The cameras whose displacements are estimated; none if the calibration is taken as exact."""
    light: Ints = field(default_factory=lambda: np.zeros(0, np.int_))
    """(m,) number of the light of each row; empty if all rows have one light."""

    def select(self, at: Ints) -> Problem:
        """Return the problem with the links of these indices only, for a problem whose components are not placed."""
        return replace(self, links=self.links.select(at), component=self.component[at])

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

    displacement_px: Floats
    """(n, 3) estimated x, y and turn of each camera, px."""
    covariance: Floats
    """(3n, 3n) covariance of the estimated displacements, px²."""
    cross: Floats
    """(m, u, 3n) covariance of the displacements with the u unknowns of `AdjustmentResult.covariance`, by row."""
    information: Floats
    """(3n, 3n) px⁻², information matrix of the displacements by the run alone, without any prior on them.

    It contains no information about a motion of the whole array, because pictures of a board do not show one."""
    vector: Floats
    """(3n,) px⁻¹, the product of `information` and the displacements that fit the run best without any prior."""
    rivals: tuple[int, ...] = ()
    """Cameras that may have moved instead of those with a displacement."""

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

    change: Floats
    """(c, m, u) for each group and row, change of the u unknowns of `AdjustmentResult.covariance`."""
    growth: Floats
    """(c, m, u, u) by how much their covariance grows: the covariance of the change, if the noise model is right."""
    grids: NDArray[np.bool_]
    """(c, 4) the grids in which each group of links is a cluster; none for a group of points of `Problem.fiducials`."""
    marks: int
    """Number of marks that were left out in turn, with those without which little changes."""

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
    aside: Floats
    """(k,) length of the part of the residual that no height explains, in standard deviations."""
    place_mm: Floats
    """(k, 2) place of the point at this height, tester coordinates."""
    lean: Floats
    """(k,) change of the residual, mm per mm of height."""


@dataclass(frozen=True, eq=False)
class AdjustmentResult:
    """The solution of an adjustment with its covariance and its residuals."""

    motion: Motion
    similarity: Floats | None
    """(4,) C as (a, b, x, y): board = [a −b; b a]·cad + (x, y). None if the problem has no fiducials."""
    surface_mm: Floats
    """(f,) coefficients of the surface, mm."""
    heights_mm: Floats
    """(2, number of components) component heights: first from links between rows, second from links between cameras.
    NaN if a component has too few links, or if it is so tall that its links are outliers."""
    covariance: Floats
    """(m, u, u) for each row, the covariance of its (φ, sx, sy) together with C and the surface. Row 0 is fixed by the
    gauge: the entries of its (φ, sx, sy) are 0."""
    link_sigma: Floats
    """(k,) residual of each link in standard deviations."""
    link_px: Floats
    """(k, 2) residual of each link in px, along the axes of tester coordinates."""
    weight: Floats
    """(k,) final robust weight of each link, 0 … 1; a link of weight 0 has no influence."""
    fiducial_px: Floats
    """(s, 2) residuals of the points of `Problem.fiducials` in px."""
    floor_px: float
    """Noise floor of the links between rows."""
    sigma0: float
    """Square root of the reduced χ² of the links: 1 if their residuals are as large as their noise model states."""
    problem: Problem
    """The problem, with the displacements of the cameras applied to its links, points and cameras."""
    cameras: CameraEstimate | None = None
    """The displacements of the cameras; None if the calibration was taken as exact."""
    influence: Influence | None = None
    """The influence of the links of single places and of single marks; None if it is small, or was not examined."""

    def link_heights(self, at: Ints, least_floor_px: float = 0.0) -> LinkHeights:
        """Return the height above the board's surface that each of the links `at` (k,) measures, taken as one point.

        With the residual r that the link has on the surface, the change l of r per mm of height, and the inverse W of
        the covariance of r, it is h = −(l·W·r) / (l·W·l), with variance 1 / (l·W·l).
        """
        o, motion, surface = self.problem.links, self.motion, self.problem.surface
        on_surface = surface.at_links[at] @ self.surface_mm if surface else np.zeros(len(at))
        lean = motion.turned(o.p[at], o.a_lean[at])
        change = motion.turned(o.q[at], o.b_lean[at]) - lean
        place = motion.board(o.p[at], o.a_mm[at]) + lean * on_surface[:, None]
        apart = motion.board(o.q[at], o.b_mm[at]) - motion.board(o.p[at], o.a_mm[at]) + change * on_surface[:, None]
        weight = o.inverse_noise(at, max(self.floor_px, least_floor_px))
        weighted = (weight @ change[:, :, None])[:, :, 0]
        # If both frames see the point under the same angle, l is almost 0, and the standard deviation large.
        information = np.maximum((change * weighted).sum(1), 1e-12)
        mm = -(weighted * apart).sum(1) / information
        rest = apart + change * mm[:, None]
        aside = np.sqrt(np.maximum((rest * (weight @ rest[:, :, None])[:, :, 0]).sum(1), 0.0))
        return LinkHeights(mm, 1 / np.sqrt(information), aside, place + lean * mm[:, None], np.hypot(*change.T))


SIGMA_MM = np.array([1.0, 0.08, 0.08, 0.3, 0.1, 0.3])
"""(6,) prior standard deviations of the coefficients, mm: lift, tilt along u, tilt along v, and bow (u², uv, v²)."""

_KINDS = (slice(1, 3), slice(3, 6))
"""Coefficients with heavy tails that occur together: tilt and bow. A board that is tilted along u may as well be along
v. The lift has none: rails and depth of field leave no room for one of many millimetres, which would otherwise explain
a turned camera with a single seam."""
_FREEDOM = 4.0
"""Degrees of freedom of the t distribution of each kind: a board that lies on something is tilted by far more."""

_EDGE = 1.2
"""Largest |u| and |v|. Further outside the board, the surface stays constant; a polynomial would grow there."""


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
    about, half = frame_of(board_type)
    u, v = np.clip((np.asarray(cad, np.float64) - about) / half, -_EDGE, _EDGE).T
    return np.stack([np.ones_like(u), u, v, u * u, u * v, v * v], -1)


def basis_at_board(board_type: BoardType, cad_matrix: Floats, board_mm: Floats) -> Floats:
    """Return the values (k, 6) of the basis functions at points (k, 2) of the board in tester coordinates, mm."""
    return basis(board_type, apply(np.linalg.inv(cad_matrix), board_mm))


def frame_of(board_type: BoardType) -> tuple[Floats, Floats]:
    """Return the centre (2,) and the half span (2,) of a board type, in CAD units.

    At the centre u and v are 0; at a distance of half the span they are 1 or −1.
    """
    low, high = board_type.extent()
    return (low + high) / 2, np.maximum((high - low) / 2, 1e-9)


def to_surface(board_type: BoardType, coefficients_mm: Floats) -> Surface:
    """Convert the coefficients (6,) of the surface to the `Surface` of a result."""
    about, half = frame_of(board_type)
    c = [round(float(v), 5) for v in coefficients_mm]
    return Surface(
        lift_mm=c[0],
        tilt_mm=(c[1], c[2]),
        bow_mm=(c[3], c[4], c[5]),
        about=(float(about[0]), float(about[1])),
        half_span=(float(half[0]), float(half[1])),
    )
