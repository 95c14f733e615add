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
    parts = _grounded(used, cameras)
    sizes = [len(e.a_px) for e in used]
    rows = [(e.task.a[1], (e.task.b or e.task.a)[1]) for e in used]
    a, b, la, lb, cov, res = (np.concatenate([part[n] for part in parts]) for n in range(6))
    return Observations(
        np.repeat([p for p, _ in rows], sizes),
        np.repeat([q for _, q in rows], sizes),
        a,
        b,
        la,
        lb,
        cov,
        res,
        np.repeat(np.arange(len(used)), sizes),
        used,
    )


def _grounded(used: Sequence[Links], cameras: Sequence[Camera]) -> list[tuple[Floats, ...]]:
    """What `_ground` says of every pair of frames; asked once per pair of cameras."""
    of_cameras: dict[tuple[int, int], list[int]] = {}
    for n, e in enumerate(used):
        of_cameras.setdefault((e.task.a[0], (e.task.b or e.task.a)[0]), []).append(n)
    parts: list[tuple[Floats, ...]] = [()] * len(used)
    for (i, j), members in of_cameras.items():
        together = [used[n] for n in members]
        a_px, b_px, information = (
            np.concatenate([getattr(e, name) for e in together]) for name in ("a_px", "b_px", "information")
        )
        ends = np.cumsum([len(e.a_px) for e in together])[:-1]
        split = [np.split(v, ends) for v in _ground(cameras[i], cameras[j], a_px, b_px, information)]
        for k, n in enumerate(members):
            parts[n] = tuple(v[k] for v in split)
    return parts


def _ground(camera_a: Camera, camera_b: Camera, a_px: Floats, b_px: Floats, information: Floats) -> tuple[Floats, ...]:
    """Places, leans, covariances and resolutions of links between two cameras."""
    a, b = camera_a.ground(a_px), camera_b.ground(b_px)
    m = camera_b.image_from_row.matrix
    w = (b @ m[2, :2] + m[2, 2])[:, None, None]
    px_from_mm = (m[None, :2, :2] - camera_b.lens.undistort(b_px)[:, :, None] * m[None, None, 2, :2]) / w
    mm_from_px = np.linalg.inv(px_from_mm)
    covariance = mm_from_px @ np.linalg.inv(information) @ mm_from_px.swapaxes(1, 2)
    resolution = np.sqrt(np.abs(np.linalg.det(px_from_mm)))
    return a, b, camera_a.parallax(a), camera_b.parallax(b), covariance, resolution
