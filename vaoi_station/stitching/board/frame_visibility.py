"""The frames of a run as arrays: find the frame that shows a board point best, and the pixel of the point in it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from vaoi_station.compiled import compiled
from vaoi_station.geometry.projection_kernels import distort_point
from vaoi_station.geometry.transforms import Floats
from vaoi_station.stitching.adjustment.motion import Motion
from vaoi_station.stitching.adjustment.observations import Ints
from vaoi_station.stitching.matching.scene import Scene

_MARGIN_MM = 1.0
"""Least distance of a point from the border of its best frame."""
_FAINT = 1 / 3
"""A frame whose grey levels scatter less than this share of those of another frame is exposed too short or too long."""


@dataclass(frozen=True, eq=False)
class FrameArrays:
    """The poses of f frames, of c cameras in m rows, as arrays for compiled functions."""

    scene: Scene
    frame: Ints
    """(f, 2) camera and row of each frame."""
    rows: Floats
    """(m, 3, 3) the matrix D_j of each row."""
    image_from_row: Floats
    """(c, 3, 3) the matrix N_i of each camera."""
    radial: Floats
    """(c, r) radial coefficients a1, a2, … of each lens."""
    lens: Floats
    """(c, 5) other parameters of each lens, in the form of `geometry.projection_kernels`."""
    view_mm: Floats
    """(c, 4) lowest x and y, then highest x and y, of each camera's view, mm in row coordinates."""
    size_px: Floats
    """(c, 3) width and height of each camera's frame, and the margin at its border."""

    @staticmethod
    def of(scene: Scene, motion: Motion) -> FrameArrays:
        """Collect the arrays of a scene, with the motion of its rows."""
        return FrameArrays.of_rows(scene, motion.rows_from_tester)

    @staticmethod
    def of_rows(scene: Scene, rows: Floats) -> FrameArrays:
        """Collect the arrays of a scene whose rows have the matrices D_j (m, 3, 3)."""
        cameras = scene.cameras
        # All lenses share one array, so shorter polynomials are filled up with zeros.
        most = max(len(c.lens.coefficients) for c in cameras)
        return FrameArrays(
            scene,
            np.array(scene.present, dtype=np.int_).reshape(-1, 2),
            rows,
            np.array([c.image_from_row.matrix for c in cameras]),
            np.array([[*c.lens.coefficients, *[0.0] * (most - len(c.lens.coefficients))] for c in cameras]),
            np.array([c.lens.shape for c in cameras]),
            np.array([np.concatenate(c.view_mm()) for c in cameras]),
            np.array([(c.width_px, c.height_px, _MARGIN_MM * c.px_per_mm) for c in cameras]),
        )

    def nearest(self, board_mm: Floats) -> Ints:
        """Return for each board point (k, 2) the number of the frame that shows it nearest to its centre; −1: none.

        A frame that is almost black or saturated everywhere shows no edges: it is taken for points that no other frame
        shows. A program may give every row and camera its own exposure.
        """
        points, faint, contrast = (
            np.ascontiguousarray(board_mm),
            np.zeros(len(self.frame), np.bool_),
            dict[int, float](),
        )
        chosen = first = _nearest(points, self._poses, self.view_mm, self.size_px, faint)
        # Only the contrast of frames that are chosen is computed: their pixels are read next in any case.
        while new := set(np.unique(chosen[chosen >= 0]).tolist()) - set(contrast):
            contrast |= {n: self.scene.prepared(self.scene.present[n]).contrast for n in new}
            least = _FAINT * max(contrast.values())
            faint[[n for n, found in contrast.items() if found < least]] = True
            better = _nearest(points, self._poses, self.view_mm, self.size_px, faint) if faint.any() else first
            chosen = np.where(better >= 0, better, first)
        return chosen

    def project(self, number: Ints, board_mm: Floats) -> Floats:
        """Project board points (k, s, 2) to raw pixels, s points each to one of k frames.

        `number` (k,) holds the frames' numbers; where it is −1 the pixels are NaN.
        """
        return _projected(np.ascontiguousarray(board_mm), number, self._poses)

    @property
    def _poses(self) -> _Poses:
        return _Poses(self.frame, self.rows, self.image_from_row, self.radial, self.lens)

    def read_samples(self, number: Ints, samples: int, read: Callable[[NDArray[np.uint8], Ints], Floats]) -> Floats:
        """Read s grey levels along a line at each of k places, from the frame that shows the place: (k, samples).

        Args:
            number: (k,) number of the frame for each place; −1 gives NaN.
            samples: number s of samples per place.
            read: function that takes the pixels of a frame and the indices (j,) of its places, and returns their
                samples (j, samples).
        """
        # The loop goes frame by frame, so that each frame is fetched and prepared only once.
        out = np.full((len(number), samples), np.nan)
        for n in np.unique(number[number >= 0]).tolist():
            mine = np.flatnonzero(number == n)
            out[mine] = read(self.scene.prepared(self.scene.present[n]).grey, mine)
        return out


