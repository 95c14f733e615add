"""All links of a run as arrays on the ground: what the adjustment computes with.

A link says that ground point `a` of row `p` and ground point `b` of row `q` are the same point of the
board. Lengths are mm in the calibrated plane; `…_lean` is how far a ground point moves per mm of
height (`geometry.Camera.parallax`).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from vaoi_station.compiled import compiled
from vaoi_station.geometry import Camera
from vaoi_station.geometry.rays import undistorted
from vaoi_station.geometry.transforms import Floats
from vaoi_station.stitching.matching.evidence import Links

Ints = NDArray[np.int_]

_ROOM = 4096
"""Links there is room for at first."""


@dataclass(frozen=True, eq=False)
class Observations:
    """k links; `group` numbers the pair of frames each came from."""

    p: Ints
    q: Ints
    a_mm: Floats
    b_mm: Floats
    a_lean: Floats
    b_lean: Floats
    noise_mm2: Floats
    """(k, 2, 2) covariance by image noise alone."""
    px_per_mm: Floats
    """(k,) local resolution."""
    group: Ints
    groups: tuple[Links, ...]

    def __len__(self) -> int:
        return len(self.p)

    def of(self, at: Ints) -> Observations:
        """Those of these numbers, in that order."""
        return Observations(
            *(self.p[at], self.q[at], self.a_mm[at], self.b_mm[at], self.a_lean[at], self.b_lean[at]),
            *(self.noise_mm2[at], self.px_per_mm[at]),
            self.group[at],
            self.groups,
        )


class LinkStore:
    """Links brought to the ground when they are found, and kept side by side in memory until the run is concluded.

    At the end of a large board its evidence, some thousand pieces found in the course of seconds, is in no cache any
    more: to gather it then takes longer than to compute with it.
    """

    def __init__(self, cameras: Sequence[Camera]) -> None:
        self._cameras = _as_arrays(cameras)
        self._begins: dict[Links, int] = {}
        """Where the entries of each piece of evidence begin."""
        self._size = 0
        self._columns = [np.empty((0, 2)) for _ in range(4)] + [np.empty((0, 2, 2)), np.empty(0)]
        """As of `_grounded`, with room for more."""

    def add(self, links: Links) -> None:
        """Note the links of a pair of frames; harmless when they have been."""
        count = len(links.a_px)
        if links in self._begins or not count:
            return
        if self._size + count > len(self._columns[0]):
            more = max(_ROOM, self._size + count)
            self._columns = [np.concatenate([c, np.empty((more, *c.shape[1:]))]) for c in self._columns]
        a, b = links.task.a, links.task.b or links.task.a
        cameras = np.full(count, a[0]), np.full(count, b[0])
        found = _grounded(links.a_px, links.b_px, links.information, *cameras, *self._cameras)
        for column, values in zip(self._columns, found, strict=True):
            column[self._size : self._size + count] = values
        self._begins[links] = self._size
        self._size += count

    def observations(self, links: Sequence[Links]) -> Observations:
        """Those of some pairs of frames, in this order."""
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
    """Bring the links of some pairs of frames to the ground."""
    return LinkStore(cameras).observations(links)


def _as_arrays(cameras: Sequence[Camera]) -> tuple[Floats, Floats, Floats, Floats, Floats]:
    """N_i and N_i⁻¹ (c, 3, 3), lenses (c, r) and (c, 5), and (c, 3) foot and leaning per mm of distance from it."""
    most = max(len(c.lens.coefficients) for c in cameras)
    return (
        np.array([c.image_from_row.matrix for c in cameras]),
        np.array([c.row_from_image.matrix for c in cameras]),
        np.array([np.pad(c.lens.coefficients, (0, most - len(c.lens.coefficients))) for c in cameras]),
        np.array([c.lens.shape for c in cameras]),
        np.array([(*c.foot_mm, 1 / c.working_distance_mm if c.working_distance_mm else 0.0) for c in cameras]),
    )


@compiled
def _grounded(
    a_px: Floats,
    b_px: Floats,
    information: Floats,
    camera_a: Ints,
    camera_b: Ints,
    image_from_row: Floats,
    row_from_image: Floats,
    radial: Floats,
    lens: Floats,
    eye: Floats,
) -> tuple[Floats, Floats, Floats, Floats, Floats, Floats]:
    """Places, leans, covariances and resolutions of links.

    Args:
        a_px: (k, 2) raw pixels, as is b_px.
        information: (k, 2, 2) px⁻², inverse covariances in the second image.
        camera_a: (k,) numbers, as is camera_b.
        image_from_row: as of `_as_arrays`, as is what follows.

    Returns:
        Both places (k, 2) mm, both leans (k, 2), covariance (k, 2, 2) mm² on the ground, resolution (k,) px/mm.
    """
    places, leans = np.empty((2, len(a_px), 2)), np.empty((2, len(a_px), 2))
    covariance, resolution = np.empty_like(information), np.empty(len(a_px))
    for k in range(len(a_px)):
        u = v = 0.0
        for end in range(2):
            i = camera_a[k] if end == 0 else camera_b[k]
            x, y = (a_px[k, 0], a_px[k, 1]) if end == 0 else (b_px[k, 0], b_px[k, 1])
            u, v = undistorted(x, y, radial[i], (lens[i, 0], lens[i, 1], lens[i, 2], lens[i, 3], lens[i, 4]))
            n = row_from_image[i]
            w = n[2, 0] * u + n[2, 1] * v + n[2, 2]
            x, y = (n[0, 0] * u + n[0, 1] * v + n[0, 2]) / w, (n[1, 0] * u + n[1, 1] * v + n[1, 2]) / w
            places[end, k, 0], places[end, k, 1] = x, y
            leans[end, k, 0], leans[end, k, 1] = (eye[i, 0] - x) * eye[i, 2], (eye[i, 1] - y) * eye[i, 2]
        n, x, y = image_from_row[camera_b[k]], places[1, k, 0], places[1, k, 1]
        w = x * n[2, 0] + y * n[2, 1] + n[2, 2]
        a, b = (n[0, 0] - u * n[2, 0]) / w, (n[0, 1] - u * n[2, 1]) / w
        c, d = (n[1, 0] - v * n[2, 0]) / w, (n[1, 1] - v * n[2, 1]) / w
        slope = a * d - b * c
        p, q, r = information[k, 0, 0], information[k, 0, 1], information[k, 1, 1]
        # (J⁻¹)·I⁻¹·(J⁻¹)ᵀ is the inverse of Jᵀ·I·J, J being the slope of the image by the ground
        xx = a * a * p + 2 * a * c * q + c * c * r
        xy = a * b * p + (a * d + b * c) * q + c * d * r
        yy = b * b * p + 2 * b * d * q + d * d * r
        det = slope * slope * (p * r - q * q)
        covariance[k, 0, 0], covariance[k, 1, 1] = yy / det, xx / det
        covariance[k, 0, 1] = covariance[k, 1, 0] = -xy / det
        resolution[k] = np.sqrt(abs(slope))
    return places[0], places[1], leans[0], leans[1], covariance, resolution
