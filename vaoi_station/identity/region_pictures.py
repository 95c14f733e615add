"""Upright pictures of regions of a board, each from the frame that shows it best, or put together from several."""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence

import cv2
import numpy as np
from numpy.typing import NDArray

from vaoi_station.geometry import Camera, apply
from vaoi_station.geometry.transforms import Floats
from vaoi_station.model import BoardType, Stitch
from vaoi_station.mosaic.grid import MosaicGrid, Region
from vaoi_station.mosaic.projection import FrameProjector, between, shrunk
from vaoi_station.pixel_formats import eight_bit_grey

FrameKey = tuple[int, int]
MOST_PX = 2_000_000
"""Largest number of pixels of a picture."""
_FLAGS = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
_LEAST_OVERLAP_PX = 100
"""Number of shared pixels from which the brightness of two frames is matched."""


class RegionPictures:
    """Draws regions of one run's board."""

    def __init__(
        self,
        board_type: BoardType,
        stitch: Stitch,
        cameras: Sequence[Camera],
        frames: Collection[FrameKey],
        frame: Callable[[int, int], NDArray[np.generic] | None],
    ) -> None:
        """Store the run.

        Args:
            board_type: the type of the board.
            stitch: the result of the run.
            cameras: the cameras with which it was stitched.
            frames: the usable frames.
            frame: returns the pixels of a camera and row; None if they are missing.

        Raises:
            StateError: the run has no CAD mapping.
        """
        self._board_type, self._projector, self._frame = board_type, FrameProjector(stitch, cameras), frame
        self._placed = [key for key in sorted(frames) if self._projector.places(*key)]
        self._grey: dict[tuple[FrameKey, int], NDArray[np.uint8] | None] = {}

    @property
    def px_per_mm(self) -> float:
        """Mean resolution of the cameras."""
        return self._projector.px_per_mm

    def grid(self, region: Region, px_per_mm: float) -> MosaicGrid:
        """Return the grid of a picture of a region, with a lower resolution where it would be too large."""
        x0, y0, x1, y1 = region
        area_mm2 = abs((x1 - x0) * (y1 - y0)) * self._board_type.mm_per_unit**2
        fitting = min(px_per_mm, 0.999 * (MOST_PX / area_mm2) ** 0.5)
        return MosaicGrid.of_board(self._board_type, fitting, region)

    def draw(self, grid: MosaicGrid, choice: int) -> tuple[NDArray[np.uint8], FrameKey | None] | None:
        """Draw a region from its best frame, or from the frame with the number `choice` after it.

        Returns the picture, and its frame if that shows all of it; None if no such frame shows any of it. Where a frame
        does not show all of the region, the next ones fill the rest, with their brightness matched.
        """
        order = self._order(grid)
        if choice >= len(order):
            return None
        picture = np.zeros((grid.height, grid.width), np.uint8)
        seen = np.zeros(picture.shape, np.bool_)
        for key, whole in order[choice:] + order[:choice]:
            more, covered = self._warped(key, grid)
            if more is None or not (covered & ~seen).any():
                continue
            if whole and not seen.any():
                return more, key
            gain = _gain(picture, more, seen & covered)
            picture = np.where(seen, picture, np.clip(more * gain, 0, 255).astype(np.uint8))
            seen |= covered
            if seen.all():
                break
        return (picture, None) if seen.any() else None

    def _order(self, grid: MosaicGrid) -> list[tuple[FrameKey, bool]]:
        """Return the frames that show some of a region and whether each shows all of it; the best ones first."""
        w, h = grid.width, grid.height
        border = np.array([(x * w / 2 - 0.5, y * h / 2 - 0.5) for y in range(3) for x in range(3)])
        cad = apply(grid.cad_from_mosaic, border)
        found = []
        for key in self._placed:
            camera = self._projector.cameras[key[0]]
            raw = self._projector.raw_px(*key, cad)
            limits = (camera.width_px - 1, camera.height_px - 1)
            if (raw.max(0) < 0).any() or (raw.min(0) > limits).any():
                continue
            whole = bool((raw >= 0).all() and (raw <= limits).all())
            found.append((not whole, float(self._projector.slant_mm(*key, cad[4])), key))
        return [(key, not partly) for partly, _, key in sorted(found)]

    def _warped(self, key: FrameKey, grid: MosaicGrid) -> tuple[NDArray[np.uint8] | None, NDArray[np.bool_]]:
        """Return the picture of a region by one frame, and which of its pixels the frame shows."""
        camera = self._projector.cameras[key[0]]
        # Of frames that are much finer than the picture, every pixel averages several: sampling would alias.
        factor = max(int(camera.px_per_mm / grid.px_per_mm + 0.2), 1)
        frame = self._shrunk(key, factor)
        if frame is None:
            return None, np.zeros((grid.height, grid.width), np.bool_)
        exact = self._projector.raw_from_mosaic(*key, grid, (0, 0, grid.width, grid.height))
        matrix: Floats = between(exact, factor, 1)
        size = (grid.width, grid.height)
        picture = np.asarray(cv2.warpPerspective(frame, matrix, size, flags=_FLAGS), np.uint8)
        shown = cv2.warpPerspective(np.ones_like(frame), matrix, size, flags=cv2.INTER_NEAREST | cv2.WARP_INVERSE_MAP)
        return picture, np.asarray(shown, np.bool_)

    def _shrunk(self, key: FrameKey, factor: int) -> NDArray[np.uint8] | None:
        at = (key, factor)
        if at not in self._grey:
            pixels = self._frame(*key)
            self._grey[at] = None if pixels is None else np.asarray(shrunk(eight_bit_grey(pixels), factor), np.uint8)
        return self._grey[at]


def _gain(picture: NDArray[np.uint8], more: NDArray[np.uint8], shared: NDArray[np.bool_]) -> float:
    """Return the factor by which the brightness of a further frame is matched to that of a picture."""
    if int(shared.sum()) < _LEAST_OVERLAP_PX:
        return 1.0
    return float(np.clip(picture[shared].mean() / max(float(more[shared].mean()), 1.0), 0.2, 5.0))
