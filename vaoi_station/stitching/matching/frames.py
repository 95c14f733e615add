"""Prepare a frame once for all tasks that read it, and give the frames of a run to those who read pixels."""

from __future__ import annotations

import copy
import math
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from vaoi_station.compiled import compiled, inlined
from vaoi_station.frame_index import FrameIndex
from vaoi_station.geometry import Camera
from vaoi_station.geometry.transforms import Floats
from vaoi_station.model import Surface
from vaoi_station.pixel_formats import eight_bit_grey
from vaoi_station.stitching.matching.evidence import FrameKey
from vaoi_station.stitching.matching.refinement import KERNEL, KERNEL_REACH, KERNEL_STEPS

_COARSE_WIDTH_PX = 150  # smallest width of `PreparedFrame.coarse`
_SAMPLED_PX = 16  # distance of the pixels from which the contrast is computed
_FAR_PX = 30_000  # largest coordinate of a polygon that OpenCV fills without overflow


class PreparedFrame:
    """One frame with its grey pixels and reduced copies, each of which is computed when it is first read.

    In a copy that is reduced by `factor`, the centre of pixel k lies at the coordinate (k + ½)·factor − ½ of the frame.
    """

    def __init__(self, pixels: NDArray[Any], part_px: Floats | None = None) -> None:
        """Create it from the pixels of a grey frame (h, w) or a colour frame (h, w, 3), 8 bit or full-scale 16 bit.

        `part_px` are the corners (k, 2) of the convex part that coarse searches use; None for all of it.
        """
        self._pixels, self._part_px = pixels, part_px
        self._copies: dict[int, NDArray[np.uint8]] = {}  # reduced grey frames by their factor

    @cached_property
    def grey(self) -> NDArray[np.uint8]:
        """(h, w) 8-bit luminance, as a read-only and contiguous array."""
        return read_only(eight_bit_grey(self._pixels))

    def reduced(self, factor: int) -> NDArray[np.uint8]:
        """Return the grey frame reduced by a power of two, by block means, read-only. It is computed once per frame."""
        if factor == 1:
            return self.grey
        if factor not in self._copies:
            small = _quarter_size(self.grey) if factor == 4 else half_size(self.reduced(factor // 2))
            self._copies[factor] = read_only(small)
        return self._copies[factor]

    @cached_property
    def contrast(self) -> float:
        """Standard deviation of the grey levels, from a sample of the pixels."""
        return float(cv2.meanStdDev(np.ascontiguousarray(self.grey[::_SAMPLED_PX, ::_SAMPLED_PX]))[1][0, 0])

    @cached_property
    def factor(self) -> int:
        """Factor by which `coarse` is reduced: 4, or a higher power of two in large frames."""
        factor = 4
        while self.grey.shape[1] // (2 * factor) >= _COARSE_WIDTH_PX:
            factor *= 2
        return factor

    @cached_property
    def coarse(self) -> NDArray[np.float32]:
        """The grey frame reduced by `factor`, minus its local mean, which removes uneven light and vignetting."""
        small = self.reduced(self.factor)
        wide = cv2.blur(small, (15, 15), borderType=cv2.BORDER_REFLECT)
        coarse = np.asarray(cv2.subtract(small, wide, dtype=cv2.CV_32F), dtype=np.float32)
        if self._part_px is None:
            return coarse
        mask = np.zeros(coarse.shape, np.uint8)
        corners = np.clip((self._part_px + 0.5) / self.factor - 0.5, -_FAR_PX, _FAR_PX)
        cv2.fillConvexPoly(mask, np.rint(corners).astype(np.int32), 1)
        return np.asarray(coarse * mask, dtype=np.float32)

    @cached_property
    def coarser(self) -> NDArray[np.float32]:
        """The copy `coarse` reduced once more by 2."""
        return np.asarray(half_size(self.coarse))

    def with_grey(self, grey: NDArray[np.uint8]) -> PreparedFrame:
        """Return a frame of the same size, and with the same part, with other grey levels."""
        return PreparedFrame(grey, self._part_px)

    def masked(self, part_px: Floats) -> PreparedFrame:
        """Return the frame for coarse searches in a convex part with corners (k, 2); outside `coarse` is 0."""
        # They are read first, so that the copy shares what is computed once per frame.
        _ = self.grey, self.factor
        out = copy.copy(self)
        out._part_px = part_px
        for searched in ("coarse", "coarser"):
            out.__dict__.pop(searched, None)
        return out


@compiled
def _quarter_size(image: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Return the means of blocks of 4×4 pixels. Incomplete blocks at the right and at the bottom are left out.

    Here a frame is read from memory for the first time, so the order of access determines the time. Reading line by
    line takes half as long as reading several lines at once, and a third as long as two reductions by 2.
    """
    h, w = image.shape[0] // 4, image.shape[1] // 4
    out, sums = np.empty((h, w), np.uint8), np.empty(4 * w, np.uint16)
    for y in range(h):
        # Four sums are added and divided by 16 below. Each starts at 2; this adds 8 in total and so rounds to the
        # nearest value.
        for x in range(4 * w):
            sums[x] = 2
        for k in range(4):
            line = image[4 * y + k, : 4 * w]
            for x in range(4 * w):
                sums[x] += np.uint16(line[x])
        to = out[y]
        for x in range(w):
            to[x] = np.uint8(np.uint16(sums[4 * x] + sums[4 * x + 1] + sums[4 * x + 2] + sums[4 * x + 3]) >> 4)
    return out


def read_only(image: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Return a contiguous, read-only view of an image: a single type of array for compiled functions.

    Numba compiles separate variants for read-only and for writable arrays, and the two may round differently. A frame
    in the ring and the same frame from a file must give the same evidence.
    """
    view = np.ascontiguousarray(image).view()
    view.flags.writeable = False
    return view


def half_size(image: NDArray[Any]) -> NDArray[Any]:
    """Return the means of blocks of 2×2 pixels.

    An odd last line or column is left out: OpenCV would otherwise stretch the picture, and pixel centres would shift.
    """
    h, w = image.shape[0] // 2 * 2, image.shape[1] // 2 * 2
    return np.asarray(cv2.resize(image[:h, :w], (w // 2, h // 2), interpolation=cv2.INTER_AREA))


def resample(
    image: NDArray[np.uint8], image_from_grid: Floats, size: tuple[int, int], wide: float
) -> NDArray[np.uint8]:
    """Return part of an image in another grid of pixels, read-only. Outside the image, border pixels are repeated.

    Args:
        image: (h, w) grey levels.
        image_from_grid: (2, 3) affine map from pixels of the grid to pixels of the image.
        size: width and height of the part.
        wide: size of a pixel of the grid in pixels of the image, at least 1. Texture finer than the grid is removed.
    """
    return read_only(_resample(read_only(image), np.ascontiguousarray(image_from_grid), *size, wide))


@compiled
def _resample(image: NDArray[np.uint8], affine: Floats, width: int, height: int, wide: float) -> NDArray[np.uint8]:
    """Perform the work of `resample` with a windowed sinc."""
    h, w = image.shape
    reach = KERNEL_REACH * wide
    most = int(2 * reach) + 2
    across, down = np.zeros(most, np.float32), np.zeros(most, np.float32)
    out = np.empty((height, width), np.uint8)
    for y in range(height):
        for x in range(width):
            u = affine[0, 0] * x + affine[0, 1] * y + affine[0, 2]
            v = affine[1, 0] * x + affine[1, 1] * y + affine[1, 2]
            if not (-reach < u < w - 1 + reach and -reach < v < h - 1 + reach):
                out[y, x] = image[int(min(max(v, 0.0), h - 1.0)), int(min(max(u, 0.0), w - 1.0))]
                continue
            left, top = math.ceil(u - reach), math.ceil(v - reach)
            nx, ny = math.floor(u + reach) - left + 1, math.floor(v + reach) - top + 1
            all_x = all_y = np.float32(0)
            for k in range(nx):
                across[k] = _weight(abs(left + k - u) / wide)
                all_x += across[k]
            for k in range(ny):
                down[k] = _weight(abs(top + k - v) / wide)
                all_y += down[k]
            total, inside = np.float32(0), left >= 0 and left + nx <= w
            for j in range(ny):
                line, part = image[min(max(top + j, 0), h - 1)], np.float32(0)
                if inside:
                    for i in range(nx):
                        part += across[i] * line[left + i]
                else:
                    for i in range(nx):
                        part += across[i] * line[min(max(left + i, 0), w - 1)]
                total += down[j] * part
            out[y, x] = np.uint8(min(max(total / (all_x * all_y) + np.float32(0.5), np.float32(0)), np.float32(255)))
    return out


@inlined
def _weight(distance: float) -> float:
    """Return the weight of a pixel at a distance from the interpolated point, from `KERNEL`."""
    at = min(distance * KERNEL_STEPS, KERNEL_REACH * KERNEL_STEPS - 1e-3)
    n = int(at)
    return float(KERNEL[n] + np.float32(at - n) * (KERNEL[n + 1] - KERNEL[n]))


@dataclass(frozen=True, eq=False)
class Scene:
    """The cameras and good frames of a run, with access to the prepared frames."""

    cameras: tuple[Camera, ...]
    present: tuple[FrameKey, ...]  # camera and row of every good frame, sorted
    prepared: Callable[[FrameKey], PreparedFrame]
    """A function that returns the prepared frame of a camera and row, and raises LookupError if it is missing."""
    doubts: tuple[str, ...] = ()  # doubts about the frames that arose when they were recorded (`RecordingHead.doubts`)
    contrasts: dict[FrameKey, float] = field(default_factory=dict, repr=False)
    """Contrasts of frames that an index has read: a frame may have to be fetched and prepared for it."""

    def index(self, row_from_tester: Floats, surface: Surface | None = None) -> FrameIndex:
        """Return which frames show a place of the board, for rows with the matrices D_j (m, 3, 3)."""
        return FrameIndex(
            self.cameras, row_from_tester, self.present, surface, prepared=self.prepared, contrasts=self.contrasts
        )
