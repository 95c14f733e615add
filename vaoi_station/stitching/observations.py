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
from vaoi_station.stitching.evidence import Links

Ints = NDArray[np.int_]


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


def observe(links: Sequence[Links], cameras: Sequence[Camera]) -> Observations:
    """Bring the links of some pairs of frames to the ground."""
    used = tuple(e for e in links if len(e.a_px))
    if not used:
        none, pairs = np.zeros(0, dtype=np.int_), np.zeros((0, 2))
        return Observations(none, none, pairs, pairs, pairs, pairs, np.zeros((0, 2, 2)), np.zeros(0), none, ())
    ends = np.array([(*e.task.a, *(e.task.b or e.task.a), len(e.a_px)) for e in used])
    camera_a, p, camera_b, q, _ = np.repeat(ends, ends[:, 4], axis=0).T
    a, b, a_lean, b_lean, noise, resolution = _grounded(
        np.concatenate([e.a_px for e in used]),
        np.concatenate([e.b_px for e in used]),
        np.concatenate([e.information for e in used]),
        np.ascontiguousarray(camera_a),
        np.ascontiguousarray(camera_b),
        *_as_arrays(cameras),
    )
    group = np.repeat(np.arange(len(used)), ends[:, 4])
    return Observations(
        np.ascontiguousarray(p), np.ascontiguousarray(q), a, b, a_lean, b_lean, noise, resolution, group, used
    )


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
