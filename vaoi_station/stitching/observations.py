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


def observe(links: Sequence[Links], cameras: Sequence[Camera]) -> Observations:
    """Bring the links of some pairs of frames to the ground."""
    used = tuple(e for e in links if len(e.a_px))
    if not used:
        none, pairs = np.zeros(0, dtype=np.int_), np.zeros((0, 2))
        return Observations(none, none, pairs, pairs, pairs, pairs, np.zeros((0, 2, 2)), np.zeros(0), none, ())
    sizes = np.array([len(e.a_px) for e in used])
    rows = [(e.task.a[1], (e.task.b or e.task.a)[1]) for e in used]
    a, b, a_lean, b_lean, noise, resolution = _grounded(used, sizes, cameras)
    return Observations(
        np.repeat([p for p, _ in rows], sizes),
        np.repeat([q for _, q in rows], sizes),
        a,
        b,
        a_lean,
        b_lean,
        noise,
        resolution,
        np.repeat(np.arange(len(used)), sizes),
        used,
    )


def _grounded(used: Sequence[Links], sizes: Ints, cameras: Sequence[Camera]) -> tuple[Floats, ...]:
    """What `_ground` says of all links, in their order; asked once per pair of cameras."""
    of_cameras: dict[tuple[int, int], list[int]] = {}
    for n, e in enumerate(used):
        of_cameras.setdefault((e.task.a[0], (e.task.b or e.task.a)[0]), []).append(n)
    k, first = int(sizes.sum()), np.cumsum(sizes) - sizes
    out = (*(np.empty((k, 2)) for _ in range(4)), np.empty((k, 2, 2)), np.empty(k))
    for (i, j), members in of_cameras.items():
        a_px, b_px, information = (
            np.concatenate([getattr(used[n], name) for n in members]) for name in ("a_px", "b_px", "information")
        )
        at = np.concatenate([np.arange(first[n], first[n] + sizes[n]) for n in members])
        for whole, part in zip(out, _ground(cameras[i], cameras[j], a_px, b_px, information), strict=True):
            whole[at] = part
    return out


def _ground(camera_a: Camera, camera_b: Camera, a_px: Floats, b_px: Floats, information: Floats) -> tuple[Floats, ...]:
    """Places, leans, covariances and resolutions of links between two cameras."""
    a, b = camera_a.ground(a_px), camera_b.ground(b_px)
    noise = carried(camera_b.image_from_row.matrix, b, camera_b.lens.undistort(b_px), information)
    return a, b, camera_a.parallax(a), camera_b.parallax(b), *noise


@compiled
def carried(n: Floats, ground_mm: Floats, px: Floats, information: Floats) -> tuple[Floats, Floats]:
    """Covariances (k, 2, 2) mm² on the ground of places in an image, and the resolution (k,) px/mm there.

    Args:
        n: (3, 3) homography of the ground to undistorted pixels.
        ground_mm: (k, 2) places.
        px: (k, 2) undistorted pixels of them.
        information: (k, 2, 2) px⁻², inverse covariances in the image.
    """
    covariance, resolution = np.empty_like(information), np.empty(len(px))
    for k in range(len(px)):
        w = ground_mm[k, 0] * n[2, 0] + ground_mm[k, 1] * n[2, 1] + n[2, 2]
        a, b = (n[0, 0] - px[k, 0] * n[2, 0]) / w, (n[0, 1] - px[k, 0] * n[2, 1]) / w
        c, d = (n[1, 0] - px[k, 1] * n[2, 0]) / w, (n[1, 1] - px[k, 1] * n[2, 1]) / w
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
    return covariance, resolution