class _Poses(NamedTuple):
    """The arrays of `FrameArrays` that are needed to project board points to raw pixels."""

    frame: Ints
    rows: Floats
    image_from_row: Floats
    radial: Floats
    lens: Floats


@compiled
def _nearest(board_mm: Floats, poses: _Poses, view_mm: Floats, size_px: Floats, faint: NDArray[np.bool_]) -> Ints:
    frame, rows, image_from_row, radial, lens = poses
    chosen = np.full(len(board_mm), -1)
    for k in range(len(board_mm)):
        best = np.inf
        for n in range(len(frame)):
            if faint[n]:
                continue
            i, d = frame[n, 0], rows[frame[n, 1]]
            x = d[0, 0] * board_mm[k, 0] + d[0, 1] * board_mm[k, 1] + d[0, 2]
            y = d[1, 0] * board_mm[k, 0] + d[1, 1] * board_mm[k, 1] + d[1, 2]
            # The comparison in mm is cheap and rules out most frames before projection and lens are computed.
            if not (view_mm[i, 0] <= x <= view_mm[i, 2] and view_mm[i, 1] <= y <= view_mm[i, 3]):
                continue
            m, last_x, last_y, margin = image_from_row[i], size_px[i, 0] - 1, size_px[i, 1] - 1, size_px[i, 2]
            w = m[2, 0] * x + m[2, 1] * y + m[2, 2]
            u, v = (m[0, 0] * x + m[0, 1] * y + m[0, 2]) / w, (m[1, 0] * x + m[1, 1] * y + m[1, 2]) / w
            shape = (lens[i, 0], lens[i, 1], lens[i, 2], lens[i, 3], lens[i, 4])
            u, v = distort_point(u, v, radial[i], shape)
            if min(u, v) < margin or u > last_x - margin or v > last_y - margin:
                continue
            off = (u - last_x / 2) ** 2 + (v - last_y / 2) ** 2
            if off < best:
                best, chosen[k] = off, n
    return chosen


@compiled
def _projected(board_mm: Floats, number: Ints, poses: _Poses) -> Floats:
    frame, rows, image_from_row, radial, lens = poses
    out = np.full(board_mm.shape, np.nan)
    for k in range(len(board_mm)):
        if number[k] < 0:
            continue
        i, d = frame[number[k], 0], rows[frame[number[k], 1]]
        m, shape = image_from_row[i], (lens[i, 0], lens[i, 1], lens[i, 2], lens[i, 3], lens[i, 4])
        for s in range(board_mm.shape[1]):
            x = d[0, 0] * board_mm[k, s, 0] + d[0, 1] * board_mm[k, s, 1] + d[0, 2]
            y = d[1, 0] * board_mm[k, s, 0] + d[1, 1] * board_mm[k, s, 1] + d[1, 2]
            w = m[2, 0] * x + m[2, 1] * y + m[2, 2]
            u, v = (m[0, 0] * x + m[0, 1] * y + m[0, 2]) / w, (m[1, 0] * x + m[1, 1] * y + m[1, 2]) / w
            out[k, s, 0], out[k, s, 1] = distort_point(u, v, radial[i], shape)
    return out
