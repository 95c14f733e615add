"""Projection of mosaic pixels into the frames of a run, with lens, row motion and the height of the board's surface."""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np

from vaoi_station.errors import StateError
from vaoi_station.geometry import Camera, apply
from vaoi_station.geometry.transforms import Floats
from vaoi_station.model import Stitch
from vaoi_station.mosaic.grid import MosaicGrid


class FrameProjector:
    """Projects points of a board into the frames of one run."""

    def __init__(self, stitch: Stitch, calibrated: Sequence[Camera]) -> None:
        """Store the matrices of a run; `calibrated` are the cameras with which it was stitched.

        Raises:
            StateError: the run has no CAD mapping.
        """
        if stitch.tester_from_cad is None:
            raise StateError(
                "this run has no CAD mapping, so there is no picture of the whole board.",
                action="; ".join(stitch.reasons),
                code="no-cad-mapping",
            )
        self.cameras = stitch.cameras(calibrated)
        self._surface = stitch.surface
        self._row_from_cad = [motion @ stitch.tester_from_cad.matrix for motion in stitch.row_motion]
        self._placed = stitch.image_matrices

    @property
    def px_per_mm(self) -> float:
        """Mean resolution of the cameras."""
        return float(np.mean([camera.px_per_mm for camera in self.cameras]))

    def places(self, camera: int, row: int) -> bool:
        """Return whether stitching placed a frame."""
        return self._placed[camera][row] is not None

    def raw_px(self, camera: int, row: int, cad: Floats, above_mm: float = 0.0) -> Floats:
        """Project CAD points (..., 2), so far above the board's surface, to raw pixels (..., 2) of a frame."""
        height = above_mm if self._surface is None else above_mm + self._surface.height_mm(cad)
        return self.cameras[camera].project(apply(self._row_from_cad[row], cad), height)

    def from_foot_mm(self, camera: int, row: int, cad: Floats) -> Floats:
        """Return where CAD points (..., 2) lie from the foot of the camera: (..., 2)."""
        return apply(self._row_from_cad[row], cad) - self.cameras[camera].foot_mm

    def slant_mm(self, camera: int, row: int, cad: Floats) -> Floats:
        """Return the distances (...) of CAD points (..., 2) from the foot of the camera: 0 is seen from straight above.

        A body of height h appears displaced by h · distance / working distance.
        """
        offset = self.from_foot_mm(camera, row, cad)
        return np.asarray(np.hypot(offset[..., 0], offset[..., 1]))

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

    def raw_from_mosaic(
        self, camera: int, row: int, grid: MosaicGrid, box: tuple[int, int, int, int], above_mm: float = 0.0
    ) -> Floats:
        """Return the homography (3, 3) from pixels of a part x0, y0, x1, y1 of a mosaic to raw pixels of a frame.

        The pixels of the mosaic lie `above_mm` above the board.

        It is exact at the corners of the part. Between them a lens or a bowed board bends the picture, by less than
        0.05 px within 256 px for the lenses of such an array.
        """
        x0, y0, x1, y1 = box
        corners = np.array([(x0, y0), (x1, y0), (x1, y1), (x0, y1)], dtype=np.float64) - 0.5
        raw = self.raw_px(camera, row, apply(grid.cad_from_mosaic, corners), above_mm)
        matrix = _from_rectangle(raw, x1 - x0, y1 - y0)
        matrix[:, 2] -= corners[0, 0] * matrix[:, 0] + corners[0, 1] * matrix[:, 1]
        return matrix

    def cad(self, camera: int, row: int, raw_px: Floats) -> Floats:
        """Return the CAD points (k, 2) on the board's surface that raw pixels (k, 2) of a frame show."""
        eye, cad_from_row = self.cameras[camera], np.linalg.inv(self._row_from_cad[row])
        cad = apply(cad_from_row, eye.ground(raw_px))
        if self._surface is not None:
            cad = apply(cad_from_row, eye.ground(raw_px, self._surface.height_mm(cad)))
        return np.asarray(cad)

    def outline(self, camera: int, row: int) -> Floats:
        """Return the corners (4, 2), going round, of what a frame shows of the board's plane, CAD coordinates."""
        w, h = self.cameras[camera].width_px - 0.5, self.cameras[camera].height_px - 0.5
        return self.cad(camera, row, np.array([(-0.5, -0.5), (w, -0.5), (w, h), (-0.5, h)]))

    def seen_box(self, camera: int, row: int, grid: MosaicGrid) -> tuple[int, int, int, int]:
        """Return the part x0, y0, x1, y1 (ends excluded) of a mosaic that encloses what a frame shows; may be empty."""
        eye = self.cameras[camera]
        w, h = eye.width_px - 1.0, eye.height_px - 1.0
        border = np.array([(x * w / 4, y * h / 4) for y in range(5) for x in range(5)])
        at = apply(grid.mosaic_from_cad, self.cad(camera, row, border))
        low, high = np.floor(at.min(0)).astype(int) - 1, np.ceil(at.max(0)).astype(int) + 2
        x0, y0 = np.clip(low, 0, (grid.width, grid.height))
        x1, y1 = np.clip(high, 0, (grid.width, grid.height))
        return int(x0), int(y0), int(x1), int(y1)


def _from_rectangle(target: Floats, width: float, height: float) -> Floats:
    """Return the homography (3, 3) from the corners of a rectangle at the origin, in turn, to four points (4, 2)."""
    # The closed form for the unit square; a linear system of eight equations takes ten times as long.
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


def between(matrix: Floats, target: float, source: float) -> Floats:
    """Return a matrix between grids whose pixels are `target` and `source` times as large as those of `matrix`."""
    found = np.array(matrix, np.float64)
    if target != 1:
        found[:2] = found[:2] / target + (0.5 / target - 0.5) * found[2]
    if source != 1:
        found[:, 2] += (0.5 * source - 0.5) * (found[:, 0] + found[:, 1])
        found[:, :2] *= source
    return found


def shrunk(pixels: np.ndarray, factor: int) -> np.ndarray:
    """Return a picture averaged over blocks of factor × factor px; what is left at the end is cut off."""
    if factor <= 1:
        return pixels
    h, w = (n // factor for n in pixels.shape[:2])
    return np.asarray(cv2.resize(pixels[: h * factor, : w * factor], (w, h), interpolation=cv2.INTER_AREA))
