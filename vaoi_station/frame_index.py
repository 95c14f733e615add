"""Which frames of a stitched run show a place of the board, and where: by lens, row motion, surface and height.

Pictures of components, merged pictures, heights, mosaics and codes all ask this index.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from vaoi_station.errors import StateError
from vaoi_station.geometry import Camera, apply
from vaoi_station.geometry.transforms import Floats
from vaoi_station.model import Stitch

Box = tuple[int, int, int, int]  # part x0, y0, x1, y1 of a picture in pixels, ends excluded


class Lenses(NamedTuple):
    """The lenses of all cameras, as compiled functions take them (`geometry.projection_kernels`)."""

    radial: Floats  # (cameras, coefficients) of the distortion; 0 where a lens has fewer
    shape: Floats  # (cameras, 5) `Lens.shape`
    distorts: NDArray[np.bool_]  # (cameras,) whether the lens distorts at all


class FrameIndex:
    """The f frames of a run that stitching placed, ordered by camera and row."""

    def __init__(self, stitch: Stitch, calibrated: Sequence[Camera]) -> None:
        """Store the matrices of a run; `calibrated` are the cameras with which it was stitched.

        Raises:
            StateError: the run has no CAD mapping.
        """
        if stitch.cad_matrix is None:
            raise StateError(
                "this run has no CAD mapping, so it is not known which frames show a place of the board.",
                action="; ".join(stitch.reasons),
                code="no-cad-mapping",
            )
        self.cameras, self.surface = stitch.cameras(calibrated), stitch.surface
        self.tester_from_cad: Floats = np.asarray(stitch.cad_matrix, dtype=np.float64)
        self.row_from_tester: Floats = np.array(stitch.row_motion, dtype=np.float64).reshape(-1, 3, 3)
        self.row_from_cad: Floats = self.row_from_tester @ self.tester_from_cad  # (rows, 3, 3)
        placed = [(i, j) for i, rows in enumerate(stitch.image_matrices) for j, m in enumerate(rows) if m is not None]
        self._placed = frozenset(placed)
        self.key = np.array(placed, dtype=np.int_).reshape(-1, 2)  # (f, 2) camera and row

    @property
    def px_per_mm(self) -> float:
        """Mean resolution of the cameras."""
        return float(np.mean([camera.px_per_mm for camera in self.cameras]))

    def places(self, camera: int, row: int) -> bool:
        """Return whether stitching placed a frame."""
        return (camera, row) in self._placed

    @cached_property
    def lenses(self) -> Lenses:
        """The lenses of all cameras."""
        lenses = [camera.lens for camera in self.cameras]
        radial = np.zeros((len(lenses), max(len(lens.coefficients) for lens in lenses)))
        for own, lens in zip(radial, lenses, strict=True):
            own[: len(lens.coefficients)] = lens.coefficients
        return Lenses(radial, np.array([lens.shape for lens in lenses]), np.array([not lens.ideal for lens in lenses]))

    @cached_property
    def image_from_row(self) -> Floats:
        """N_i of every camera (cameras, 3, 3)."""
        return np.array([camera.image_from_row.matrix for camera in self.cameras])

    @cached_property
    def size_px(self) -> Floats:
        """Width and height (f, 2) of the frames."""
        return np.array([(c.width_px, c.height_px) for c in self.cameras], dtype=np.float64)[self.key[:, 0]]

    @cached_property
    def eye_mm(self) -> Floats:
        """Centres of the cameras (f, 3) in row coordinates; their height is NaN where it is unknown."""
        eyes = [(*c.foot_mm.tolist(), c.working_distance_mm or math.nan) for c in self.cameras]
        return np.array(eyes)[self.key[:, 0]]

    def raw_px(self, camera: int, row: int, cad: Floats, above_mm: float = 0.0) -> Floats:
        """Project CAD points (..., 2), so far above the board's surface, to raw pixels (..., 2) of a frame."""
        height = above_mm if self.surface is None else above_mm + self.surface.height_mm(cad)
        return self.cameras[camera].project(apply(self.row_from_cad[row], cad), height)

    def from_foot_mm(self, camera: int, row: int, cad: Floats) -> Floats:
        """Return where CAD points (..., 2) lie from the foot of the camera: (..., 2).

        At the foot a place is seen from straight above; a body of height h appears displaced by h · distance / working
        distance.
        """
        return apply(self.row_from_cad[row], cad) - self.cameras[camera].foot_mm

    def largest_lean(self, camera: int) -> float:
        """Return by how many mm a body 1 mm high appears displaced at most, somewhere in the frames of a camera.

        It is 0 if the working distance is unknown: heights then displace nothing.
        """
        eye = self.cameras[camera]
        if eye.working_distance_mm is None:
            return 0.0
        w, h = eye.width_px - 1.0, eye.height_px - 1.0
        corners = eye.ground(np.array([(0.0, 0.0), (w, 0.0), (w, h), (0.0, h)]))
        return float(np.hypot(*(corners - eye.foot_mm).T).max()) / eye.working_distance_mm

    def matrix(self, camera: int, row: int, cad_from_picture: Floats, box: Box, above_mm: float = 0.0) -> Floats:
        """Return the homography (3, 3) from pixels of a picture to raw pixels of a frame.

        It is exact at the corners of a part `box` of the picture, whose pixels lie `above_mm` above the board. Between
        them a lens or a bowed board bends the picture, by less than 0.05 px within 256 px for the lenses of such an
        array.
        """
        x0, y0, x1, y1 = box
        corners = np.array([(x0, y0), (x1, y0), (x1, y1), (x0, y1)], dtype=np.float64) - 0.5
        raw = self.raw_px(camera, row, apply(cad_from_picture, corners), above_mm)
        matrix = _from_rectangle(raw, x1 - x0, y1 - y0)
        matrix[:, 2] -= corners[0, 0] * matrix[:, 0] + corners[0, 1] * matrix[:, 1]
        return matrix

    def cad(self, camera: int, row: int, raw_px: Floats) -> Floats:
        """Return the CAD points (k, 2) on the board's surface that raw pixels (k, 2) of a frame show."""
        eye, cad_from_row = self.cameras[camera], np.linalg.inv(self.row_from_cad[row])
        cad = apply(cad_from_row, eye.ground(raw_px))
        if self.surface is not None:
            cad = apply(cad_from_row, eye.ground(raw_px, self.surface.height_mm(cad)))
        return np.asarray(cad)

    def outline(self, camera: int, row: int) -> Floats:
        """Return the corners (4, 2), going round, of what a frame shows of the board's plane, CAD coordinates."""
        w, h = self.cameras[camera].width_px - 0.5, self.cameras[camera].height_px - 0.5
        return self.cad(camera, row, np.array([(-0.5, -0.5), (w, -0.5), (w, h), (-0.5, h)]))

    def seen_box(self, camera: int, row: int, picture_from_cad: Floats, size: tuple[int, int]) -> Box:
        """Return the part of a picture of this width and height that encloses what a frame shows; may be empty."""
        eye = self.cameras[camera]
        w, h = eye.width_px - 1.0, eye.height_px - 1.0
        border = np.array([(x * w / 4, y * h / 4) for y in range(5) for x in range(5)])
        at = apply(picture_from_cad, self.cad(camera, row, border))
        x0, y0 = np.clip(np.floor(at.min(0)).astype(int) - 1, 0, size)
        x1, y1 = np.clip(np.ceil(at.max(0)).astype(int) + 2, 0, size)
        return int(x0), int(y0), int(x1), int(y1)


def _from_rectangle(target: Floats, width: float, height: float) -> Floats:
    """Return the homography (3, 3) from the corners of a rectangle at the origin, in turn, to four points (4, 2)."""
    # In closed form and with plain numbers (see `geometry.homographies`): a mosaic's tile has some ten of them.
    (x0, y0), (x1, y1), (x2, y2), (x3, y3) = target.tolist()
    right, up, rest = (x1 - x2, y1 - y2), (x3 - x2, y3 - y2), (x0 - x1 + x2 - x3, y0 - y1 + y2 - y3)
    area = right[0] * up[1] - up[0] * right[1]
    g, h = (rest[0] * up[1] - up[0] * rest[1]) / area, (right[0] * rest[1] - rest[0] * right[1]) / area
    return np.array(
        [
            [(x1 - x0 + g * x1) / width, (x3 - x0 + h * x3) / height, x0],
            [(y1 - y0 + g * y1) / width, (y3 - y0 + h * y3) / height, y0],
            [g / width, h / height, 1.0],
        ]
    )
