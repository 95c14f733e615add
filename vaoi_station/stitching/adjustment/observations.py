"""Store all links of a run as arrays on the ground plane: the input of the adjustment.

A link states that ground point `a` of row `p` and ground point `b` of row `q` are the same point of the board.
Lengths are mm in the calibrated plane. `…_lean` is the displacement of a ground point per mm of height
(`geometry.Camera.parallax`).
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

Ints = NDArray[np.int_]

_INITIAL_CAPACITY = 4096
"""Number of links for which a new store allocates memory."""


class LinkArrays(NamedTuple):
    """k links in the form that compiled functions take."""

    p: Ints
    """(k,) row of the first point."""
    q: Ints
    """(k,) row of the second point."""
    a_mm: Floats
    """(k, 2) first point on the ground."""
    b_mm: Floats
    """(k, 2) second point on the ground."""
    a_lean: Floats
    """(k, 2) displacement of the first point in mm per mm of height."""
    b_lean: Floats
    """(k, 2) displacement of the second point in mm per mm of height."""
    noise_mm2: Floats
    """(k, 2, 2) covariance by image noise alone."""
    px_per_mm: Floats
    """(k,) local resolution."""
    group: Ints
    """(k,) index of the pair of frames; links of one pair are adjacent."""


@dataclass(frozen=True, eq=False)
class Observations:
    """k links with their origin; the fields are those of `LinkArrays`."""

    p: Ints
    q: Ints
    a_mm: Floats
    b_mm: Floats
    a_lean: Floats
    b_lean: Floats
    noise_mm2: Floats
    px_per_mm: Floats
    group: Ints
    groups: tuple[Links, ...]
    """The evidence to which `group` is an index."""

    def __len__(self) -> int:
        return len(self.p)

    @cached_property
    def arrays(self) -> LinkArrays:
        """The same links for compiled functions."""
        return LinkArrays(
            self.p,
            self.q,
            self.a_mm,
            self.b_mm,
            self.a_lean,
            self.b_lean,
            self.noise_mm2,
            self.px_per_mm,
            self.group,
        )

    def select(self, at: Ints) -> Observations:
        """Return the links with these indices, in this order."""
        return Observations(*LinkArrays._make(values[at] for values in self.arrays), self.groups)


class LinkStore:
    """Project links to the ground when they arrive and keep them side by side in memory until the run is concluded.

    The evidence of a large board is some thousand small arrays that arrive over seconds. At the end of the run they
    are in no processor cache any more: to gather them then takes longer than the adjustment itself.
    """

    def __init__(self, cameras: Sequence[Camera]) -> None:
        self._cameras = _camera_arrays(cameras)
        self._begins: dict[Links, int] = {}
        """The index of the first entry of each piece of evidence."""
        self._size = 0
        self._columns = [np.empty((0, 2)) for _ in range(4)] + [np.empty((0, 2, 2)), np.empty(0)]
        """The arrays that `_project_links` returns, with spare capacity."""

    def add(self, links: Links) -> None:
        """Add the links of a pair of frames; do nothing if they are present."""
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
        for column, values in zip(self._columns, _project_links(pixels, self._cameras), strict=True):
            column[self._size : self._size + count] = values
        self._begins[links] = self._size
        self._size += count

    def observations(self, links: Sequence[Links]) -> Observations:
        """Return the links of these pairs of frames, in this order."""
        used = tuple(e for e in links if len(e.a_px))
        for e in used:
            self.add(e)
        each = [(e.task.a[1], (e.task.b or e.task.a)[1], len(e.a_px), self._begins[e]) for e in used]
        p, q, count, begin = np.array(each, dtype=np.int_).reshape(-1, 4).T
        before = np.cumsum(count) - count
        at = np.repeat(begin - before, count) + np.arange(count.sum())
        a, b, a_lean, b_lean, noise, resolution = (column[at] for column in self._columns)
        rows, group = (np.repeat(p, count), np.repeat(q, count)), np.repeat(np.arange(len(used)), count)
        return Observations(*rows, a, b, a_lean, b_lean, noise, resolution, group, used)


def to_observations(links: Sequence[Links], cameras: Sequence[Camera]) -> Observations:
    """Project the links of some pairs of frames to the ground."""
    return LinkStore(cameras).observations(links)


class PixelLinks(NamedTuple):
    """k links in pixels."""

    a_px: Floats
    """(k, 2) raw pixels in the first image."""
    b_px: Floats
    """(k, 2) raw pixels in the second image."""
    information: Floats
    """(k, 2, 2) px⁻², inverse covariances in the second image."""
    camera_a: Ints
    """(k,) index of the camera of the first image."""
    camera_b: Ints
    """(k,) index of the camera of the second image."""


class CameraArrays(NamedTuple):
    """All c cameras of a station."""

    image_from_row: Floats
    """(c, 3, 3) N_i."""
    row_from_image: Floats
    """(c, 3, 3) N_i⁻¹."""
    radial: Floats
    """(c, r) radial coefficients of the lenses, padded with zeros."""
    lens: Floats
    """(c, 5) shapes of the lenses."""
    eye: Floats
    """(c, 3) foot point x, y in mm, and lean per mm of distance from it."""


def _camera_arrays(cameras: Sequence[Camera]) -> CameraArrays:
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
        Both points (k, 2) mm, both leans (k, 2), covariance (k, 2, 2) mm² on the ground, resolution (k,) px/mm.
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
        # u and v are those of the second image from here on: the information matrix is stated there
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
