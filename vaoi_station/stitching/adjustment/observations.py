"""Project all links of a run to the ground plane and store them as arrays, the input of the adjustment.

A link states that ground point `a` of row `p` and ground point `b` of row `q` are the same point of the board.
Positions are in mm in the calibrated plane, here called the ground. Fields named `…_lean` are the displacement of a
ground point per mm of height (`geometry.Camera.parallax`).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from vaoi_station.compiled import compiled
from vaoi_station.geometry import Camera
from vaoi_station.geometry.projection_kernels import undistort_point
from vaoi_station.geometry.transforms import Floats
from vaoi_station.stitching.matching.evidence import Links
from vaoi_station.stitching.matching.patch_tables import WINDOW_PX

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
